"""Stability map of the dome: where a step is accurate, is halved, or does not converge.

One contact (a plane or a ball is pressed in, then moved sideways until all of it slides) over the
stiffness of the object × the travel in a step × the Dahl exponent, compared with fine steps.
"""

import itertools
import math
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...model import ConvergenceError, Dome, DomeRun, Motion, Solid, simulate_contact
from ...model.shapes import Shape, ball, plane
from ...output.report import Report, Row, at_least, reported
from .panels import Outcome, Outcomes, score_of, worst

Array = NDArray[np.float64]

#: Largest error of the total force at a knot of an accurate run, as a share of the fine run's.
ACCURATE = 0.02
#: Outcomes, best first. Where several hold, the last counts.
OUTCOMES: Outcomes = {
    "accurate": Outcome("#8fd0c5", "", f"force within {100 * ACCURATE:g} % of the fine run"),
    "accurate, steps halved": Outcome("#7aa6d6", "h"),
    "inaccurate": Outcome("#e9d26a", "i", "farther off"),
    "not converged": Outcome("#d9534f", "n"),
    "not judged": Outcome("#d9d9d9", "–"),
}
#: Knots of the path: how deep, and how far sideways [m]; each part is 400 µm, the longest step.
PATH = ((0.4e-3, 0.0), (0.4e-3, 0.4e-3), (0.4e-3, 0.8e-3))
#: Speed of the path [m/s]; without viscosity no figure depends on it.
SPEED = 1e-3
#: Travel in a step of the fine run, as a share of the shortest step of the map.
FINE = 0.5
SHAPES: dict[str, Shape] = {"plane": plane(), "ball": ball(10e-3)}
#: Exponent, travel and stiffness up to which every cell has to be accurate.
JUDGED_EXPONENT, JUDGED_TRAVEL, JUDGED_STIFFNESS = 0.7, 20e-6, 1e12

DOME = Dome(pitch=0.6e-3, reach=math.radians(45.0))


class Setting(NamedTuple):
    """Shape, Dahl exponent, stiffness of the object [N/m³], and travel in a step [m], of a run."""

    shape: str
    exponent: float
    stiffness_n_per_m3: float
    travel_m: float


@dataclass(frozen=True)
class Cell:
    """One run of a map; NaN where there is nothing to measure.

    Attributes
    ----------
    shape, exponent, stiffness_n_per_m3, travel_m: the setting
    outcome: one of OUTCOMES
    error: largest error of the total force at a knot, over the fine run's
    halved: steps and parts of steps that were halved, over the steps
    unconverged: parts of steps that were taken although they did not converge
    rounds: of Newton's method in a step, the mean
    note: how it ended
    """

    shape: str
    exponent: float
    stiffness_n_per_m3: float
    travel_m: float
    outcome: str
    error: float
    halved: float
    unconverged: int
    rounds: float
    note: str

    @property
    def setting(self) -> Setting:
        """Setting of the run."""
        return Setting(self.shape, self.exponent, self.stiffness_n_per_m3, self.travel_m)


@dataclass(frozen=True)
class Grid:
    """Shapes, exponents, stiffness [N/m³], and travel in a step [m] of a map."""

    shapes: tuple[str, ...]
    exponents: tuple[float, ...]
    stiffness: tuple[float, ...]
    travel: tuple[float, ...]


def grid(quick: bool) -> Grid:
    """Full map, or one of some seconds."""
    if quick:
        return Grid(tuple(SHAPES), (0.0, 0.7), (1e7, 1e9, 1e11), (20e-6, 100e-6, 400e-6))
    return Grid(
        shapes=tuple(SHAPES),
        exponents=(0.0, 0.7, 1.0),
        stiffness=(1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13),
        travel=(5e-6, 10e-6, 20e-6, 50e-6, 100e-6, 200e-6, 400e-6),
    )


def settings(plan: Grid) -> list[Setting]:
    """Every setting of a map."""
    wanted = itertools.product(plan.shapes, plan.exponents, plan.stiffness, plan.travel)
    return [Setting(*one) for one in wanted]


