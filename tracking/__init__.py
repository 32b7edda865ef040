"""What the image says: markers, then forces, f = argmin |y − J·K⁻¹·f|² + prior(f)."""

from .calibration import SensorCalibration
from .detection import DetectionError, Markers, RestFrame, detect_markers, read_rest
from .friction import (
    CAMERA_RULE,
    THESIS_RULE,
    Z90,
    FrictionEstimate,
    FrictionRule,
    core_quantile,
    max_ratio,
)
from .gaussian_process import MIN_MARKERS, DivergedEstimateError, ForcePrior, GaussianProcess
from .palette import DEFAULT_PALETTE, Palette, PaletteError, load_palette, palette_names
from .reconstructors import (
    DEFAULT_RECONSTRUCTOR,
    RECONSTRUCTORS,
    Reconstructor,
    ReconstructorError,
    load_reconstructor,
)
from .sensitivity import UnsupportedSensorError
from .shifts import NoEstimateError, TooFewMarkersError
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
    "DEFAULT_RECONSTRUCTOR",
    "DEFAULT_TRACKER",
    "MIN_MARKERS",
    "RECONSTRUCTORS",
    "THESIS_RULE",
    "Z90",
    "DetectionError",
    "DivergedEstimateError",
    "ForcePrior",
    "FrameError",
    "FrictionEstimate",
    "FrictionRule",
    "GaussianProcess",
    "MarkerTracker",
    "Markers",
    "NoEstimateError",
    "Palette",
    "PaletteError",
    "Reconstructor",
    "ReconstructorError",
    "RestFrame",
    "SensorCalibration",
    "TooFewMarkersError",
    "Tracker",
    "TrackerError",
    "Tracks",
    "UnsupportedSensorError",
    "core_quantile",
    "detect_markers",
    "load_palette",
    "load_reconstructor",
    "load_tracker",
    "max_ratio",
    "palette_names",
    "read_rest",
    "tracker_names",
]
