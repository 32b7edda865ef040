"""Stability map of the node models: where each integrator is accurate, chatters, or diverges.

One grasp (press to 1 N, pull to half of what friction holds, hold) over step size × contact
stiffness × node count, compared with the same grasp in fine implicit steps.
"""

import itertools
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...model import (
    ContactObject,
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
from ...output.report import Report, Row, at_least, reported
from ..bench.model import margins
from .panels import Outcome, Outcomes

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

EXPLICIT: tuple[Method, ...] = ("euler", "rk4")
ADAPTIVE: tuple[Method, ...] = ("rk45", "lsoda", "bdf")


class Setting(NamedTuple):
    """Method, nodes, contact stiffness [N/m] and step [s] of a run."""

    method: Method
    nodes: int
    stiffness_n_per_m: float
    step_s: float


@dataclass(frozen=True)
class Cell:
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

    @property
    def setting(self) -> Setting:
        """Setting of the run."""
        return Setting(self.method, self.nodes, self.stiffness_n_per_m, self.step_s)


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
    steps: dict[Method, tuple[float, ...]]
    budget: int


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


@cache
def limit(method: Method, nodes: int, stiffness: float) -> float:
    """Largest stable step by linear theory [s]; of `euler` for methods that are not explicit."""
    tip, obj = Fingertip(nodes=nodes), ContactObject(stiffness=stiffness)
    return explicit_limit(tip, obj, rest_state(tip), method if method in EXPLICIT else "euler")


def settings(plan: Grid) -> list[Setting]:
    """Every setting of a map."""
    return [
        Setting(
            method,
            nodes,
            stiffness,
            step * limit(method, nodes, stiffness) if method in EXPLICIT else step,
        )
        for nodes, stiffness in itertools.product(plan.nodes, plan.stiffness)
        for method, steps in plan.steps.items()
        for step in steps
    ]


def cells(
    wanted: Sequence[Setting], budget: int, progress: Callable[[str], None]
) -> Generator[Cell]:
    """Run settings; those of one chain and stiffness, one after the other, share a fine run."""
    for (nodes, stiffness), group in itertools.groupby(wanted, lambda one: one[1:3]):
        tip, obj = Fingertip(nodes=nodes), ContactObject(stiffness=stiffness)
        truth: dict[float, Array] = {}
        for setting in group:
            duration = _duration(setting.method)
            if duration not in truth:
                progress(f"{nodes} nodes, {stiffness:g} N/m: fine run")
                fine = _run(tip, obj, "implicit", FINE * duration, duration)
                truth[duration] = margins(tip, obj, fine)
            step = f"{setting.step_s * 1e3:.3g} ms"
            progress(f"{nodes} nodes, {stiffness:g} N/m, {setting.method}, {step}")
            yield _cell(tip, obj, setting, truth[duration], budget)


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


def _cell(tip: Fingertip, obj: ContactObject, setting: Setting, truth: Array, budget: int) -> Cell:
    method, _, _, dt = setting
    stable = limit(*setting[:3])

    def cell(outcome: str, error: float = np.nan, swing: float = np.nan, note: str = "") -> Cell:
        return Cell(*setting, outcome, error, swing, stable, note)

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


def _swing(tip: Fingertip, obj: ContactObject, method: Method, dt: float, run: History) -> float:
    """Second difference of ΣFn over eight more steps of the held grasp, over ΣFn."""
    start = run.state(-1)
    drive = Drive.constant(1.0, 0.25)
    held = simulate(tip, obj, drive, dt=dt, duration=8 * dt, state=start, method=method)
    normal = [contact_forces(tip, obj, held.state(k)).normal.sum() for k in range(1, len(held))]
    return float(abs(np.diff(normal, n=2)).max() / max(normal[0], 1e-9))


def report(results: Sequence[Cell], quick: bool) -> Report:
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
    return Report(rows=tuple(rows), notes=tuple(map(_sentence, failed)), quick=quick)


def _sentence(cell: Cell) -> str:
    reason = f" (error {100 * cell.error:.1f} %)" if np.isfinite(cell.error) else f": {cell.note}"
    return (
        f"implicit is {cell.outcome} at {cell.step_s * 1e3:g} ms on "
        f"{cell.stiffness_n_per_m:g} N/m with {cell.nodes} nodes{reason}"
    )
