"""Reconstructor, read-out and calibration behind the forces of a summary."""

import hashlib
from pathlib import Path
from typing import TypedDict

from ....by_name import Choice
from ..calibration import SHIPPED, SensorCalibration, required_readout
from ..kept_readouts import kept_readout
from ..reconstructors import name_used, needs_readout
from .readout import load_readout


class UsedReadOut(TypedDict):
    """Read-out in a summary.

    `file` is its name, or `shipped` or `kept`. `digest` is the beginning of its SHA-256.
    `histories` is the number of training histories, None if its file does not state it.
    """

    file: str
    digest: str
    histories: int | None


class Used(TypedDict):
    """Reconstructor, read-out and spread of the stiffness in a summary."""

    reconstructor: str
    readout: UsedReadOut | None
    stiffness_deviation: float


def used(choice: Choice, calibration: SensorCalibration) -> Used:
    """Describe the reconstructor of a choice, its read-out, and the spread of the stiffness.

    Raises
    ------
    UserError
        When it needs a read-out and the sensor has none, or one that cannot be read.
    """
    path = required_readout(calibration) if needs_readout(choice, calibration) else None
    return {
        "reconstructor": name_used(choice, calibration),
        "readout": None if path is None else _described(path, calibration),
        "stiffness_deviation": calibration.stiffness_deviation,
    }


def readout_origin(path: Path, calibration: SensorCalibration) -> str:
    """Origin of a read-out: `shipped`, `kept`, or the name of its file."""
    if path.parent == SHIPPED:
        return "shipped"
    return "kept" if path == kept_readout(calibration.nominal) else path.name


def readout_digest(path: Path) -> str:
    """Beginning of the SHA-256 of a read-out's file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:12]


def histories_of(path: Path) -> int | None:
    """Number of histories a read-out was trained on; None if its file does not state it."""
    training = load_readout(path).ranges.get("training")
    count = training.get("histories") if isinstance(training, dict) else None
    return count if isinstance(count, int) else None


def _described(path: Path, calibration: SensorCalibration) -> UsedReadOut:
    histories = histories_of(path)  # says so where the file cannot be read
    return {
        "file": readout_origin(path, calibration),
        "digest": readout_digest(path),
        "histories": histories,
    }
