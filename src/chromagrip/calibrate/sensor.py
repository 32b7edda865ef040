"""Calibrate a sensor from pictures of known presses: least squares with priors.

By force a dome's mechanics, in the way of `press_fit`; by displacement a pad's gains.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from ..errors import UserError, located
from ..render import SensorDesign
from ..tracking import DEFAULT_TRACKER, GaussianProcess, NoEstimateError, SensorCalibration
from ..tracking.forces.calibration import FitReport, nominal_calibration
from ..tracking.forces.displacement import fit_gains
from ..tracking.forces.shifts import MarkerShifts
from .press_fit import predict, solve, unknowns_of, whitening
from .presses import LIST, Press, Seen, read_list, see_presses

Array = NDArray[np.float64]

#: Pairs this many times off the typical misfit are left out; at most this share of those that
#: move may be.
_OUTLIER, _OUTLIERS = 5.0, 0.1
#: Variance of what was not seen.
_UNKNOWN = 1e6
_PLACES, _SIZES = [0, 1, 3, 4], [2, 5]
#: Largest over smallest normal force: from one force alone, a wrong zero looks like stiffness.
_RANGE = 1.5
#: Largest lateral over normal force.
_STEEPEST = 0.9
#: A fit that leaves more than this share of the markers' motion is of another sensor …
_LEFT = 0.2
#: … and a stiffness known no better than this is not known.
_VAGUE = 0.1
#: What the node model itself is off by where the world is another one, as a share of forces.
_MODEL_ERROR = 0.02
_HINT = (
    "Check the forces, that each press began unloaded, and that the plate is stiff, flat and level"
)


@dataclass(frozen=True, kw_only=True)
class _Data:
    """Shifts of P pairs under K presses.

    Attributes
    ----------
    shifts: (x, y, log size) of both layers since rest, 0 where not seen, shape (K, P, 6)
    seen: shape (K, P)
    own: covariance of each press alone, shape (K, P, 6, 6)
    shared: covariance of the places at rest, an error that all presses have, shape (P, 6, 6)
    floor: variances that a nominal sensor is allowed, shape (6,)
    """

    shifts: Array
    seen: NDArray[np.bool_]
    own: Array
    shared: Array
    floor: Array


def calibrate_sensor(
    folder: Path,
    design: SensorDesign,
    *,
    tracker: str = DEFAULT_TRACKER,
    noise: float | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> tuple[SensorCalibration, FitReport]:
    """Calibration of the sensor that the pictures of a folder show.

    Presses of known force tell a dome's mechanics; presses of known displacement tell the gains of
    a flat pad, which has no force model.

    Parameters
    ----------
    folder: pictures and their list, see `presses`
    design: the sensor as it should be
    tracker: see `load_tracker`
    noise: of the camera [grey levels]; None estimates it
    tell: called with what is being done

    Raises
    ------
    UserError
        When the pictures cannot be used, or do not say enough, or no such sensor explains them.
    """
    where = folder / LIST
    presses, by_force = read_list(where)
    if by_force == design.shape.flat:
        raise UserError(
            f"list of presses {where} gives "
            + (
                "forces, but the sensor is a flat pad, which has no force model; wanted: depth_mm, "
                "shear_mm"
                if by_force
                else "displacements, but the sensor is a dome, which a plate displaces unevenly; "
                "wanted: normal_n, lateral_n"
            )
        )
    if by_force:
        _check_forces(presses, where)
    seen = see_presses(folder, presses, design, tracker, noise, tell)
    nominal = nominal_calibration(design)
    if not by_force:
        return _fit_displacement(nominal, seen, where)
    with threadpool_limits(1):
        return _fit_forces(nominal, seen, tell)


def _check_forces(presses: list[Press], where: Path) -> None:
    """Refuse forces that say nothing of a stiffness, or that no plate holds."""
    normal = [press.normal for press in presses]
    if max(normal) < _RANGE * min(normal):
        raise UserError(
            f"the presses of {where} have normal forces of {min(normal):g} to {max(normal):g} N, "
            f"which do not determine a stiffness; wanted: the largest at least {_RANGE:g} times "
            "the smallest"
        )
    steepest = max(presses, key=lambda press: abs(press.lateral) / press.normal)
    if abs(steepest.lateral) > _STEEPEST * steepest.normal:
        raise UserError(
            f"press {steepest.name} of {where} has {steepest.lateral:g} N beside a normal force of "
            f"{steepest.normal:g} N, at which a plate slips; allowed: {_STEEPEST:g} times as much"
        )


def _fit_displacement(
    nominal: SensorCalibration, seen: Seen, where: Path
) -> tuple[SensorCalibration, FitReport]:
    depth = np.array([press.normal for press in seen.presses])
    shear = np.array([press.lateral for press in seen.presses])
    with located(f"the presses of {where}"):
        gains = fit_gains(seen.rest, seen.tracks, depth, shear)
    report = FitReport(
        presses=tuple(press.name for press in seen.presses),
        noise_levels=seen.noise,
        error_px=gains.shift_deviation_px,
    )
    return replace(nominal, displacement=gains), report


def _measured(nominal: SensorCalibration, seen: Seen) -> _Data:
    shifts = MarkerShifts(nominal, seen.rest, np.inf)
    if not np.isfinite(shifts.rest_covariance).all():
        raise UserError(
            "the tracker does not tell how certain places and sizes are, which a force calibration "
            f"needs; wanted: {DEFAULT_TRACKER}"
        )
    both = [shifts(tracks, 0) for tracks in seen.tracks]
    known = np.array([visible for _, visible in both])
    moved = np.array([moved for moved, _ in both])
    own = np.array([tracks.covariance[shifts.pairs] for tracks in seen.tracks])
    return _Data(
        shifts=np.where(known[..., None], moved, 0.0),
        seen=known,
        own=np.where(known[..., None, None], own, _UNKNOWN * np.eye(6)),
        shared=shifts.rest_covariance,
        floor=shifts.floor,
    )


def _fit_forces(
    nominal: SensorCalibration, seen: Seen, tell: Callable[[str], None]
) -> tuple[SensorCalibration, FitReport]:
    unknowns = unknowns_of(nominal, seen.presses)
    data = _measured(nominal, seen)

    def missed(x: Array) -> Array:
        calibration, friction = unknowns.calibration(x)
        off = predict(calibration, friction, seen.rest, seen.presses) - data.shifts
        return np.where(data.seen[..., None], off, 0.0)

    tell(f"fitting {len(unknowns.spread)} values to {len(seen.presses)} presses")
    alone = data.own + data.shared + np.diag(data.floor)
    first = whitening(alone, np.zeros_like(data.shared))
    x, _ = solve(missed, unknowns, first, np.zeros(len(unknowns.spread)), robust=True)
    tell("fitting once more, without markers that are off")
    kept, moving = _without_outliers(missed(x), data.shifts, alone, data.seen)
    own = np.where(kept[..., None, None], data.own, _UNKNOWN * np.eye(6))
    data = replace(data, seen=kept, own=own)
    # A plate is not every object: what it leaves is the least, not all there is.
    noise = np.einsum("kpii->kpi", data.own + data.shared)[kept]
    left = np.maximum((missed(x)[kept] ** 2 - noise).mean(axis=0), data.floor)
    weights = whitening(data.own + np.diag(left), data.shared)
    x, slope = solve(missed, unknowns, weights, x, robust=False)
    covariance = np.asarray(np.linalg.inv(slope.T @ slope), dtype=float)
    deviations = unknowns.deviations(x, covariance)
    calibration, _ = unknowns.calibration(x)
    calibration = replace(
        calibration,
        position_floor=float(np.sqrt(left[_PLACES].mean())),
        size_floor=float(np.sqrt(left[_SIZES].mean())),
        stiffness_deviation=float(
            np.hypot(
                _MODEL_ERROR,
                deviations["tissue_stiffness_n_per_m"] / calibration.fingertip.tissue_stiffness,
            )
        ),
    )
    off = missed(x)
    _check_fit(off[kept & moving], data.shifts[kept & moving], calibration, deviations)
    tell("reading the forces of the presses")
    normal, friction = _force_errors(calibration, seen)
    return calibration, FitReport(
        presses=tuple(press.name for press in seen.presses),
        noise_levels=seen.noise,
        error_px=_places_rms(off[kept]),
        normal_error_share=normal,
        friction_error_n=friction,
        deviations=deviations,
    )


def _without_outliers(
    off: Array, shifts: Array, covariance: Array, seen: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Pairs (K, P) that are about where the others say, and those that the presses move."""
    missed, moved = (
        np.sqrt((v * np.linalg.solve(covariance, v[..., None])[..., 0]).sum(axis=-1))
        for v in (off, shifts)
    )
    limit = _OUTLIER * np.median(missed[seen])
    kept, moving = seen & (missed < limit), seen & (moved > limit)
    # Of the others there are many, and they say nothing.
    lost = float((moving & ~kept).sum() / max(1, moving.sum()))
    if lost > _OUTLIERS:
        raise UserError(
            f"{lost:.0%} of the markers that move are far from where a sensor near the design has "
            f"them; allowed: {_OUTLIERS:.0%}. {_HINT}"
        )
    return kept, moving


