"""Defects of a real sensor: misplaced markers, uneven light, exposure, noise and compression."""

from .imaging import exposure, white_balance

__all__ = ["exposure", "white_balance"]
