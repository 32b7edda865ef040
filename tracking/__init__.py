"""Estimates from camera frames: markers first, then the forces that moved them.

A tracker fits the light of each marker pair's pixels,
argmin Σ (I − γ·ground·(1 − a₀·C₀ − a₁·C₁ + b·C₀₁))²/σ², see `fit`.
A reconstructor estimates forces from the displacements y of the markers,
f = argmin |y − J·K⁻¹·f|² + prior(f), see `forces`.
Both get only the pixels, the rest frames and the calibration.
"""

from .detection import (
    RestFrame,
    check_told_apart,
    detect_markers,
    join_layers,
    read_rest,
    resting_ground,
)
from .edge import Edge
from .fit import FitSettings, MarkerTracker
from .forces import (
    AUTOMATIC,
    CAMERA_RULE,
    DEFAULT_RECONSTRUCTOR,
    FRICTION,
    METHODS,
    RECONSTRUCTORS,
    THESIS_RULE,
    Z90,
    ContactSettings,
    DisplacementGains,
    FrictionEstimate,
    FrictionRule,
    FrictionSettings,
    NoEstimateError,
    Reconstructor,
    SensorCalibration,
    check_reconstructor,
    core_quantile,
    load_calibration,
    load_reconstructor,
    max_ratio,
    nominal_calibration,
    sensor_as_designed,
    shipped_readout,
)
from .forces.chain import (
    LearnedSettings,
)
from .learned_palette import PaletteSettings, learn_palette
from .measured_spots import Markers
from .palette import AUTO_PALETTE, DEFAULT_PALETTE, Palette, load_palette, palette_names
from .sighting import Sighting, SightSettings, sight
from .trackers import DEFAULT_TRACKER, TRACKERS, Tracker, load_tracker, tracker_names
from .tracks import Tracks
from .unmixing import dye_densities, unmixing_matrix

__all__ = [
    "AUTOMATIC",
    "AUTO_PALETTE",
    "CAMERA_RULE",
    "DEFAULT_PALETTE",
    "DEFAULT_RECONSTRUCTOR",
    "DEFAULT_TRACKER",
    "FRICTION",
    "METHODS",
    "RECONSTRUCTORS",
    "THESIS_RULE",
    "TRACKERS",
    "Z90",
    "ContactSettings",
    "DisplacementGains",
    "Edge",
    "FitSettings",
    "FrictionEstimate",
    "FrictionRule",
    "FrictionSettings",
    "LearnedSettings",
    "MarkerTracker",
    "Markers",
    "NoEstimateError",
    "Palette",
    "PaletteSettings",
    "Reconstructor",
    "RestFrame",
    "SensorCalibration",
    "SightSettings",
    "Sighting",
    "Tracker",
    "Tracks",
    "check_reconstructor",
    "check_told_apart",
    "core_quantile",
    "detect_markers",
    "dye_densities",
    "join_layers",
    "learn_palette",
    "load_calibration",
    "load_palette",
    "load_reconstructor",
    "load_tracker",
    "max_ratio",
    "nominal_calibration",
    "palette_names",
    "read_rest",
    "resting_ground",
    "sensor_as_designed",
    "shipped_readout",
    "sight",
    "tracker_names",
    "unmixing_matrix",
]
