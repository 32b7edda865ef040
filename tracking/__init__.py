"""What the image says: markers, then forces, f = argmin |y − J·K⁻¹·f|² + prior(f)."""

from .detection import DetectionError, detect_markers
from .force import (
    MIN_MARKERS,
    DivergedEstimateError,
    ForceEstimator,
    ForcePrior,
    NoEstimateError,
    TooFewMarkersError,
)
from .friction import (
    CAMERA_RULE,
    THESIS_RULE,
    Z90,
    FrictionEstimate,
    FrictionRule,
    core_quantile,
    max_ratio,
)
from .sensitivity import UnsupportedSensorError
from .tracker import MarkerTracker
from .tracks import Tracks

__all__ = [
    "CAMERA_RULE",
    "MIN_MARKERS",
    "THESIS_RULE",
    "Z90",
    "DetectionError",
    "DivergedEstimateError",
    "ForceEstimator",
    "ForcePrior",
    "FrictionEstimate",
    "FrictionRule",
    "MarkerTracker",
    "NoEstimateError",
    "TooFewMarkersError",
    "Tracks",
    "UnsupportedSensorError",
    "core_quantile",
    "detect_markers",
    "max_ratio",
]
