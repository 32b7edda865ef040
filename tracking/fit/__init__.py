"""The default tracker: a least-squares fit of the known shapes to every frame.

The light of a pixel is γ·ground·(1 − a₀·C₀ − a₁·C₁ + b·C₀₁). γ is the local gain, a the share that
a dye absorbs, b the share that both together leave over, and C the coverage of the pixel by the
blurred disc of a layer, or by both. Gauss–Newton steps, weighted by the noise of each pixel, fit
place, size and strain of both discs of a pair, and the light on it.
"""

from .settings import FitSettings
from .tracker import MarkerTracker

__all__ = ["FitSettings", "MarkerTracker"]
