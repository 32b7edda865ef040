"""The default tracker: a least-squares fit of the known marker shapes to every frame.

The light of a pixel is γ·ground·(1 − a₀·C₀ − a₁·C₁ + b·C₀₁). γ is the local gain, aₖ the share of
light that dye k absorbs, Cₖ the coverage of the pixel by the blurred disc of layer k, and C₀₁ the
coverage by both. b corrects the absorption there (a₀·a₁ for ideal dyes). Gauss–Newton steps,
weighted by the noise of each pixel, fit position, size and strain of both discs of a pair, and the
light on it.
"""

from .settings import FitSettings
from .tracker import MarkerTracker

__all__ = ["FitSettings", "MarkerTracker"]
