"""Forces and friction from tracks: f = argmin |y − J·K⁻¹·f|² + prior(f); slipping, µ = |Ff|/Fn.

This package holds what all bodies share: calibration, marker shifts, friction, and reconstructors
by name. `chain` and `dome` hold the reconstructors of each body.
"""

from .calibration import (
    FitReport,
    SensorCalibration,
    calibration_table,
    check_trainable,
    load_calibration,
    nominal_calibration,
    required_readout,
    sensor_as_designed,
    shipped_readout,
    silicone_of,
    with_silicone,
)
from .displacement import DisplacementGains, fit_gains, skin_displacement
from .dome import ContactSettings, untouched_field
from .friction import (
    CAMERA_RULE,
    FRICTION,
    THESIS_RULE,
    Z90,
    FrictionEstimate,
    FrictionRule,
    FrictionSettings,
    core_quantile,
    max_ratio,
)
from .kept_readouts import TRAINING, kept_path, kept_readout, training_key
from .pose import Alignment, CameraPose, PoseTable, aligned, alignment, pose_words, seen_by
from .reconstructors import (
    AUTOMATIC,
    DEFAULT_RECONSTRUCTOR,
    DOME_METHODS,
    METHODS,
    RECONSTRUCTORS,
    NoEstimateError,
    Reconstructor,
    body_read,
    check_reconstructor,
    load_reconstructor,
    name_used,
    needs_readout,
)
from .rest_fit import rest_pose
from .rest_settings import PoseSettings
from .shifts import MEASURED, MarkerShifts, floor_variances
from .silicone_values import SILICONE_ERROR, SiliconeValues, silicone_names, yellow_moves

__all__ = [
    "AUTOMATIC",
    "CAMERA_RULE",
    "DEFAULT_RECONSTRUCTOR",
    "DOME_METHODS",
    "FRICTION",
    "MEASURED",
    "METHODS",
    "RECONSTRUCTORS",
    "SILICONE_ERROR",
    "THESIS_RULE",
    "TRAINING",
    "Z90",
    "Alignment",
    "CameraPose",
    "ContactSettings",
    "DisplacementGains",
    "FitReport",
    "FrictionEstimate",
    "FrictionRule",
    "FrictionSettings",
    "MarkerShifts",
    "NoEstimateError",
    "PoseSettings",
    "PoseTable",
    "Reconstructor",
    "SensorCalibration",
    "SiliconeValues",
    "aligned",
    "alignment",
    "body_read",
    "calibration_table",
    "check_reconstructor",
    "check_trainable",
    "core_quantile",
    "fit_gains",
    "floor_variances",
    "kept_path",
    "kept_readout",
    "load_calibration",
    "load_reconstructor",
    "max_ratio",
    "name_used",
    "needs_readout",
    "nominal_calibration",
    "pose_words",
    "required_readout",
    "rest_pose",
    "seen_by",
    "sensor_as_designed",
    "shipped_readout",
    "silicone_names",
    "silicone_of",
    "skin_displacement",
    "training_key",
    "untouched_field",
    "with_silicone",
    "yellow_moves",
]
