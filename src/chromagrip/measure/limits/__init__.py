"""Cramér-Rao bounds of marker positions and of forces."""
