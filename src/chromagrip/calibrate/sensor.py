"""Calibrate a sensor from pictures of known presses: least squares with priors.

By force a dome's mechanics, in the way of `press_fit`, or those of a dome of silicone, in the way
of `dome`; by displacement a pad's gains.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tomli_w
from numpy.typing import NDArray

from ..errors import UserError, located
from ..folders import write_whole
from ..output.processes import one_thread
from ..render import SensorDesign
from ..scene.scene import Body
from ..stored_pictures import MEGAPIXELS
from ..tracking import DEFAULT_TRACKER, SensorCalibration
from ..tracking.forces import (
    CameraPose,
    FitReport,
    MarkerShifts,
    aligned,
    alignment,
    body_read,
    calibration_table,
    check_stiff,
    fit_gains,
    nominal_calibration,
    rest_pose,
)
from .dome.silicone import fit_presses
from .press_fit import predict, solve, unknowns_of, whitening
from .presses import LIST, Press, Pressed, read_list, track_presses

Array = NDArray[np.float64]

#: Variance of a pair that was not visible [px²].
_UNKNOWN = 1e6
#: Columns of the places among the measurements of a pair.
_PLACES = [0, 1, 3, 4]
#: Ends the refusal of presses that no sensor near the design explains.
_HINT = (
    "Check the forces, that each press began unloaded, and that the plate is stiff, flat and level"
)


@dataclass(frozen=True, kw_only=True)
class _Data:
    """Shifts of P pairs under K presses.

    Attributes
    ----------
    shifts: (x, y, log size) of both layers since rest, 0 where not visible, shape (K, P, 6)
    visible: visible pairs, shape (K, P)
    own: covariance of each press alone, shape (K, P, 6, 6)
    shared: covariance of the measurements at rest, the same error in all presses, shape (P, 6, 6)
    floor: variances of a nominal sensor's own errors, shape (6,)
    pose: pose of the camera
    """

    shifts: Array
    visible: NDArray[np.bool_]
    own: Array
    shared: Array
    floor: Array
    pose: CameraPose


def calibrate_sensor(
    folder: Path,
    design: SensorDesign,
    *,
    tracker: str = DEFAULT_TRACKER,
    noise: float | None = None,
    tell: Callable[[str], None] = lambda text: None,
    max_megapixels: float = MEGAPIXELS,
) -> tuple[SensorCalibration, FitReport]:
    """Calibrate the sensor in the pictures of a folder.

    Presses of known force determine a dome's mechanics: those of the silicone if forces are
    estimated with it (`body_read`), else those of the chain. Presses of known displacement
    determine the gains of a flat pad, which has no force model.

    Parameters
    ----------
    folder: folder of the pictures and their list, see `presses`
    design: design of the sensor
    tracker: see `load_tracker` (default `fit`)
    noise: standard deviation of a pixel [grey levels] (default: estimated)
    tell: function called with the current step, for a progress line
    max_megapixels: largest picture that is decoded [10⁶ pixels]

    Raises
    ------
    UserError
        When the pictures cannot be used, do not determine the sensor, or no sensor near the design
        explains them.
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
    nominal = nominal_calibration(design)
    check, fit = _BY_FORCE[body_read(nominal)]
    if by_force:
        _check_forces(presses, where)
        check(presses, where)
    pressed = track_presses(folder, presses, design, tracker, noise, tell, max_megapixels)
    if not by_force:
        return _fit_displacement(nominal, pressed, where)
    with one_thread():
        return fit(nominal, pressed, tell)


def _check_forces(presses: list[Press], where: Path) -> None:
    """Refuse forces that do not determine a stiffness, or at which a plate slips."""
    normal = [press.normal for press in presses]
    # Smallest ratio of the largest to the smallest normal force: with one force alone, a wrong zero
    # of the force sensor looks like stiffness.
    least_range = 1.5
    if max(normal) < least_range * min(normal):
        raise UserError(
            f"the presses of {where} have normal forces of {min(normal):g} to {max(normal):g} N, "
            f"which do not determine a stiffness; wanted: the largest at least {least_range:g} "
            "times the smallest"
        )
    steepest = max(presses, key=lambda press: abs(press.lateral) / press.normal)
    allowed = 0.9  # largest ratio of lateral to normal force
    if abs(steepest.lateral) > allowed * steepest.normal:
        raise UserError(
            f"press {steepest.name} of {where} has {steepest.lateral:g} N with a normal force of "
            f"{steepest.normal:g} N, at which a plate slips; allowed: {allowed:g} times as much"
        )


def _check_plates(presses: list[Press], where: Path) -> None:
    """Refuse balls and torques, which the chain does not describe."""
    for press in presses:
        if press.radius or press.torque:
            raise UserError(
                f"press {press.name} of {where} has a radius_mm or torque_nmm; allowed: those of a "
                "sensor that is read as a dome of silicone"
            )


