"""What an estimator may know of a sensor beside its rest frame."""

from dataclasses import dataclass
from pathlib import Path

from ..model import Fingertip
from ..render import SensorDesign


@dataclass(frozen=True, kw_only=True)
class SensorCalibration:
    """Calibration of one sensor: its image, its mechanics, and how far either can be trusted.

    Attributes
    ----------
    sensor: calibration of the image
    fingertip: calibration of the mechanics
    position_floor: model error of a marker's motion, added to its noise [px]
    size_floor: model error of a marker's logarithmic size
    readout: trained read-out of this kind of sensor; None if it has none
    """

    sensor: SensorDesign
    fingertip: Fingertip
    position_floor: float = 0.02
    size_floor: float = 3e-4
    readout: Path | None = None
