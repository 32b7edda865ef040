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
    """Read-out of a summary.

    `file` is its name, or `shipped` or `kept`; `digest` begins its SHA-256; `histories` are those
    that it was trained on, None where its file does not say.
    """

    file: str
    digest: str
    histories: int | None


class Used(TypedDict):
    """Part of a summary that says what forces were read with."""

    reconstructor: str
    readout: UsedReadOut | None
    stiffness_deviation: float


def used(choice: Choice, calibration: SensorCalibration) -> Used:
    """Reconstructor that a choice stands for, its read-out, and the spread of the stiffness.

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
    """`shipped`, `kept`, or the name of the read-out's file."""
    if path.parent == SHIPPED:
        return "shipped"
    return "kept" if path == kept_readout(calibration.nominal) else path.name


def readout_digest(path: Path) -> str:
    """First digits of the SHA-256 of a read-out's file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:12]


def histories_of(path: Path) -> int | None:
    """Histories that a read-out was trained on; None where its file does not say."""
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