def _fit_displacement(
    nominal: SensorCalibration, pressed: Pressed, where: Path
) -> tuple[SensorCalibration, FitReport]:
    depth = np.array([press.normal for press in pressed.presses])
    shear = np.array([press.lateral for press in pressed.presses])
    with located(f"the presses of {where}"):
        # Gains refer to the design's camera, like later estimates.
        pose = rest_pose(nominal.sensor, pressed.rest)
        align = alignment(pose, nominal.sensor.view.camera, pressed.rest.position)
        tracks = [aligned(align, one) for one in pressed.tracks]
        gains = fit_gains(aligned(align, pressed.rest), tracks, depth, shear)
    report = FitReport(
        presses=tuple(press.name for press in pressed.presses),
        noise_levels=pressed.noise,
        error_px=gains.shift_deviation_px,
    )
    return replace(nominal, displacement=gains), report


def _measured(nominal: SensorCalibration, pressed: Pressed) -> _Data:
    shifts = MarkerShifts(nominal, pressed.rest, np.inf)
    if not np.isfinite(shifts.rest_covariance).all():
        raise UserError(
            "the tracker does not state how certain places and sizes are, which a force "
            f"calibration needs; wanted: {DEFAULT_TRACKER}"
        )
    both = [shifts(tracks, 0) for tracks in pressed.tracks]
    visible = np.array([mask for _, mask in both])
    moved = np.array([moved for moved, _ in both])
    own = np.array([shifts.covariance(tracks) for tracks in pressed.tracks])
    return _Data(
        shifts=np.where(visible[..., None], moved, 0.0),
        visible=visible,
        own=np.where(visible[..., None, None], own, _UNKNOWN * np.eye(6)),
        shared=shifts.rest_covariance,
        floor=shifts.floor,
        pose=shifts.pose,
    )


def _fit_forces(
    nominal: SensorCalibration, pressed: Pressed, tell: Callable[[str], None]
) -> tuple[SensorCalibration, FitReport]:
    check_stiff(nominal.sensor)
    unknowns = unknowns_of(nominal, pressed.presses)
    data = _measured(nominal, pressed)

    def missed(x: Array) -> Array:
        calibration, friction = unknowns.calibration(x)
        predicted = predict(calibration, friction, pressed.rest, pressed.presses, data.pose)
        return np.where(data.visible[..., None], predicted - data.shifts, 0.0)

    tell(f"fitting {len(unknowns.spread)} values to {len(pressed.presses)} presses")
    alone = data.own + data.shared + np.diag(data.floor)
    first = whitening(alone, np.zeros_like(data.shared))
    x, _ = solve(missed, unknowns, first, np.zeros(len(unknowns.spread)), robust=True)
    tell("fitting once more, without outliers")
    kept, moving = _without_outliers(missed(x), data.shifts, alone, data.visible)
    own = np.where(kept[..., None, None], data.own, _UNKNOWN * np.eye(6))
    data = replace(data, visible=kept, own=own)
    # Other objects than a plate leave larger errors than these.
    noise = np.einsum("kpii->kpi", data.own + data.shared)[kept]
    residual = np.maximum((missed(x)[kept] ** 2 - noise).mean(axis=0), data.floor)
    weights = whitening(data.own + np.diag(residual), data.shared)
    x, slope = solve(missed, unknowns, weights, x, robust=False)
    covariance = np.asarray(np.linalg.inv(slope.T @ slope), dtype=float)
    deviations = unknowns.deviations(x, covariance)
    calibration, plate = unknowns.calibration(x)
    sizes = [2, 5]  # columns of the log sizes
    # Error of the node model itself where the finger is another one, as a share of forces.
    model_error = 0.02
    calibration = replace(
        calibration,
        position_floor=float(np.sqrt(residual[_PLACES].mean())),
        size_floor=float(np.sqrt(residual[sizes].mean())),
        stiffness_deviation=float(
            np.hypot(
                model_error,
                deviations["tissue_stiffness_n_per_m"] / calibration.fingertip.tissue_stiffness,
            )
        ),
    )
    error = missed(x)
    _check_fit(error[kept & moving], data.shifts[kept & moving], calibration, deviations)
    normal, lateral = _forces_left(calibration, plate, pressed, data, residual)
    return calibration, FitReport(
        presses=tuple(press.name for press in pressed.presses),
        noise_levels=pressed.noise,
        error_px=_places_rms(error[kept]),
        normal_error_share=normal,
        friction_error_n=lateral,
        deviations=deviations,
    )