def cells(wanted: Sequence[Setting], progress: Callable[[str], None]) -> Generator[Cell]:
    """Run settings; those of one exponent and stiffness, one after the other, share a fine run."""
    for (shape, exponent, stiffness), group in itertools.groupby(wanted, lambda one: one[:3]):
        told = f"dome, {shape}, n = {exponent:g}, {stiffness:.0e} N/m³"
        progress(f"{told}: fine run")
        alike = list(group)
        fine = FINE * min(setting.travel_m for setting in alike)
        try:
            truth = _forces(_run(Setting(shape, exponent, stiffness, fine)))
        except ConvergenceError:
            truth = np.full((len(PATH), 3), np.nan)
        for setting in alike:
            progress(f"{told}, {1e6 * setting.travel_m:g} µm a step")
            yield _cell(setting, truth)


def _run(setting: Setting) -> DomeRun:
    poses = np.zeros((len(PATH) + 1, 6))
    poses[1:, 2], poses[1:, 0] = -np.array([d for d, _ in PATH]), [x for _, x in PATH]
    parts = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1)
    times = np.concatenate([[0.0], np.cumsum(parts) / SPEED])
    solid = Solid(
        shape=SHAPES[setting.shape],
        stiffness=setting.stiffness_n_per_m3,
        dahl_exponent=setting.exponent,
    )
    motion = Motion(times=times, poses=poses)
    return simulate_contact(DOME, solid, motion, setting.travel_m / SPEED, keep=1)


def _forces(run: DomeRun) -> Array:
    """Total force at the knots [N], shape (K, 3)."""
    at = np.searchsorted(run.times, run.motion.times[1:] - 1e-9)
    return run.total_forces[at]


def _cell(setting: Setting, truth: Array) -> Cell:
    try:
        run = _run(setting)
    except UserError as stopped:
        return Cell(*setting, "not converged", np.nan, np.nan, 0, np.nan, str(stopped))
    off = np.linalg.norm(_forces(run) - truth, axis=1) / np.linalg.norm(truth, axis=1)
    error = float(off.max())
    halved = run.halvings / len(run.times)
    return Cell(
        *setting,
        outcome(error, halved, run.unconverged),
        error,
        halved,
        run.unconverged,
        float(run.rounds.mean()),
        "" if np.isfinite(error) else "the fine run does not converge",
    )


def outcome(error: float, halved: float, unconverged: int) -> str:
    """Worst outcome of a run."""
    happened = {
        "accurate, steps halved": halved > 0.0,
        "inaccurate": not error <= ACCURATE,
        "not converged": unconverged > 0,
        "not judged": math.isnan(error),
    }
    return worst("accurate", happened)


def report(results: Sequence[Cell], quick: bool) -> Report:
    """Outcomes of each exponent, and places where the default one fails."""
    rows: list[Row] = []
    for exponent in dict.fromkeys(cell.exponent for cell in results):
        outcomes = [cell.outcome for cell in results if cell.exponent == exponent]
        rows += [
            reported(
                ("dome", f"exponent_{exponent:g}", score_of(name)), outcomes.count(name), "cells"
            )
            for name in OUTCOMES
        ]
    default = [cell for cell in results if cell.exponent == JUDGED_EXPONENT]
    judged = [
        cell.outcome.startswith("accurate")
        for cell in default
        if cell.travel_m <= JUDGED_TRAVEL and cell.stiffness_n_per_m3 <= JUDGED_STIFFNESS
    ]
    if judged:
        share = 100.0 * float(np.mean(judged))
        rows.append(at_least(("dome", f"accurate_to_{1e6 * JUDGED_TRAVEL:g}um"), share, "%", 100))
    failed = [cell for cell in default if not cell.outcome.startswith("accurate")]
    return Report(rows=tuple(rows), notes=tuple(map(_sentence, failed)), quick=quick)


def _sentence(cell: Cell) -> str:
    reason = f" (error {100 * cell.error:.1f} %)" if np.isfinite(cell.error) else f": {cell.note}"
    return (
        f"the dome is {cell.outcome} at {1e6 * cell.travel_m:g} µm a step on a {cell.shape} of "
        f"{cell.stiffness_n_per_m3:.0e} N/m³{reason}"
    )
