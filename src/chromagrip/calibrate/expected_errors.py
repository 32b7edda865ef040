"""Errors of ΣFn and Γ to expect of a calibrated dome, from simulated grips of likely specimens.

A specimen is drawn around the calibrated silicone with the covariance of the fit. An object presses
it and is pulled nearly to slip, and its pictures are read with the calibration, at the camera's
rate and noise.
"""

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from msgspec.structs import asdict

from ..control import GripObservation
from ..errors import UserError
from ..model import Solid, shapes
from ..render import SensorDesign
from ..sensing.reader import Reader
from ..sensing.sensor import TactileSensor
from ..tracking import Z90, SensorCalibration
from ..tracking.forces import (
    SILICONE_ERROR,
    SiliconeValues,
    silicone_names,
    silicone_of,
    with_silicone,
)

#: What a frame of a grip is scored by: relative error of ΣFn, error of Γ, and whether the truth is
#: in their 90 % intervals.
SCORES = ("normal_error", "margin_error", "normal_inside", "margin_inside")


def expected_errors(
    calibration: SensorCalibration,
    *,
    rate: float,
    noise: float,
    forces: tuple[float, float],
    tell: Callable[[str], None] = lambda text: None,
    most: int = 12,
) -> dict[str, float]:
    """Errors of readings of simulated grips.

    Planes, balls and rods of radii of 8 to 30 mm, with µ of 0.3 to 0.9, press for 0.3 s and are
    then pulled for 0.5 s, until Γ is 0.2 to 0.6. Frames from the end of the press on are scored. A
    grip ends early where it is deeper than the model describes.

    Parameters
    ----------
    calibration: calibration of a dome of silicone, with the covariance of its fit
    rate: rate of the frames [Hz]
    noise: standard deviation of a pixel [grey levels]
    forces: smallest and largest normal force [N]
    tell: function called with the current step, for a progress line
    most: number of grips; fewer if they take more than a minute and a half

    Returns
    -------
    RMS of both errors of `SCORES`, both shares of its readings inside, the share of frames that
    were read, and the number of grips
    """
    begun, rows, count = time.monotonic(), list[list[float]](), 0
    # A new elasticity takes seconds to solve; all grips of the first specimen are made.
    alike, limit_s = 4, 80.0
    while count < most and (count < alike or time.monotonic() - begun < limit_s):
        tell(f"simulated grip {count + 1} of {most}")
        rng = np.random.default_rng([count, 1])
        design = specimen(calibration, np.random.default_rng(count // alike), rng)
        sensor = TactileSensor(design, noise=noise, seed=count)
        rows += _grip(calibration, sensor, rng, rate, noise, forces)
        sensor.close()
        count += 1
    values = np.array(rows).reshape(-1, len(SCORES))
    read = values[np.isfinite(values).all(axis=1)]
    if not len(read):
        return {"read": 0.0, "grips": count}
    size = np.concatenate([np.sqrt((read[:, :2] ** 2).mean(axis=0)), read[:, 2:].mean(axis=0)])
    found = dict(zip(SCORES, size.tolist(), strict=True))
    return found | {"read": len(read) / len(values), "grips": count}


def specimen(
    calibration: SensorCalibration, drawn: np.random.Generator, rng: np.random.Generator
) -> SensorDesign:
    """Sensor that is as likely as the calibrated one.

    Parameters
    ----------
    calibration: calibration of a dome of silicone
    drawn: source of what the fit leaves open
    rng: source of the error of the model of silicone, which presses do not reduce
    """
    silicone = silicone_of(calibration)
    assert silicone is not None
    values: dict[str, Any] = asdict(silicone)
    names, covariance = silicone_names(calibration.sensor), calibration.silicone_covariance
    for name, off in zip(
        names, drawn.multivariate_normal(np.zeros(len(names)), covariance), strict=True
    ):
        values[name] = max(values[name] + float(off), 1e-6)
    values["poisson"] = min(values["poisson"], 0.494)
    values["young_kpa"] *= math.exp(SILICONE_ERROR * rng.standard_normal())
    return with_silicone(calibration, SiliconeValues(**values)).sensor


def scored(read: GripObservation, normal: float, margin: float) -> list[float]:
    """A reading against the true ΣFn [N] and Γ, in the order of `SCORES`; NaN without estimate."""
    if read.no_estimate:
        return [math.nan] * len(SCORES)
    (low, high), (left, right) = normal_interval(read), read.margin_interval
    off = read.field.total_normal / normal - 1.0
    return [off, read.margin - margin, low <= normal <= high, left <= margin <= right]


def normal_interval(read: GripObservation) -> tuple[float, float]:
    """90 % interval of ΣFn [N]."""
    half = Z90 * math.sqrt(read.field.totals_covariance[0, 0])
    return max(read.field.total_normal - half, 0.0), read.field.total_normal + half


def _grip(
    calibration: SensorCalibration,
    sensor: TactileSensor,
    rng: np.random.Generator,
    rate: float,
    noise: float,
    forces: tuple[float, float],
) -> list[list[float]]:
    """Scores of the frames of a random grip."""
    radius, friction, margin = rng.uniform([8e-3, 0.3, 0.2], [30e-3, 0.9, 0.6])
    kinds = shapes.plane(), shapes.ball(radius), shapes.cylinder(radius)
    sensor.attach(Solid(shape=kinds[rng.integers(3)], friction=friction))
    reader = Reader(calibration, sensor.rest_frames(4), noise=noise)
    normal, towards = math.exp(rng.uniform(*np.log(forces))), rng.uniform(0.0, 2.0 * math.pi)
    down = np.array([0.0, 0.0, -normal])
    across = (
        (1.0 - margin) * friction * normal * np.array([math.cos(towards), math.sin(towards), 0])
    )
    press, pull, rows = max(3, round(0.3 * rate)), max(3, round(0.5 * rate)), []
    for k in range(1, press + pull + 1):
        force = min(k / press, 1.0) * down + max(k - press, 0) / pull * across
        try:
            data = sensor.update(force=force, dt=1.0 / rate)
        except UserError:  # deeper than the model describes
            break
        read = reader.update(data.frame).observation
        if k >= press and read is not None:
            rows.append(scored(read, data.contact.field.total_normal, data.margin))
    return rows
