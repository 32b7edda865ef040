"""Errors of ΣFn and Γ to expect of a calibrated dome, from simulated grips.

One specimen is a standard deviation of the fit stiffer than calibrated, one softer. Objects press
them and are pulled nearly to slip. The pictures are read with the calibration, at the camera's rate
and noise.
"""

import math
from collections.abc import Callable

import numpy as np
from msgspec.structs import asdict
from numpy.typing import NDArray

from ..control import GripObservation
from ..errors import UserError
from ..model import Solid, shapes
from ..render import SensorDesign
from ..sensing.reader import Reader
from ..sensing.sensor import TactileSensor
from ..tracking import SensorCalibration
from ..tracking.forces import SiliconeValues, silicone_names, silicone_of, with_silicone

Array = NDArray[np.float64]


def expected_errors(
    calibration: SensorCalibration,
    *,
    rate: float,
    noise: float,
    forces: tuple[float, float],
    tell: Callable[[str], None] = lambda text: None,
    grips: int = 24,
) -> dict[str, float]:
    """Errors of readings of simulated grips, see `grip_settings`.

    Parameters
    ----------
    calibration: calibration of a dome of silicone, with the covariance of its fit
    rate: rate of the frames [Hz]
    noise: standard deviation of a pixel [grey levels]
    forces: smallest and largest normal force [N]
    tell: function called with the current step, for a progress line
    grips: number of grips

    Returns
    -------
    RMS errors of ΣFn, as a share of it, and of Γ; shares of the frames that were read, and of these
    whose Γ is in its 90 % interval; number of grips
    """
    rows = list[list[float]]()
    for number, settings in enumerate(grip_settings(grips), 1):
        tell(f"simulated grip {number} of {grips}")
        # One specimen after the other, as an elasticity takes seconds to solve.
        design = specimen(calibration, 1.0 if 2 * number <= grips else -1.0)
        # A sensor gives the same noise after each `attach`.
        sensor = TactileSensor(design, noise=noise, seed=number)
        rows += grip_scores(calibration, sensor, settings, rate, noise, forces)
        sensor.close()
    scores = np.array(rows).reshape(-1, 3)
    read = scores[np.isfinite(scores).all(axis=1)]
    if not len(read):
        return {"read": 0.0, "grips": grips}
    normal, margin = np.sqrt((read[:, :2] ** 2).mean(axis=0)).tolist()
    return {
        "normal_error": normal,
        "margin_error": margin,
        "margin_inside": float(read[:, 2].mean()),
        "read": len(read) / len(scores),
        "grips": grips,
    }


def specimen(calibration: SensorCalibration, deviations: float) -> SensorDesign:
    """Sensor of another Young's modulus, and what by the covariance of the fit goes with it.

    Parameters
    ----------
    calibration: calibration of a dome of silicone
    deviations: how far Young's modulus is from the calibrated one [its standard deviations]
    """
    known, covariance = silicone_of(calibration), np.array(calibration.silicone_covariance)
    assert known is not None
    values = asdict(known)
    offsets = deviations * covariance[-1] / math.sqrt(covariance[-1, -1])
    for name, offset in zip(silicone_names(calibration.sensor), offsets.tolist(), strict=True):
        values[name] = max(values[name] + offset, 1e-6)
    values["poisson"] = min(values["poisson"], 0.494)
    return with_silicone(calibration, SiliconeValues(**values)).sensor


def grip_settings(count: int, seed: int = 0) -> Array:
    """Radius [m], µ, Γ at the end, and shares of kind, force and direction of grips, (count, 6).

    Radii are 8 to 30 mm, µ is 0.3 to 0.9 and Γ 0.2 to 0.6. Each number is spread evenly over the
    grips, so that few of them tell the errors of many.
    """
    rng, low, high = np.random.default_rng(seed), [8e-3, 0.3, 0.2], [30e-3, 0.9, 0.6]
    ranks = rng.permuted(np.tile(np.arange(count), (6, 1)), axis=1).T
    shares = (ranks + rng.random((count, 6))) / count
    shares[:, :3] = low + np.subtract(high, low) * shares[:, :3]
    return shares


def grip_scores(
    calibration: SensorCalibration,
    sensor: TactileSensor,
    settings: Array,
    rate: float,
    noise: float,
    forces: tuple[float, float],
) -> list[list[float]]:
    """Scores of a grip's frames from the end of its press on, see `scored`.

    A plane, a ball or a rod presses for 0.15 s, and is pulled for 0.25 s: the errors of a grip's
    frames are alike, so that more grips tell more than longer ones. A grip ends early where it is
    deeper than the model describes.

    Parameters
    ----------
    calibration, rate, noise, forces: see `expected_errors`
    sensor: specimen that is gripped
    settings: row of `grip_settings`
    """
    radius, friction, margin, kind, force, towards = settings.tolist()
    kinds = shapes.plane(), shapes.ball(radius), shapes.cylinder(radius)
    sensor.attach(Solid(shape=kinds[int(3 * kind)], friction=friction))
    reader = Reader(calibration, sensor.rest_frames(4), noise=noise)
    normal, angle = forces[0] * (forces[1] / forces[0]) ** force, 2.0 * math.pi * towards
    down, side = np.array([0.0, 0.0, -normal]), np.array([math.cos(angle), math.sin(angle), 0.0])
    across = (1.0 - margin) * friction * normal * side
    press, pull, rows = max(3, round(0.15 * rate)), max(3, round(0.25 * rate)), []
    for k in range(1, press + pull + 1):
        load = min(k / press, 1.0) * down + max(k - press, 0) / pull * across
        try:
            data = sensor.update(force=load, dt=1.0 / rate)
        except UserError:  # deeper than the model describes
            break
        read = reader.update(data.frame).observation
        if k >= press and read is not None:
            rows.append(scored(read, data.contact.field.total_normal, data.margin))
    return rows


def scored(read: GripObservation, normal: float, margin: float) -> list[float]:
    """Errors of ΣFn, as a share of the true one [N], and of Γ, and whether Γ is in its interval.

    All are NaN without an estimate.
    """
    if read.no_estimate:
        return [math.nan] * 3
    low, high = read.margin_interval
    return [read.field.total_normal / normal - 1.0, read.margin - margin, low <= margin <= high]
