"""What the image says: markers, then forces, f = argmin |y − J·K⁻¹·f|² + prior(f)."""

from .detection import DetectionError, Markers, RestFrame, detect_markers, read_rest
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
from .palette import DEFAULT_PALETTE, Palette, PaletteError, load_palette, palette_names
from .sensitivity import UnsupportedSensorError
from .tracker import MarkerTracker
from .trackers import (
    DEFAULT_TRACKER,
    FrameError,
    Tracker,
    TrackerError,
    load_tracker,
    tracker_names,
)
from .tracks import Tracks

__all__ = [
    "CAMERA_RULE",
    "DEFAULT_PALETTE",
    "DEFAULT_TRACKER",
    "MIN_MARKERS",
    "THESIS_RULE",
    "Z90",
    "DetectionError",
    "DivergedEstimateError",
    "ForceEstimator",
    "ForcePrior",
    "FrameError",
    "FrictionEstimate",
    "FrictionRule",
    "MarkerTracker",
    "Markers",
    "NoEstimateError",
    "Palette",
    "PaletteError",
    "RestFrame",
    "TooFewMarkersError",
    "Tracker",
    "TrackerError",
    "Tracks",
    "UnsupportedSensorError",
    "core_quantile",
    "detect_markers",
    "load_palette",
    "load_tracker",
    "max_ratio",
    "palette_names",
    "read_rest",
    "tracker_names",
]
