"""A dome's silicone from tracked presses: which markers count, the fit, and what it leaves."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...model import ModelError
from ...render import layer_depths
from ...tracking import SensorCalibration
from ...tracking.forces import (
    SILICONE_ERROR,
    FitReport,
    MarkerShifts,
    rest_pose,
    with_silicone,
)
from ...tracking.forces.dome import INDEPENDENT, ON_CORE, PLACE_ERROR, SIZE_ERROR
from ..presses import Pressed
from .fit import Data, SiliconeFit, fit_silicone

Array = NDArray[np.float64]

#: Ends the refusal of presses that no silicone near the design explains.
_HINT = "Check forces and radii, that each press began unloaded, and that plates and balls are hard"


def fit_presses(
    nominal: SensorCalibration, pressed: Pressed, tell: Callable[[str], None]
) -> tuple[SensorCalibration, FitReport]:
    """Calibration of the silicone, and how well it explains the presses.

    Parameters
    ----------
    nominal: calibration of the design, which has silicone
    pressed: tracks of the presses
    tell: called with the current step, for a progress line

    Raises
    ------
    UserError
        When no silicone near the design explains the presses, or they do not determine it.
    """
    pose = rest_pose(nominal.sensor, pressed.rest)
    shifts = MarkerShifts(nominal, pressed.rest, np.inf, pose)
    if not np.isfinite(shifts.rest_covariance).all():
        raise UserError(
            "the tracker does not state how certain places and sizes are, which a force "
            "calibration needs; wanted: fit"
        )
    tell("elasticity of the dome as designed")
    data = _data(nominal, shifts, pressed)
    fit = SiliconeFit(nominal, pressed.rest, pose, data)
    tell(f"places of {len(data.presses)} presses")
    with _calculable():
        point = fit.settled(fit.start(), rounds=12)
    kept = _without_outliers(fit.seen(point), data)
    data = _weighted(shifts, pressed, replace(data, visible=kept))
    fit = SiliconeFit(nominal, pressed.rest, pose, data)
    with _calculable():
        point, covariance, held = fit_silicone(fit, point, rounds=4, tell=tell)
    values, count = fit.values(point.x), len(fit.names)
    young = count - 1
    # By their own names: all as they are but E, which is over its share.
    scale = fit.spread[:count].copy()
    scale[young] *= values.young_kpa
    own = covariance[:count, :count] * np.outer(scale, scale)
    spread = np.sqrt(np.diag(own))
    share = point.held[:, 0] * math.exp(fit.spread[young] * point.x[young])
    forces = share / [press.normal for press in data.presses] - 1.0
    error = (fit.seen(point) - data.shifts)[kept][:, data.tells]
    _check(error, data.shifts[kept][:, data.tells], forces, float(spread[young] / values.young_kpa))
    read = math.sqrt(float(np.diag(covariance)[count:].max()))
    calibration = replace(
        with_silicone(nominal, values),
        stiffness_deviation=math.hypot(SILICONE_ERROR, read),
    )
    return calibration, FitReport(
        presses=tuple(press.name for press in data.presses),
        noise_levels=pressed.noise,
        error_px=_places_rms(error),
        normal_error_share=float(np.sqrt(np.mean(forces**2))),
        deviations=dict(zip(fit.names, spread.tolist(), strict=True)),
        covariance=tuple(tuple(row) for row in own.tolist()),
        undetermined=tuple(name for name, out in zip(fit.names, held, strict=True) if out),
    )


@contextmanager
def _calculable() -> Iterator[None]:
    """Say what may be wrong where a press cannot be calculated."""
    try:
        yield
    except ModelError as error:
        raise UserError(f"the presses cannot be calculated: {error}. {_HINT}") from None


def _data(nominal: SensorCalibration, shifts: MarkerShifts, pressed: Pressed) -> Data:
    """Collect the measurements of the presses."""
    dome = nominal.sensor.dome
    both = [shifts(tracks, 0) for tracks in pressed.tracks]
    visible = np.array([mask for _, mask in both])
    moved = np.array([moved for moved, _ in both])
    moving = np.array(layer_depths(nominal.sensor, dome)) < (1.0 - ON_CORE) * dome.thickness
    data = Data(
        presses=pressed.presses,
        shifts=np.where(visible[..., None], moved, 0.0),
        visible=visible,
        tells=np.flatnonzero(np.repeat(moving, 3)),
        weights=np.zeros((0, 0, 0)),
    )
    return _weighted(shifts, pressed, data)


def _weighted(shifts: MarkerShifts, pressed: Pressed, data: Data) -> Data:
    """The data with the weights of their visible pairs."""
    square = data.tells[:, None], data.tells
    # It is alike in all presses, which count as a few independent ones.
    floor = np.tile([PLACE_ERROR, PLACE_ERROR, SIZE_ERROR], 2) ** 2
    floor *= max(1.0, len(data.presses) / INDEPENDENT)
    own = np.array([shifts.covariance(tracks) for tracks in pressed.tracks]) + np.diag(floor)
    unknown = 1e6  # variance of a pair that was not visible [px²]
    own = np.where(data.visible[..., None, None], own, unknown * np.eye(6))
    shared = shifts.rest_covariance
    weights = _whitening(own[:, :, *square], shared[:, *square])
    return replace(data, weights=weights)


def _whitening(own: Array, shared: Array) -> Array:
    """Matrices that make the errors of a pair in all presses independent, (P, KW, KW).

    Parameters
    ----------
    own: covariance of each press alone, shape (K, P, W, W)
    shared: covariance that all presses have in common, shape (P, W, W)
    """
    presses, each = len(own), shared.shape[-1]
    covariance = np.tile(shared, (1, presses, presses))
    for k in range(presses):
        block = slice(each * k, each * (k + 1))
        covariance[:, block, block] += own[k]
    return np.linalg.inv(np.linalg.cholesky(covariance))


def _without_outliers(seen: Array, data: Data) -> NDArray[np.bool_]:
    """Pairs (K, P) whose shifts are about as far from what is to be seen as the median."""
    scale = np.tile([PLACE_ERROR, PLACE_ERROR, SIZE_ERROR], 2)[data.tells]
    off = (seen - data.shifts)[..., data.tells] / scale
    missed, moved = (
        np.linalg.norm(v, axis=-1) for v in (off, data.shifts[..., data.tells] / scale)
    )
    outlier = 5.0  # pairs whose misfit is more than this many times the median's are left out
    limit = outlier * max(float(np.median(missed[data.visible])), 1.0)
    kept, moving = data.visible & (missed < limit), data.visible & (moved > limit)
    # Who is off alike in all presses was read wrong at rest, as at a seam: no press is to blame.
    seen_in = data.visible[..., None]
    alike = np.where(seen_in, off, 0.0).sum(axis=0) / np.maximum(seen_in.sum(axis=0), 1)
    varied = np.where(data.visible, np.linalg.norm(off - alike, axis=-1), 0.0).max(axis=0)
    own = (np.linalg.norm(alike, axis=-1) > limit) & (varied < limit)
    kept, moving = kept & ~own, moving & ~own
    lost = float((moving & ~kept).sum() / max(1, moving.sum()))
    outlier_share = 0.1  # largest share of the pairs that move that may be left out
    if lost > outlier_share:
        raise UserError(
            f"{lost:.0%} of the markers that move are far from where silicone near the design has "
            f"them; allowed: {outlier_share:.0%}. {_HINT}"
        )
    return np.asarray(kept)


def _check(error: Array, shifts: Array, forces: Array, vague: float) -> None:
    """Refuse large errors of the pairs (n, W) or forces (K,), and a vague stiffness."""
    missed, motion = _places_rms(error), _places_rms(shifts)
    most_left = 0.2  # largest error of a fit, as a share of the markers' motion
    if missed > most_left * motion:
        raise UserError(
            f"no silicone near the design explains the presses: of a motion of {motion:.2f} px RMS "
            f"it misses {missed:.2f} px; allowed: {most_left:.0%}. {_HINT}"
        )
    most_force_left = 0.1  # the same of the forces
    if abs(forces).max() > most_force_left:
        raise UserError(
            f"no silicone near the design explains the presses: a force is off by "
            f"{abs(forces).max():.0%}; allowed: {most_force_left:.0%}. {_HINT}"
        )
    # Largest deviation of Young's modulus that counts as determined, as a share of it.
    vague_from = 0.1
    if vague > vague_from:
        raise UserError(
            f"the presses leave Young's modulus open by {vague:.0%}; allowed: {vague_from:.0%}, "
            "wanted: more presses, and larger forces"
        )


def _places_rms(values: Array) -> float:
    """RMS of the places among (n, W) measurements of pairs [px]; 0 of none."""
    places = values.reshape(len(values), -1, 3)[..., :2]
    return float(np.sqrt((places**2).mean())) if places.size else 0.0
