"""Stability map of the node models: where each integrator is accurate, chatters, or diverges.

One grasp (press to 1 N, pull to half of what friction holds, hold) over step size × contact
stiffness × node count, compared with the same grasp in fine implicit steps.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from benchmarks.model.bench import margins
from benchmarks.model.integrators import ADAPTIVE, EXPLICIT, explicit_limit, integrate
from chromagrip.measure.stability.fields import draw_cells, patches, title_of
from chromagrip.measure.stability.panels import Outcome, Outcomes, map_study
from chromagrip.measure.study import Asked, Study, study
from chromagrip.model import (
    ContactObject,
    Drive,
    Fingertip,
    History,
    ModelError,
    contact_forces,
)
from chromagrip.output.figure import WIDTH, legend_below, new_figure, png
from chromagrip.output.report import Report, Row, at_least, reported

Array = NDArray[np.float64]

#: Largest error of Γ and ΣFn of an accurate run, as a share of the fine run's.
ACCURATE = 0.02
#: Largest change of the forces of the held grasp from step to step, as a share; chattering beyond.
CHATTER = 0.01
#: Outcomes, best first.
OUTCOMES: Outcomes = {
    "accurate": Outcome("#8fd0c5", "", f"Γ and ΣFn within {100 * ACCURATE:g} % of the fine run"),
    "inaccurate": Outcome("#e9d26a", "i", "farther off"),
    "chattering": Outcome(
        "#f0a35e", "c", f"forces of the held grasp change by over {100 * CHATTER:g} % a step"
    ),
    "diverged": Outcome("#d9534f", "d", "no solution, or contact lost"),
    "not run": Outcome("#e5e5e5", "–", "would take too long"),
}
#: Length of the grasp [s].
DURATION = 0.3
#: Length of the grasp under explicit methods [s]. Their steps are so short that the grasp in a
#: fifteenth of the time is as smooth to them.
SHORT = 0.02
#: Number of instants of a grasp that are compared.
LOOKS = 4
#: Step of the fine run, as a share of its time.
FINE = 1 / 20_000
#: Largest number of evaluations of the matrix by a dense method, in a quick map and in a full one;
#: a run that takes more is not run.
BUDGET = 25_000
FULL_BUDGET = 100_000


class ChainSetting(NamedTuple):
    """Method, nodes, contact stiffness [N/m] and step [s] of a run."""

    method: str
    nodes: int
    stiffness_n_per_m: float
    step_s: float


@dataclass(frozen=True)
class ChainCell:
    """One run of a map; NaN where there is nothing to measure.

    Attributes
    ----------
    method, nodes, stiffness_n_per_m, step_s: the setting
    outcome: one of OUTCOMES
    error: largest relative error of Γ and ΣFn against the fine run
    swing: largest second difference of ΣFn from step to step at the end, over ΣFn
    limit_s: largest stable step that linear theory predicts for explicit methods [s]
    note: why it was not run, or how it ended
    """

    method: str
    nodes: int
    stiffness_n_per_m: float
    step_s: float
    outcome: str
    error: float
    swing: float
    limit_s: float
    note: str


@dataclass(frozen=True)
class Grid:
    """Settings of a map.

    Attributes
    ----------
    nodes: of the chain
    stiffness: of the contact [N/m]
    steps: of each method [s]; of explicit methods as shares of the predicted limit
    budget: of evaluations of the matrix
    """

    nodes: tuple[int, ...]
    stiffness: tuple[float, ...]
    steps: dict[str, tuple[float, ...]]
    budget: int


def grid(quick: bool) -> Grid:
    """Full map, or one of under a minute."""
    long = (1e-4, 3e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 4e-2)
    factors = (0.9, 1.5) if quick else (0.5, 0.9, 1.1, 1.5)  # of the predicted limit
    methods = ("implicit", "lagged", *EXPLICIT, *(() if quick else ADAPTIVE))
    return Grid(
        nodes=(21,) if quick else (21, 251),
        stiffness=(160.0, 1e5) if quick else (80.0, 1000.0, 1e4, 1e5),
        steps={
            m: factors if m in EXPLICIT else (1e-3,) if m in ADAPTIVE else long for m in methods
        },
        budget=BUDGET if quick else FULL_BUDGET,
    )


@cache
def limit(method: str, nodes: int, stiffness: float) -> float:
    """Largest stable step by linear theory [s]; of `euler` for methods that are not explicit."""
    tip, obj = Fingertip(nodes=nodes), ContactObject(stiffness=stiffness)
    return explicit_limit(tip, obj, method=method if method in EXPLICIT else "euler")


class ChainGroup(NamedTuple):
    """Settings of one chain and stiffness, which share fine runs, and the budget."""

    settings: tuple[ChainSetting, ...]
    budget: int


@study("project", "stability-model")
def chain_map(asked: Asked) -> Study[ChainGroup, list[ChainCell]]:
    """Integrators of the chain over step, contact stiffness and node count.

    One grasp (press to 1 N, pull to half of what friction holds, hold) is compared with the same
    grasp in fine implicit steps.
    """
    plan = grid(asked.quick)
    alike = itertools.groupby(settings(plan), lambda one: one[1:3])
    return map_study(
        "map",
        [ChainGroup(tuple(some), plan.budget) for _, some in alike],
        cells,
        ChainCell,
        report,
        partial(draw_model, quick=asked.quick),
        words=lambda group: "{} nodes, {:g} N/m".format(*group.settings[0][1:3]),
    )


def settings(plan: Grid) -> list[ChainSetting]:
    """Every setting of a map."""
    return [
        ChainSetting(
            method,
            nodes,
            stiffness,
            step * limit(method, nodes, stiffness) if method in EXPLICIT else step,
        )
        for nodes, stiffness in itertools.product(plan.nodes, plan.stiffness)
        for method, steps in plan.steps.items()
        for step in steps
    ]


def cells(group: ChainGroup) -> list[ChainCell]:
    """Run settings of one chain and stiffness."""
    _, nodes, stiffness, _ = group.settings[0]
    tip, obj = Fingertip(nodes=nodes), ContactObject(stiffness=stiffness)
    truth: dict[float, Array] = {}
    made = []
    for setting in group.settings:
        duration = _duration(setting.method)
        if duration not in truth:
            fine = _run(tip, obj, "implicit", FINE * duration, duration)
            truth[duration] = margins(tip, obj, fine)
        made.append(_cell(tip, obj, setting, truth[duration], group.budget))
    return made


def _duration(method: str) -> float:
    return DURATION if method in ("implicit", "lagged") else SHORT


def _grasp(duration: float) -> Drive:
    share = np.linspace(0.0, 1.0, 601)
    rise = np.sin(0.5 * np.pi * np.clip(share / 0.45, 0.0, 1.0)) ** 2
    pull = np.sin(0.5 * np.pi * np.clip((share - 0.45) / 0.35, 0.0, 1.0)) ** 2
    return Drive(times=duration * share, normal=rise, lateral=0.25 * pull)


def _run(tip: Fingertip, obj: ContactObject, method: str, dt: float, duration: float) -> History:
    """The grasp, recorded at LOOKS instants, in whole steps of about dt between them."""
    each = max(1, round(duration / LOOKS / dt))
    dt = duration / (LOOKS * each)
    return integrate(method, tip, obj, _grasp(duration), dt=dt, duration=duration, every=each)


def _cell(
    tip: Fingertip, obj: ContactObject, setting: ChainSetting, truth: Array, budget: int
) -> ChainCell:
    method, _, _, dt = setting
    stable = limit(*setting[:3])

    def cell(
        outcome: str, error: float = np.nan, swing: float = np.nan, note: str = ""
    ) -> ChainCell:
        return ChainCell(*setting, outcome, error, swing, stable, note)

    # The cost of one evaluation grows with the nodes.
    evaluations = SHORT / min(dt, stable) * (1 if method == "euler" else 4)
    if method in (*EXPLICIT, *ADAPTIVE) and evaluations * tip.nodes / 51 > budget:
        return cell("not run", note="too many evaluations of the dense matrix")
    try:
        run = _run(tip, obj, method, dt, _duration(method))
        swing = _swing(tip, obj, method, dt, run)
        error = float(abs(margins(tip, obj, run) / truth - 1.0).max())
    except ModelError as stopped:
        return cell("diverged", note=str(stopped))
    if not np.isfinite(error):
        return cell("diverged", note="contact was lost")
    if swing > CHATTER:
        return cell("chattering", error, swing)
    return cell("accurate" if error <= ACCURATE else "inaccurate", error, swing)


def _swing(tip: Fingertip, obj: ContactObject, method: str, dt: float, run: History) -> float:
    """Second difference of ΣFn over eight more steps of the held grasp, over ΣFn."""
    start = run.state(-1)
    drive = Drive.constant(1.0, 0.25)
    held = integrate(method, tip, obj, drive, dt=dt, duration=8 * dt, state=start)
    normal = [contact_forces(tip, obj, held.state(k)).normal.sum() for k in range(1, len(held))]
    return float(abs(np.diff(normal, n=2)).max() / max(normal[0], 1e-9))


def report(results: Sequence[ChainCell]) -> Report:
    """Accuracy of each method and of the predicted limit, and places where the default fails."""
    ran = [cell for cell in results if cell.outcome != "not run"]
    rows: list[Row] = []
    for method in dict.fromkeys(cell.method for cell in results):
        outcomes = [cell.outcome for cell in ran if cell.method == method]
        rows += [
            reported((method, outcome), outcomes.count(outcome), "cells")
            for outcome in OUTCOMES
            if outcome != "not run"
        ]
    explicit = [cell for cell in ran if cell.method in EXPLICIT]
    right = [(cell.outcome == "accurate") == (cell.step_s < cell.limit_s) for cell in explicit]
    if right:
        rows.append(reported(("limit", "predicted_right"), 100 * float(np.mean(right)), "%"))
    default = [cell for cell in results if cell.method == "implicit"]
    accurate = [cell.outcome == "accurate" for cell in default if cell.step_s <= 1e-2]
    share = 100 * float(np.mean(accurate))
    rows.append(at_least(("implicit", "accurate_to_10ms"), share, "%", 100))
    failed = [cell for cell in default if cell.outcome not in ("accurate", "not run")]
    return Report(rows=tuple(rows), notes=tuple(map(_sentence, failed)))


def _sentence(cell: ChainCell) -> str:
    reason = f" (error {100 * cell.error:.1f} %)" if np.isfinite(cell.error) else f": {cell.note}"
    return (
        f"implicit is {cell.outcome} at {cell.step_s * 1e3:g} ms on "
        f"{cell.stiffness_n_per_m:g} N/m with {cell.nodes} nodes{reason}"
    )


def draw_model(results: Sequence[ChainCell], path: Path, quick: bool) -> None:
    """Write the map of the integrators: panels of methods for each node count.

    Steps go across, of explicit methods over the predicted limit; stiffness goes up. Methods that
    choose their steps share a panel.
    """
    methods = dict.fromkeys(cell.method for cell in results)
    adaptive = [name for name in methods if name in ADAPTIVE]
    groups = [[name] for name in methods if name not in adaptive]
    groups += [adaptive] if adaptive else []
    counts = sorted({cell.nodes for cell in results})
    high = 0.24 * len({cell.stiffness_n_per_m for cell in results}) + 0.75
    title = title_of("Press to 1 N, pull with 0.25 N, hold: outcome of each method", quick)
    figure = new_figure(title, WIDTH, 2 * high * len(counts) + 1.6)
    # Two panels in a row, then three.
    places = figure.add_gridspec(2 * len(counts), 6)
    for row, nodes in enumerate(counts):
        for k, group in enumerate(groups):
            lower, width = int(k >= 2), 3 if k < 2 else 2
            start = k * 3 if k < 2 else (k - 2) * 2
            axes = figure.add_subplot(places[2 * row + lower, start : start + width])
            part = [cell for cell in results if cell.method in group and cell.nodes == nodes]
            _panel_of_model(axes, part)
            axes.set_title(f"{', '.join(group)}, {nodes} nodes", fontsize=9)
            if start == 0:
                axes.set_ylabel("stiffness [N/m]", fontsize=8)
    handles = patches(results, OUTCOMES)
    label = "largest stable step of an explicit method by linear theory"
    handles.append(Line2D([], [], color="black", ls="--", label=label))
    legend_below(figure, handles, 2)
    path.write_bytes(png(figure))


def _panel_of_model(axes: Axes, part: Sequence[ChainCell]) -> None:
    """Cells of one method by step, or of adaptive methods by their name."""
    method = part[0].method

    def column(cell: ChainCell) -> float | str:
        if cell.method in ADAPTIVE:
            return cell.method
        return round(cell.step_s / (cell.limit_s if method in EXPLICIT else 1e-3), 6)

    x = {at: f"{at:g}" if isinstance(at, float) else at for at in map(column, part)}
    y = {level: f"{level:g}" for level in sorted({cell.stiffness_n_per_m for cell in part})}
    shown = {
        (column(cell), cell.stiffness_n_per_m): (cell.outcome, OUTCOMES[cell.outcome].letter)
        for cell in part
    }
    draw_cells(axes, shown, x, y, OUTCOMES)
    label = "step [ms]"
    if method in EXPLICIT:
        label = "step over the largest stable one"
        axes.axvline(sum(float(at) < 1.0 for at in x) - 0.5, color="black", ls="--", lw=1.5)
    elif method in ADAPTIVE:
        label = "steps of their own choice"
    axes.set_xlabel(label, fontsize=8)
