"""What the image says: markers, then forces, f = argmin |y − J·K⁻¹·f|² + prior(f)."""

from .detection import DetectionError, Markers, RestFrame, detect_markers, read_rest
from .fit.tracker import MarkerTracker
from .forces.calibration import (
    CalibrationFileError,
    SensorCalibration,
    load_calibration,
    nominal_calibration,
    shipped_readout,
)
from .forces.chain.contact_reading import ForcePrior
from .forces.chain.gaussian_process import MIN_MARKERS, DivergedEstimateError, GaussianProcess
from .forces.chain.readout import ReadOutError
from .forces.chain.sensitivity import UnsupportedSensorError
from .forces.friction import (
    CAMERA_RULE,
    FRICTION,
    THESIS_RULE,
    Z90,
    FrictionEstimate,
    FrictionRule,
    core_quantile,
    max_ratio,
)
from .forces.reconstructors import (
    DEFAULT_RECONSTRUCTOR,
    RECONSTRUCTORS,
    Reconstructor,
    ReconstructorError,
    load_reconstructor,
)
from .forces.shifts import NoEstimateError, TooFewMarkersError
from .palette import DEFAULT_PALETTE, Palette, PaletteError, load_palette, palette_names
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
    "FRICTION",
    "MIN_MARKERS",
    "RECONSTRUCTORS",
    "THESIS_RULE",
    "Z90",
    "CalibrationFileError",
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
    "ReadOutError",
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
