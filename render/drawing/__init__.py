"""Renderers, and the labels of what they draw."""
