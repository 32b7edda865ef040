"""Stability map of the dome: where a step is accurate, is halved, or does not converge.

One contact (a plane or a ball is pressed in, then moved sideways until all of it slides) over the
stiffness of the object × the travel in a step × the Dahl exponent, compared with fine steps.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from chromagrip.errors import UserError
from chromagrip.measure.stability.fields import draw_cells, patches, remark, title_of
from chromagrip.measure.stability.panels import Outcome, Outcomes, map_study, score_of, worst
from chromagrip.measure.study import Asked, Study, study
from chromagrip.model import ConvergenceError, Dome, DomeRun, Motion, Solid, simulate_contact
from chromagrip.model.shapes import Shape, ball, plane
from chromagrip.output.figure import WIDTH, legend_below, new_figure, png
from chromagrip.output.report import Report, Row, at_least, reported

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


class DomeSetting(NamedTuple):
    """Shape, Dahl exponent, stiffness of the object [N/m³], and travel in a step [m], of a run."""

    shape: str
    exponent: float
    stiffness_n_per_m3: float
    travel_m: float


@dataclass(frozen=True)
class DomeCell:
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


@study("project", "stability-dome")
def dome_map(asked: Asked) -> Study[tuple[DomeSetting, ...], list[DomeCell]]:
    """Steps of the dome over travel in a step, stiffness of the object and Dahl exponent.

    One contact (press, then slide) is compared with the same in fine steps.
    """
    alike = itertools.groupby(settings(grid(asked.quick)), lambda one: one[:3])
    return map_study(
        "dome",
        [tuple(some) for _, some in alike],
        cells,
        DomeCell,
        report,
        partial(draw_dome, quick=asked.quick),
        words=lambda group: "{}, n = {:g}, {:.0e} N/m³".format(*group[0][:3]),
    )


def settings(plan: Grid) -> list[DomeSetting]:
    """Every setting of a map."""
    wanted = itertools.product(plan.shapes, plan.exponents, plan.stiffness, plan.travel)
    return [DomeSetting(*one) for one in wanted]


def cells(group: Sequence[DomeSetting]) -> list[DomeCell]:
    """Run settings of one shape, exponent and stiffness, which share a fine run."""
    fine = FINE * min(setting.travel_m for setting in group)
    try:
        truth = _forces(_run(group[0]._replace(travel_m=fine)))
    except ConvergenceError:
        truth = np.full((len(PATH), 3), np.nan)
    return [_cell(setting, truth) for setting in group]


def _run(setting: DomeSetting) -> DomeRun:
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


def _cell(setting: DomeSetting, truth: Array) -> DomeCell:
    try:
        run = _run(setting)
    except UserError as stopped:
        return DomeCell(*setting, "not converged", np.nan, np.nan, 0, np.nan, str(stopped))
    off = np.linalg.norm(_forces(run) - truth, axis=1) / np.linalg.norm(truth, axis=1)
    error = float(off.max())
    halved = run.halvings / len(run.times)
    return DomeCell(
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


def report(results: Sequence[DomeCell]) -> Report:
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
    return Report(rows=tuple(rows), notes=tuple(map(_sentence, failed)))


def _sentence(cell: DomeCell) -> str:
    reason = f" (error {100 * cell.error:.1f} %)" if np.isfinite(cell.error) else f": {cell.note}"
    return (
        f"the dome is {cell.outcome} at {1e6 * cell.travel_m:g} µm a step on a {cell.shape} of "
        f"{cell.stiffness_n_per_m3:.0e} N/m³{reason}"
    )


def draw_dome(results: Sequence[DomeCell], path: Path, quick: bool) -> None:
    """Write the map of the dome: a panel for each Dahl exponent and shape.

    Travel in a step goes across, stiffness of the object up. A cell whose steps were halved says
    how often, in percent of the steps.
    """
    shapes = list(dict.fromkeys(cell.shape for cell in results))
    exponents = list(dict.fromkeys(cell.exponent for cell in results))
    title = title_of("Dome: press 0.4 mm, shift 0.8 mm; outcome by the travel in a step", quick)
    figure = new_figure(title, WIDTH, 2.5 * len(exponents) + 1.2)
    panels = figure.subplots(len(exponents), len(shapes), squeeze=False)
    for (row, column), axes in np.ndenumerate(panels):
        shape, exponent = shapes[column], exponents[row]
        part = [cell for cell in results if (cell.shape, cell.exponent) == (shape, exponent)]
        x = {cell.travel_m: f"{1e6 * cell.travel_m:g}" for cell in part}
        levels = sorted({cell.stiffness_n_per_m3 for cell in part})
        y = {level: f"$10^{{{np.log10(level):.0f}}}$" for level in levels}
        shown = {(c.travel_m, c.stiffness_n_per_m3): (c.outcome, _text_of_dome(c)) for c in part}
        draw_cells(axes, shown, x, y, OUTCOMES)
        axes.set_title(f"{shape}, Dahl exponent {exponent:g}", fontsize=9)
        if column == 0:
            axes.set_ylabel("object stiffness [N/m³]", fontsize=8)
        if row == len(exponents) - 1:
            axes.set_xlabel("travel in a step [µm]", fontsize=8)
    handles = [*patches(results, OUTCOMES), remark("numbers: steps that were halved [%]")]
    legend_below(figure, handles, 2)
    path.write_bytes(png(figure))


def _text_of_dome(cell: DomeCell) -> str:
    number = f"{100.0 * cell.halved:.0f}" if cell.halved >= 0.005 else "<1"
    return f"{OUTCOMES[cell.outcome].letter} {number if cell.halved > 0.0 else ''}".strip()
