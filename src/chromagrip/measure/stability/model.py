"""Stability maps of the node models: where each integrator is true, chatters, or is lost.

One grasp (press to 1 N, pull to half of what friction holds, hold) over step size × contact
stiffness × node count, compared with the same grasp in fine implicit steps.
"""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from ...model import (
    ContactObject,
    DivergedError,
    Drive,
    Fingertip,
    History,
    Method,
    ModelError,
    contact_forces,
    explicit_limit,
    rest_state,
    simulate,
)
from ...output.cells import read_cells, write_cells
from ...output.folder import prepare
from ...output.rows import Row, at_least, report, reported
from ..bench.model import margins

Array = NDArray[np.float64]

#: Outcomes, best first, with their colours.
OUTCOMES = {
    "accurate": "#2a9d8f",
    "inaccurate": "#e9c46a",
    "chattering": "#e76f51",
    "diverged": "#6d1a36",
    "not run": "#e5e5e5",
}
#: Accurate: Γ and ΣFn within this share of the fine run at every look.
ACCURATE = 0.02
#: Chattering: forces of the held grasp still swing from step to step by more than this share.
CHATTER = 0.01
#: Time of the grasp [s], and how often it is looked at. Explicit steps are so short that the same
#: grasp in a fifteenth of the time is as smooth to them.
DURATION, SHORT = 0.3, 0.02
LOOKS = 4
#: Step of the fine run, as a share of its time.
FINE = 1 / 20_000
#: A dense method is run for at most this many evaluations of the matrix; beyond, it is not run.
BUDGET = 25_000
FULL_BUDGET = 100_000

EXPLICIT: tuple[Method, ...] = ("euler", "rk4")
ADAPTIVE: tuple[Method, ...] = ("rk45", "lsoda", "bdf")


