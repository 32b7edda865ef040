"""What the image says: markers, then forces, f = argmin |y − J·K⁻¹·f|² + prior(f)."""

from .detection import Markers, RestFrame, detect_markers, read_rest
from .fit.tracker import MarkerTracker
from .forces.calibration import (
    SensorCalibration,
    load_calibration,
    nominal_calibration,
    shipped_readout,
)
from .forces.chain.contact_reading import ForcePrior
from .forces.chain.gaussian_process import MIN_MARKERS, GaussianProcess
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
    load_reconstructor,
)
from .forces.shifts import NoEstimateError
from .palette import DEFAULT_PALETTE, Palette, load_palette, palette_names
from .trackers import DEFAULT_TRACKER, Tracker, load_tracker, tracker_names
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
