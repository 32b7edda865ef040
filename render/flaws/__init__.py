"""Defects of a real sensor: misplaced markers, uneven light, exposure, noise and compression."""
