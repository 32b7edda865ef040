"""Errors of ΣFn and Γ to expect of a calibrated dome, from simulated grips.

Objects press a specimen that is as calibrated, and are pulled nearly to slip. Its pictures are read
with the calibration, at the camera's rate and noise. What the fit leaves open of Young's modulus is
added to the error of ΣFn, which is proportional to it.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..control import GripObservation
from ..errors import UserError
from ..model import Solid, shapes
from ..sensing.reader import Reader
from ..sensing.sensor import TactileSensor
from ..tracking import SensorCalibration
from ..tracking.forces import silicone_of

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
        # A sensor gives the same noise after each `attach`.
        sensor = TactileSensor(calibration.sensor, noise=noise, seed=number)
        rows += grip_scores(calibration, sensor, settings, rate, noise, forces)
        sensor.close()
    scores = np.array(rows).reshape(-1, 3)
    read = scores[np.isfinite(scores).all(axis=1)]
    if not len(read):
        return {"read": 0.0, "grips": grips}
    normal, margin = np.sqrt((read[:, :2] ** 2).mean(axis=0)).tolist()
    silicone = silicone_of(calibration)
    assert silicone is not None
    left_open = math.sqrt(calibration.silicone_covariance[-1][-1]) / silicone.young_kpa
    return {
        "normal_error": math.hypot(normal, left_open),
        "margin_error": margin,
        "margin_inside": float(read[:, 2].mean()),
        "read": len(read) / len(scores),
        "grips": grips,
    }


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
