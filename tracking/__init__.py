"""What the image says: markers, then forces, f = argmin |y − J·K⁻¹·f|² + prior(f)."""

from .detection import DetectionError, detect_markers
from .force import MIN_MARKERS, ForceEstimator, ForcePrior, TooFewMarkersError
from .friction import OBSERVABLE_MARGIN, Z90, FrictionEstimate, core_quantile, max_ratio
from .tracker import MarkerTracker
from .tracks import Tracks

__all__ = [
    "MIN_MARKERS",
    "OBSERVABLE_MARGIN",
    "Z90",
    "DetectionError",
    "ForceEstimator",
    "ForcePrior",
    "FrictionEstimate",
    "MarkerTracker",
    "TooFewMarkersError",
    "Tracks",
    "core_quantile",
    "detect_markers",
    "max_ratio",
]