def _check_fit(
    off: Array, shifts: Array, calibration: SensorCalibration, deviations: dict[str, float]
) -> None:
    """Refuse a fit that is worth nothing, by the pairs (n, 6) that move."""
    error, motion = _places_rms(off), _places_rms(shifts)
    if error > _LEFT * motion:
        raise UserError(
            f"no sensor near the design explains the presses: of a motion of {motion:.2f} px RMS "
            f"it misses {error:.2f} px; allowed: {_LEFT:.0%}. {_HINT}"
        )
    vague = deviations["tissue_stiffness_n_per_m"] / calibration.fingertip.tissue_stiffness
    if vague > _VAGUE:
        raise UserError(
            f"the presses leave the stiffness open by {vague:.0%}; allowed: {_VAGUE:.0%}, wanted: "
            "more presses, and larger forces"
        )


def _places_rms(off: Array) -> float:
    """RMS of the places among (n, 6) numbers of pairs [px]; 0 of none."""
    return float(np.sqrt((off[:, _PLACES] ** 2).mean())) if len(off) else 0.0


def _force_errors(calibration: SensorCalibration, seen: Seen) -> tuple[float | None, float | None]:
    """RMS errors of the presses' forces as read: normal over itself, friction [N]."""
    reader = GaussianProcess(calibration, seen.rest)
    normal, friction = [], []
    for press, tracks in zip(seen.presses, seen.tracks, strict=True):
        reader.reset()
        try:
            field = reader.update(tracks)
        except NoEstimateError:
            continue
        normal.append(field.total_normal / press.normal - 1.0)
        friction.append(field.total_friction - abs(press.lateral))
    if not normal:
        return None, None
    return float(np.sqrt(np.mean(np.square(normal)))), float(np.sqrt(np.mean(np.square(friction))))