def _without_outliers(
    error: Array, shifts: Array, covariance: Array, visible: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Find pairs (K, P) whose error is near the median, and those that the presses move."""
    missed, moved = (
        np.sqrt((v * np.linalg.solve(covariance, v[..., None])[..., 0]).sum(axis=-1))
        for v in (error, shifts)
    )
    outlier = 5.0  # pairs whose misfit is more than this many times the median's are left out
    limit = outlier * np.median(missed[visible])
    kept, moving = visible & (missed < limit), visible & (moved > limit)
    # Pairs that hold still are many, and do not show whether the fit is right.
    lost = float((moving & ~kept).sum() / max(1, moving.sum()))
    outlier_share = 0.1  # largest share of the pairs that move that may be left out
    if lost > outlier_share:
        raise UserError(
            f"{lost:.0%} of the markers that move are far from where a sensor near the design has "
            f"them; allowed: {outlier_share:.0%}. {_HINT}"
        )
    return kept, moving


def _check_fit(
    error: Array, shifts: Array, calibration: SensorCalibration, deviations: dict[str, float]
) -> None:
    """Refuse a fit with large errors of the pairs (n, 6) that move, or of a vague stiffness."""
    missed, motion = _places_rms(error), _places_rms(shifts)
    most_left = 0.2  # largest error of a fit, as a share of the markers' motion
    if missed > most_left * motion:
        raise UserError(
            f"no sensor near the design explains the presses: of a motion of {motion:.2f} px RMS "
            f"it misses {missed:.2f} px; allowed: {most_left:.0%}. {_HINT}"
        )
    vague = deviations["tissue_stiffness_n_per_m"] / calibration.fingertip.tissue_stiffness
    # Largest standard deviation of a stiffness that counts as determined, as a share of it.
    most = 0.1
    if vague > most:
        raise UserError(
            f"the presses leave the stiffness open by {vague:.0%}; allowed: {most:.0%}, wanted: "
            "more presses, and larger forces"
        )


def _places_rms(values: Array) -> float:
    """RMS of the places among (n, 6) measurements of pairs [px]; 0 if n = 0."""
    return float(np.sqrt((values[:, _PLACES] ** 2).mean())) if len(values) else 0.0


def _forces_left(
    calibration: SensorCalibration,
    friction: float,
    pressed: Pressed,
    data: _Data,
    residual: Array,
) -> tuple[float, float]:
    """RMS by which the forces that fit each press best differ from those in the list.

    Parameters
    ----------
    calibration, friction: calibrated sensor, and the friction coefficient on the plate
    pressed, data: presses and their shifts
    residual: variances of the model's own errors, shape (6,)

    Returns
    -------
    normal: error of the normal forces as a share of them
    lateral: error of the lateral forces [N]
    """
    # Change of either force in a difference, as a share of the normal force: smaller ones show how
    # springs snap from node to node.
    step = 0.05
    most = 0.97 * friction  # largest ratio of the forces, so that the plate holds
    whiten = np.linalg.inv(np.linalg.cholesky(data.own + data.shared + np.diag(residual)))
    listed = np.array([(press.normal, press.lateral) for press in pressed.presses])

    def shifts(forces: Array) -> Array:
        pairs = zip(pressed.presses, forces.tolist(), strict=True)
        presses = [replace(press, normal=n, lateral=x) for press, (n, x) in pairs]
        return predict(calibration, friction, pressed.rest, presses, data.pose)

    forces = listed
    for _ in range(3):  # rounds of Gauss and Newton
        normal, lateral = forces.T
        changes = step * normal[:, None] * np.array([1.0, -1.0])
        changes[:, 1] *= np.where(lateral > 0.0, 1.0, -1.0)  # away from slip
        now = shifts(forces)
        changed = [shifts(forces + changes * unit) for unit in np.eye(2)]
        columns = np.stack([*(one - now for one in changed), data.shifts - now], axis=-1)
        white = (whiten @ columns).reshape(len(columns), -1, 3)
        found = np.array([np.linalg.lstsq(one[:, :2], one[:, 2])[0] for one in white])
        forces = forces + changes * found
        held = most * forces[:, 0]
        forces[:, 1] = np.clip(forces[:, 1], -held, held)
    missed = forces - listed
    rms = np.sqrt(np.mean(np.square([missed[:, 0] / listed[:, 0], missed[:, 1]]), axis=1))
    return float(rms[0]), float(rms[1])


def save_calibration(
    calibration: SensorCalibration, sensor: str, report: FitReport, path: Path, note: str = ""
) -> None:
    """Write a calibration file; a design's file is named relative to it.

    Parameters
    ----------
    calibration, sensor, report: see `calibration_table`
    path: path of the file
    note: comment at its top, one line (default: none)

    Raises
    ------
    UserError
        When it cannot be written.
    """
    if sensor.endswith(".toml"):
        sensor = os.path.relpath(sensor, path.parent)
    table = calibration_table(calibration, sensor, report)
    comment = f"# {note}\n" if note else ""
    write_whole(path, (comment + tomli_w.dumps(table)).encode())


def _any_press(presses: list[Press], where: Path) -> None:
    """Take every press, with balls and torques."""


#: For sensors read as each body: check of a list of forces, and fit to their pictures.
_BY_FORCE: dict[
    Body, tuple[Callable[..., None], Callable[..., tuple[SensorCalibration, FitReport]]]
]
_BY_FORCE = {"chain": (_check_plates, _fit_forces), "dome": (_any_press, fit_presses)}
