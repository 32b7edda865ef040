"""A read-out is trained when a sensor first needs one, and kept by design in the user's cache."""

import os
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import UserError, located

if TYPE_CHECKING:  # OpenCV loads only when something is trained
    from ..tracking import SensorCalibration

#: Random grips to learn from, unless more are chosen, …
HISTORIES = 8000
#: … passes over them, …
EPOCHS = 30
#: … and the noise of the camera, which a read-out knows by the factor from 0.3 to 4 [grey levels].
NOISE = 2.0


def ensure_readout(
    calibration: "SensorCalibration",
    tell: Callable[[str], None] = lambda text: None,
    workers: int | None = None,
) -> "SensorCalibration":
    """Add a read-out to a calibration: its own, the shipped or kept one, or one trained now.

    A training takes minutes. It is for the sensor as designed, and every calibration of the design
    shares it. After an interruption it goes on with the next call.

    Parameters
    ----------
    calibration: calibration of the sensor, from `load_calibration`
    tell: function called with the current step, for a progress line
    workers: number of processes (default: one for each core)

    Raises
    ------
    UserError
        When a read-out cannot be trained for the sensor, or cannot be kept.
    """
    if calibration.readout is not None:
        return calibration

    from .readout import train

    path = place_to_keep(calibration)
    if not path.is_file():
        workers = workers or os.cpu_count() or 1
        train(as_designed(calibration), NOISE, HISTORIES, EPOCHS, path, workers, tell)
    return replace(calibration, readout=path)


def training_notice(calibration: "SensorCalibration") -> str:
    """Announce the training by `ensure_readout` for a sensor without a read-out, in one sentence.

    Raises
    ------
    UserError
        As `ensure_readout`.
    """
    path = place_to_keep(calibration)
    begun = path.with_name(f"{path.name}.parts").is_dir()
    minutes = 7  # about what that takes on two cores [min]
    return (
        f"sensor {calibration.name} has no read-out yet: {'going on with' if begun else 'training'}"
        f" one on {HISTORIES} random grips, once, which takes some {minutes} minutes on two cores "
        f"(Ctrl-C keeps what is done); it is kept in {path}"
    )


def as_designed(calibration: "SensorCalibration") -> "SensorCalibration":
    """Nominal calibration of a sensor's design, under the same name."""
    from ..tracking import nominal_calibration

    return replace(nominal_calibration(calibration.nominal), name=calibration.name)


def place_to_keep(calibration: "SensorCalibration") -> Path:
    """File of a design's read-out in the user's cache folder, which can be written.

    Raises
    ------
    UserError
        When no read-out can be trained for the sensor, or none can be kept.
    """
    from ..tracking.forces import check_trainable, kept_path

    check_trainable(calibration)
    with located(f"sensor {calibration.name}".rstrip()):
        path = kept_path(calibration.nominal)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=path.parent).close()
    except OSError as error:
        raise UserError(
            f"read-outs cannot be kept in {path.parent}: {error.strerror}; set XDG_CACHE_HOME to a "
            "folder that can be written"
        ) from None
    return path
