"""Time series of a run, with truth and estimates, and its summary."""

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..model import GROSS_SLIP
from ..scene.scene import Mechanics, Scene
from ..sources.delivery import lateness
from ..tracking.forces import CameraPose
from ..tracking.forces.chain import Used
from .column import OUTCOMES
from .columns import COLUMNS, prefixes
from .results.expected_error import expected_error

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trace:
    """Columns of a run by name, shape (T,) each."""

    columns: dict[str, Array]

    def __getitem__(self, name: str) -> Array:
        """Column of that name."""
        return self.columns[name]

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.columns["time_s"])


def word_for_read(path: str) -> str:
    """Word for the controller's values on a path: estimates, or the truth with noise."""
    return "estimated" if path == "camera" else "observed"


def may_slide(scene: Scene, of: Mapping[str, Array], before: str = "") -> NDArray[np.bool_]:
    """Frames whose interval of the held margin does not exclude sliding, so that the grip rises.

    Parameters
    ----------
    scene: scene that was run
    of: columns of its trace
    before: beginning of the names of a finger's columns

    Returns
    -------
    bool, shape (T,)
    """
    smaller = f"{before}limit_margin_low"  # missing in older traces of pinches
    with_torsion = scene.holds_torsion and smaller in of
    low = of[smaller if with_torsion else f"{before}margin_low"]
    margin = scene.sliding_margin
    return low <= (-np.inf if margin is None else margin)


class TraceLines:
    """Writes the lines of a trace as text while they come, for a run that is killed.

    Parameters
    ----------
    path: path of the file, which begins with a line of names
    names: names of the columns
    """

    def __init__(self, path: Path, names: Iterable[str] = COLUMNS) -> None:
        self._path = path
        self._file = path.open("w", encoding="utf-8", newline="\n")
        self._file.write(",".join(names) + "\n")

    def add(self, line: Iterable[float]) -> None:
        """Append a line, so that it is in the file when this returns."""
        self._file.write(",".join(map(repr, line)) + "\n")
        self._file.flush()

    def close(self) -> None:
        """Close the file; closing it again does nothing."""
        self._file.close()

    def drop(self) -> None:
        """Remove the file, once the trace is written."""
        self.close()
        self._path.unlink(missing_ok=True)


def make_trace(
    rows: Sequence[float] | Sequence[tuple[float, ...]], names: Iterable[str] = COLUMNS
) -> Trace:
    """Make a trace from its lines, given as tuples or as one flat sequence."""
    columns = list(names)
    values = np.array(rows, dtype=float).reshape(-1, len(columns))
    return Trace(dict(zip(columns, values.T, strict=True)))


#: Results of a run by name; None where a value is unknown.
Summary = dict[str, Any]


class Spent(NamedTuple):
    """Time that a run took, without compiling.

    Attributes
    ----------
    loop: of the loop from the second frame on, without writing files [s]
    reading: of tracking and estimating in each frame that was read, of all fingers together [s]
    """

    loop: float
    reading: Sequence[float] = ()


def summarise(
    scene: Scene,
    trace: Trace,
    spent: Spent,
    used: Used | None = None,
    pose: CameraPose | None = None,
    reasons: Sequence[str] = (),
) -> Summary:
    """Summarise a run of one finger or two; the keys are part of the file format.

    Parameters
    ----------
    scene: scene that was run
    trace: trace until the end of the run or an interruption
    spent: wall-clock time
    used: methods and calibration for the first finger's forces; None on the truth path
    pose: pose of the first finger's camera against the sensor's design; None if it is unknown
    reasons: one reason for each missing estimate of a finger
    """
    values: Summary = {
        "controller": scene.controller,
        "path": scene.path,
        "renderer": scene.renderer,
        "sensor": scene.sensor,
        **(used or dict.fromkeys(Used.__annotations__)),
        "margin_error_expected": used and expected_error(scene, used["reconstructor"]),
        "mechanics": scene.mechanics,
        "camera_pose": None if pose is None else pose.table(),
        "without_estimate": len(reasons),
        "without_estimate_because": counted_kinds(reasons),
        "seed": scene.seed,
        "complete": len(trace) == scene.frames or _outcome(trace) == "dropped",
        "frames": len(trace),
        "duration_s": float(trace["time_s"][-1]) if len(trace) else 0.0,
        "frames_per_second": (len(trace) - 1) / spent.loop if spent.loop > 0 else math.nan,
        **lateness(spent.reading, scene.period),
        "margin_rmse": _margin_error(trace, prefixes(scene)),
        "max_grip_n": _largest(trace["grip_n"]),
        "grip_ceiling_n": scene.grip_ceiling,
        "final_grip_n": _last(trace["grip_n"]),
    }
    values |= _OWN_VALUES[scene.mechanics](scene, trace)
    # JSON has no NaN: an unknown value is null.
    return {
        k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()
    }


def reading_words(summary: Summary) -> str:
    """How long the frames of a summary took to read, and how many came late."""
    reading = summary["reading_ms"]
    return (
        f"{reading['median']:.1f} ms in the median, {reading['p99']:.1f} ms in 99 %, "
        f"{reading['worst']:.1f} ms at worst; in {summary['late_frames']} of {summary['frames']} "
        "frames longer than the frame lasts, which a simulated loop waits for"
    )


