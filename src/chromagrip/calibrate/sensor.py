"""Calibrate a sensor from pictures of known presses: least squares with priors.

Presses of known force give the silicone of a dome, see `dome`; those of known displacement give the
gains of a flat pad.
"""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import tomli_w

from ..errors import UserError, located
from ..folders import write_whole
from ..output.processes import one_thread
from ..render import SensorDesign
from ..stored_pictures import MEGAPIXELS
from ..tracking import DEFAULT_TRACKER, SensorCalibration
from ..tracking.forces import (
    FitReport,
    aligned,
    alignment,
    body_read,
    calibration_table,
    fit_gains,
    nominal_calibration,
    rest_pose,
)
from .dome.silicone import fit_presses
from .presses import LIST, Press, Pressed, read_list, track_presses


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

    Presses of known force determine the silicone of a dome. Presses of known displacement determine
    the gains of a flat pad, which has no force model.

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
        When the sensor is read as a chain, or the pictures cannot be used, do not determine the
        sensor, or no sensor near the design explains them.
    """
    nominal, where = nominal_calibration(design), folder / LIST
    if not design.shape.flat and body_read(nominal) != "dome":
        raise UserError(
            "a sensor that is read as a chain is not calibrated from presses; allowed: a dome of "
            "silicone, such as dome-2020, dome-2022 and chromatouch-next, or a flat pad"
        )
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
    pressed = track_presses(folder, presses, design, tracker, noise, tell, max_megapixels)
    if not by_force:
        return _fit_displacement(nominal, pressed, where)
    with one_thread():
        return fit_presses(nominal, pressed, tell)


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


def save_calibration(
    calibration: SensorCalibration, sensor: str, report: FitReport, path: Path
) -> None:
    """Write a calibration file; a design's file is named relative to it.

    Parameters
    ----------
    calibration, sensor, report: see `calibration_table`
    path: path of the file

    Raises
    ------
    UserError
        When it cannot be written.
    """
    if sensor.endswith(".toml"):
        sensor = os.path.relpath(sensor, path.parent)
    table = calibration_table(calibration, sensor, report)
    write_whole(path, tomli_w.dumps(table).encode())
