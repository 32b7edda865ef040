"""Scores of a grasp from the truth, and scores of several grasps together."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ...loop.record import Result
from ...loop.trace import Trace
from ...model import GROSS_SLIP
from ...thesis import DESIRED_MARGIN

Array = NDArray[np.float64]

#: Largest distance of a settled Γ from the desired one.
BAND = 0.05
#: Length of the end of a run in which the command's chatter is measured [s].
LATE = 0.5


def _p90(values: Array) -> float:
    return float(np.percentile(values, 90.0))


#: Unit of each score, and the function that joins those of several grasps.
SCORES: dict[str, tuple[str, Callable[[Array], float]]] = {
    "gross": ("runs", np.sum),
    "displacement": ("mm", np.max),
    "overloaded": ("s", np.max),
    "settling": ("s", _p90),
    "overshoot": ("points", np.max),
    "pressure_max": ("N/m", np.mean),
    "pressure_mean": ("N/m", np.mean),
    "energy": ("N²/s", np.mean),
    "chatter": ("N/s", np.mean),
}

#: Explanation of the scores.
NOTES = (
    "gross: number of runs that slip by more than 0.2 mm. displacement: of the object over the "
    "fingertip, the largest. overloaded: longest time for which the load exceeds "
    "µ·ΣFn; where it is short, the object's inertia and drag bear the rest, and it does not slide.",
    "settling: time from the last change of load or friction to the last exit of Γ from its "
    "target ± 0.05, or to the end; 90th percentile. overshoot: largest excess of Γ over its target "
    "after that change. A controller without a target has 0.30.",
    "pressure: over the width of the contact plus one node pitch. energy: ∫(dF/dt)² of the "
    "command. chatter: Σ|ΔF| per second over the last 0.5 s. All three are means over the runs.",
    "worst: each score of the worst run of any scene; gross counts all runs.",
)


def scores(result: Result) -> dict[str, float]:
    """Scores of a run, by the names of SCORES."""
    trace, scene = result.trace, result.scene
    target = DESIRED_MARGIN if scene.target_margin is None else scene.target_margin
    holds = trace["mu_true"] * trace["normal_true_n"]
    pressure = trace["pressure_pitch_n_per_m"]
    touching = trace["contact_nodes"] > 0.0
    displacement = float(trace["lateral_displacement_mm"][-1])
    return {
        "gross": float(displacement > 1e3 * GROSS_SLIP),
        "displacement": displacement,
        "overloaded": scene.period
        * float((abs(trace["load_n"][touching]) > holds[touching]).sum()),
        "settling": settling(trace, scene.last_change, target),
        "overshoot": overshoot(trace, scene.last_change, target),
        "pressure_max": float(pressure.max()),
        "pressure_mean": float(pressure[touching].mean()) if touching.any() else 0.0,
        **of_command(trace, scene.period),
    }


def of_command(trace: Trace, period: float) -> dict[str, float]:
    """Energy and chatter of the command, with one finger or two; `period` is that of frames [s]."""
    time, steps = trace["time_s"], np.diff(trace["grip_n"])
    late = time[1:] > time[-1] - LATE + 1e-9
    return {
        "energy": float((steps**2).sum()) / period,
        "chatter": float(abs(steps[late]).sum()) / LATE,
    }


def settling(trace: Trace, since: float, target: float = DESIRED_MARGIN) -> float:
    """Time from an instant to the last exit of the true Γ from its band, or to the end [s]."""
    time, margin = trace["time_s"], trace["margin_true"]
    # Without contact there is no margin, and nothing has settled.
    outside = (time > since + 1e-9) & ~(abs(margin - target) <= BAND)
    last = np.flatnonzero(outside)
    if not len(last):
        return 0.0
    return float(time[min(last[-1] + 1, len(time) - 1)]) - since


def overshoot(trace: Trace, since: float, target: float = DESIRED_MARGIN) -> float:
    """Largest excess of the true Γ over its target after an instant [points]."""
    margin = trace["margin_true"][trace["time_s"] > since + 1e-9]
    margin = margin[np.isfinite(margin)]
    return 100.0 * max(float(margin.max()) - target, 0.0) if len(margin) else 0.0


def together(runs: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Scores of several grasps together."""
    return {
        name: float(join(np.array([run[name] for run in runs])))
        for name, (_, join) in SCORES.items()
    }


def worst(runs: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Largest of each score over several grasps; all of their gross slips."""
    return {
        name: float((np.sum if name == "gross" else np.max)([run[name] for run in runs]))
        for name in SCORES
    }