def ceiling_words(scene: Scene, summary: Mapping[str, Any]) -> str | None:
    """Say that the grip stood at its ceiling at the end; None where it did not."""
    ceiling, final = scene.grip_ceiling, summary.get("final_grip_n")
    if ceiling is None or not final or final < ceiling - 1e-6:
        return None
    words = f"which is the controller's ceiling of {ceiling:g} N"
    if scene.fingers == 1:
        return words
    gravity, friction = 9.81, scene.object.friction
    needed = 0.5e-3 * (summary.get("final_mass_g") or scene.pinch.mass_g) * gravity / friction
    return f"{words}; at a friction of {friction:g} the weight alone needs {needed:.1f} N"


def _of_one(scene: Scene, trace: Trace) -> Summary:
    """Values of the summary that belong to one finger."""
    late = trace["margin_true"][trace["time_s"] > scene.duration_s - 0.3 - 1e-9]
    # Without an estimate the average of µ is that of earlier frames.
    read = np.where(np.isnan(trace["normal_estimated_n"]), np.nan, trace["mu_estimated"])
    return {
        "final_margin_true": _last(trace["margin_true"]),
        "final_margin_estimated": _last(trace["margin_estimated"]),
        "final_limit_margin_true": _last(trace["limit_margin_true"]),
        "final_limit_margin_estimated": _last(trace["limit_margin_estimated"]),
        "final_turn_deg": _last(trace["object_turn_deg"]),
        "smallest_margin_true": _smallest(trace["margin_true"]),
        "margin_true_min_last_300ms": float(late.min()) if len(late) else math.nan,
        "margin_true_max_last_300ms": float(late.max()) if len(late) else math.nan,
        "final_mu_true": _last(trace["mu_true"]),
        "final_mu_estimated": _last(read),
        "max_pressure_n_per_m": _largest(trace["pressure_n_per_m"]),
        "max_pressure_pitch_n_per_m": _largest(trace["pressure_pitch_n_per_m"]),
        "lateral_displacement_mm": _last(trace["lateral_displacement_mm"]),
        "rigid_slip_mm": _last(trace["rigid_slip_mm"]),
        "gross_slip": bool(_last(trace["lateral_displacement_mm"]) > GROSS_SLIP * 1e3),
        "slip_reactions": _reactions(scene, trace),
    }


def _of_two(scene: Scene, trace: Trace) -> Summary:
    """Values of the summary that belong to two fingers; a margin is the smaller one."""
    lifted = trace["time_s"] > scene.pinch.lifts_at
    margins, limits = (
        np.stack([trace[f"{before}{name}"] for before in prefixes(scene)])
        for name in ("margin_true", "limit_margin_true")
    )
    return {
        "second_sensor": scene.pinch.second_sensor or scene.sensor,
        "mass_g": scene.pinch.mass_g,
        "final_mass_g": _last(trace["mass_g"]),
        "lifted": bool(len(trace) and not trace["table_n"][-1]),
        "left_table": bool((trace["table_n"][lifted] == 0.0).any()),
        "outcome": _outcome(trace),
        "final_margin_true": _last(margins.min(axis=0)),
        "final_limit_margin_true": _last(limits.min(axis=0)),
        "smallest_limit_margin_true": _smallest(limits[:, lifted].ravel()),
        "slide_mm": _last(trace["slide_mm"]),
        "turn_deg": _last(trace["turn_deg"]),
        "elastic_deg": _last(trace["elastic_deg"]),
        "largest_turn_deg": _largest(abs(trace["turn_deg"])),
        "largest_elastic_deg": _largest(abs(trace["elastic_deg"])),
        "max_pressure_kpa": _largest(trace["pressure_kpa"]),
        "mean_grip_n": float(trace["applied_n"].mean()) if len(trace) else math.nan,
    }


#: Values of the summary that belong to one finger, or to two.
_OWN_VALUES: dict[Mechanics, Callable[[Scene, Trace], Summary]] = {
    "chain": _of_one,
    "dome": _of_one,
    "pinch": _of_two,
}


def _margin_error(trace: Trace, befores: Sequence[str]) -> float:
    """RMS error of Γ over all fingers and the frames in which it is known and estimated."""
    true = np.stack([trace[f"{before}margin_true"] for before in befores])
    estimated = np.stack([trace[f"{before}margin_estimated"] for before in befores])
    error = (estimated - true)[np.isfinite(true) & np.isfinite(estimated)]
    return float(np.sqrt((error**2).mean())) if len(error) else math.nan


def counted_kinds(reasons: Iterable[str]) -> dict[str, int]:
    """Count sentences that differ only by numbers, under the first of each, most frequent first."""
    firsts: dict[str, str] = {}
    kinds = Counter(firsts.setdefault(kind_of(reason), reason) for reason in reasons)
    return dict(kinds.most_common())


def kind_of(reason: str) -> str:
    """Sentence without its numbers."""
    return re.sub(r"\d[\d.]*", "…", reason)


def _reactions(scene: Scene, trace: Trace) -> list[dict[str, float]]:
    """Times and displacements at which React To Slip raised the grip after a slip."""
    if scene.controller != "react-to-slip":
        return []
    steps = np.flatnonzero(np.diff(trace["grip_n"]) > 0.9 * scene.react_to_slip.step_n)
    names = ("time_s", "lateral_displacement_mm")
    return [{name: float(trace[name][k + 1]) for name in names} for k in steps]


def _outcome(trace: Trace) -> str | None:
    """Outcome of two fingers so far; None with one finger, and before the first frame."""
    if "outcome" not in trace.columns or not len(trace):
        return None
    return OUTCOMES[int(trace["outcome"][-1])]


def _last(column: Array) -> float:
    return float(column[-1]) if len(column) else math.nan


def _smallest(column: Array) -> float:
    return -_largest(-column)


def _largest(column: Array) -> float:
    finite = column[np.isfinite(column)]
    return float(finite.max()) if len(finite) else math.nan