@dataclass(frozen=True)
class Cell:
    """One run of a map; NaN where there is nothing to measure.

    Attributes
    ----------
    method, nodes, stiffness_n_per_m, step_s: what was run
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
    """What a map is made of."""

    nodes: tuple[int, ...]
    stiffness: tuple[float, ...]
    steps: dict[Method, tuple[float, ...]]
    budget: int


def stability_model(
    quick: bool, out: Path | None, force: bool, progress: Callable[[str], None]
) -> tuple[dict[str, Any], list[str]]:
    """Run the map; picture and table go to a folder, where an interrupted map goes on.

    Parameters
    ----------
    quick: a map of under a minute
    out: folder; None writes nothing
    force: write over what is there
    progress: told what is being run

    Returns
    -------
    Report of the rows, and a sentence for each place where the default is not accurate.
    """
    plan = grid(quick)
    if out is None:
        found = list(cells(plan, {}, progress))
    else:
        part = out / "map.unfinished.csv"
        prepare(out, force or part.exists())
        done = {
            (c.method, c.nodes, c.stiffness_n_per_m, c.step_s): c for c in read_cells(part, Cell)
        }
        found = []
        for cell in cells(plan, done, progress):
            found.append(cell)
            if len(found) > len(done):  # those done before come first and are in the file
                write_cells(found, part)
        _draw(found, out / "map.png", quick)
        part.replace(out / "map.csv")
    return report(_rows(found), quick), _breaks(found)


def grid(quick: bool) -> Grid:
    """Full map, or one of under a minute."""
    long = (1e-4, 3e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 4e-2)
    factors = (0.9, 1.5) if quick else (0.5, 0.9, 1.1, 1.5)  # of the predicted limit
    methods: tuple[Method, ...] = ("implicit", "lagged", *EXPLICIT, *(() if quick else ADAPTIVE))
    return Grid(
        nodes=(21,) if quick else (21, 251),
        stiffness=(160.0, 1e5) if quick else (80.0, 1000.0, 1e4, 1e5),
        steps={
            m: factors if m in EXPLICIT else (1e-3,) if m in ADAPTIVE else long for m in methods
        },
        budget=BUDGET if quick else FULL_BUDGET,
    )


Key = tuple[str, int, float, float]


def cells(plan: Grid, done: dict[Key, Cell], progress: Callable[[str], None]) -> Iterator[Cell]:
    """Every cell of a map; those in `done` are not run again."""
    for nodes, stiffness in itertools.product(plan.nodes, plan.stiffness):
        tip, obj = Fingertip(nodes=nodes), ContactObject(stiffness=stiffness)
        truth: dict[float, Array] = {}
        limits = {name: explicit_limit(tip, obj, rest_state(tip), name) for name in EXPLICIT}
        for method, steps in plan.steps.items():
            limit = limits.get(method, limits["euler"])
            for step in steps:
                dt = step * limit if method in EXPLICIT else step
                key = (method, nodes, stiffness, dt)
                if key in done:
                    yield done[key]
                    continue
                duration = _duration(method)
                if duration not in truth:
                    progress(f"{nodes} nodes, {stiffness:g} N/m: fine run")
                    fine = _run(tip, obj, "implicit", FINE * duration, duration)
                    truth[duration] = margins(tip, obj, fine)
                progress(f"{nodes} nodes, {stiffness:g} N/m, {method}, {dt * 1e3:.3g} ms")
                yield _cell(tip, obj, method, dt, limit, truth[duration], plan.budget)


def _duration(method: Method) -> float:
    return DURATION if method in ("implicit", "lagged") else SHORT


def _grasp(duration: float) -> Drive:
    share = np.linspace(0.0, 1.0, 601)
    rise = np.sin(0.5 * np.pi * np.clip(share / 0.45, 0.0, 1.0)) ** 2
    pull = np.sin(0.5 * np.pi * np.clip((share - 0.45) / 0.35, 0.0, 1.0)) ** 2
    return Drive(times=duration * share, normal=rise, lateral=0.25 * pull)


def _run(tip: Fingertip, obj: ContactObject, method: Method, dt: float, duration: float) -> History:
    """The grasp, recorded at LOOKS instants, in whole steps of about dt between them."""
    each = max(1, round(duration / LOOKS / dt))
    return simulate(
        tip,
        obj,
        _grasp(duration),
        dt=duration / (LOOKS * each),
        duration=duration,
        every=each,
        method=method,
    )


def _cell(
    tip: Fingertip,
    obj: ContactObject,
    method: Method,
    dt: float,
    limit: float,
    truth: Array,
    budget: int,
) -> Cell:
    def cell(outcome: str, error: float = np.nan, swing: float = np.nan, note: str = "") -> Cell:
        return Cell(method, tip.nodes, obj.stiffness, dt, outcome, error, swing, limit, note)

    # What one evaluation costs grows with the nodes.
    evaluations = SHORT / min(dt, limit) * (1 if method == "euler" else 4)
    if method in (*EXPLICIT, *ADAPTIVE) and evaluations * tip.nodes / 51 > budget:
        return cell("not run", note="too many evaluations of the dense matrix")
    try:
        run = _run(tip, obj, method, dt, _duration(method))
        swing = _swing(tip, obj, method, dt, run)
        error = float(abs(margins(tip, obj, run) / truth - 1.0).max())
    except DivergedError as stopped:
        return cell("diverged", note=str(stopped))
    except ModelError as stopped:
        return cell("diverged", note=str(stopped))
    if not np.isfinite(error):
        return cell("diverged", note="contact was lost")
    if swing > CHATTER:
        return cell("chattering", error, swing)
    return cell("accurate" if error <= ACCURATE else "inaccurate", error, swing)


def _swing(tip: Fingertip, obj: ContactObject, method: Method, dt: float, run: History) -> float:
    """Second difference of ΣFn over eight more steps of the held grasp, over ΣFn."""
    start = run.state(-1)
    more = simulate(
        tip, obj, Drive.constant(1.0, 0.25), dt=dt, duration=8 * dt, state=start,
        method=method,
    )  # fmt: skip
    normal = [contact_forces(tip, obj, more.state(k)).normal.sum() for k in range(1, len(more))]
    return float(abs(np.diff(normal, n=2)).max() / max(normal[0], 1e-9))


def _rows(found: list[Cell]) -> list[Row]:
    """Figures of a map: how far each method is true, and how well the limit was predicted."""
    rows = []
    for method in dict.fromkeys(cell.method for cell in found):
        mine = [cell for cell in found if cell.method == method and cell.outcome != "not run"]
        for outcome in OUTCOMES:
            share = sum(cell.outcome == outcome for cell in mine)
            if outcome != "not run":
                rows.append(reported(f"{method}/{outcome}", float(share), "cells"))
    explicit = [c for c in found if c.method in EXPLICIT and c.outcome != "not run"]
    right = [(c.outcome == "accurate") == (c.step_s < c.limit_s) for c in explicit]
    if right:
        rows.append(reported("limit/predicted_right", 100 * float(np.mean(right)), "%"))
    default = [c for c in found if c.method == "implicit" and c.step_s <= 1e-2]
    true = 100 * float(np.mean([c.outcome == "accurate" for c in default]))
    rows.append(at_least("implicit/accurate_to_10ms", true, "%", 100))
    return rows


def _draw(rows: list[Cell], path: Path, quick: bool) -> None:
    """Map of a CSV: a panel for each method and node count, step size across, stiffness up."""
    methods = list(dict.fromkeys(row.method for row in rows))
    counts = sorted({row.nodes for row in rows})
    figure = Figure(figsize=(3.1 * len(methods), 2.3 * len(counts) + 1.3), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(counts), len(methods), squeeze=False)
    for (r, nodes), (c, method) in itertools.product(enumerate(counts), enumerate(methods)):
        part = [row for row in rows if row.method == method and row.nodes == nodes]
        _panel(panels[r, c], part)
        panels[r, c].set_title(f"{method}, {nodes} nodes", fontsize=9)
        if c == 0:
            panels[r, c].set_ylabel("contact stiffness [N/m]", fontsize=8)
        if r == len(counts) - 1:
            panels[r, c].set_xlabel("step", fontsize=8)
    present = [name for name in OUTCOMES if any(row.outcome == name for row in rows)]
    handles: list[Patch | Line2D] = [Patch(color=OUTCOMES[name], label=name) for name in present]
    handles.append(Line2D([], [], color="black", ls="--", lw=1, label="predicted explicit limit"))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=8)
    smaller = " (quick)" if quick else ""
    figure.suptitle(f"Press to 1 N, pull with 0.25 N, hold: who follows{smaller}", fontsize=10)
    figure.savefig(path, dpi=110)


def _panel(axes: Axes, rows: list[Cell]) -> None:
    """Cells as rectangles between half-way steps, on logarithmic axes."""
    stiffness = sorted({row.stiffness_n_per_m for row in rows})
    low, high = _edges(np.array(stiffness)) if len(stiffness) > 1 else ([0.5], [2.0])
    for level, bottom, top in zip(stiffness, low, high, strict=True):
        line = sorted(
            (row for row in rows if row.stiffness_n_per_m == level), key=lambda x: x.step_s
        )
        steps = 1e3 * np.array([row.step_s for row in line])
        left, right = _edges(steps) if len(steps) > 1 else (steps / 1.5, steps * 1.5)
        for row, a, b in zip(line, left, right, strict=True):
            axes.add_patch(_rectangle(a, b, bottom, top, OUTCOMES[row.outcome]))
        limit = 1e3 * line[0].limit_s
        axes.plot([limit, limit], [bottom, top], "k--", lw=1)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_ylim(low[0], high[-1])
    axes.set_xlim(5e-4, 100.0)
    axes.set_xticks([1e-3, 1e-2, 1e-1, 1.0, 10.0], ["1 µs", "10 µs", "0.1 ms", "1 ms", "10 ms"])
    axes.minorticks_off()
    axes.tick_params(labelsize=7)


def _rectangle(left: float, right: float, bottom: float, top: float, colour: str) -> Rectangle:
    return Rectangle(
        (left, bottom), right - left, top - bottom, facecolor=colour, edgecolor="white"
    )


def _edges(values: Array) -> tuple[Array, Array]:
    """Lower and upper edges of cells around increasing positive values."""
    middle = np.sqrt(values[1:] * values[:-1])
    first, last = values[0] ** 2 / middle[0], values[-1] ** 2 / middle[-1]
    return np.concatenate([[first], middle]), np.concatenate([middle, [last]])


def _breaks(rows: list[Cell]) -> list[str]:
    """Where the default is not accurate, in a sentence each."""
    found = []
    for row in rows:
        if row.method == "implicit" and row.outcome not in ("accurate", "not run"):
            found.append(
                f"implicit is {row.outcome} at {row.step_s * 1e3:g} ms on "
                f"{row.stiffness_n_per_m:g} N/m with {row.nodes} nodes"
                + (
                    f" (error {100 * row.error:.1f} %)"
                    if np.isfinite(row.error)
                    else f": {row.note}"
                )
            )
    return found
