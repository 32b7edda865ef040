"""What the image says: markers, then forces, f = argmin |y − J·K⁻¹·f|² + prior(f)."""

from .detection import Markers, RestFrame, detect_markers, read_rest
from .fit.tracker import MarkerTracker
from .forces import (
    CAMERA_RULE,
    DEFAULT_RECONSTRUCTOR,
    FRICTION,
    METHODS,
    RECONSTRUCTORS,
    THESIS_RULE,
    Z90,
    FrictionEstimate,
    FrictionRule,
    NoEstimateError,
    Reconstructor,
    SensorCalibration,
    check_reconstructor,
    core_quantile,
    load_calibration,
    load_reconstructor,
    max_ratio,
    nominal_calibration,
    shipped_readout,
)
from .forces.chain import MIN_MARKERS, ForcePrior, GaussianProcess
from .palette import DEFAULT_PALETTE, Palette, load_palette, palette_names
from .trackers import DEFAULT_TRACKER, Tracker, load_tracker, tracker_names
from .tracks import Tracks

__all__ = [
    "CAMERA_RULE",
    "DEFAULT_PALETTE",
    "DEFAULT_RECONSTRUCTOR",
    "DEFAULT_TRACKER",
    "FRICTION",
    "METHODS",
    "MIN_MARKERS",
    "RECONSTRUCTORS",
    "THESIS_RULE",
    "Z90",
    "ForcePrior",
    "FrictionEstimate",
    "FrictionRule",
    "GaussianProcess",
    "MarkerTracker",
    "Markers",
    "NoEstimateError",
    "Palette",
    "Reconstructor",
    "RestFrame",
    "SensorCalibration",
    "Tracker",
    "Tracks",
    "check_reconstructor",
    "core_quantile",
    "detect_markers",
    "load_calibration",
    "load_palette",
    "load_reconstructor",
    "load_tracker",
    "max_ratio",
    "nominal_calibration",
    "palette_names",
    "read_rest",
    "shipped_readout",
    "tracker_names",
]
