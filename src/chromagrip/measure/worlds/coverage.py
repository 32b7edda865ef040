"""Intervals of Γ over the frames of closed-loop runs, and the runs beyond the thesis's objects.

Errors of an estimate stay from frame to frame, so that a run is inside or outside as a whole:
what is drawn again in a bootstrap are runs, not frames.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...loop.trace import Trace
from ...model import GROSS_SLIP
from ...output.report import Bounds, Row, measured, reported

#: Largest true Γ of the frames that count: of a press without a load nothing is asked.
LARGEST_MARGIN = 0.85
#: Share of a run's frames outside the interval above which the run counts as outside.
OUTSIDE = 0.3
#: Number of draws of the bootstrap, and its seed.
DRAWS, SEED = 1000, 23

#: React To Slip on the truth path waits for no more than this [mm] …
WAITS_MM = 1.4
#: … and by camera may slip by this where it does [mm].
REACTS_MM = 1.5


def count_frames(trace: Trace) -> dict[str, float]:
    """Frames with a true Γ below 0.85, and among them those of each kind.

    `outside` is outside the 90 % interval, `unsafe` below it, `wrong` further out than twice its
    half-width, `flagged` without an estimate. Only the first of `frames` has an estimate.
    """
    counts = trace["margin_true"] < LARGEST_MARGIN
    seen = counts & np.isfinite(trace["margin_estimated"])
    true, middle = trace["margin_true"][seen], trace["margin_estimated"][seen]
    low, high = trace["margin_low"][seen], trace["margin_high"][seen]
    outside = (true < low) | (true > high)
    wrong = abs(true - middle) > np.maximum(middle - low, high - middle) * 2.0
    return {
        "frames": float(seen.sum()),
        "outside": float(outside.sum()),
        "unsafe": float((true < low).sum()),
        "wrong": float((wrong & outside).sum()),
        "flagged": float((counts & ~np.isfinite(trace["margin_estimated"])).sum()),
    }


def coverage_rows(runs: Mapping[str, Sequence[Mapping[str, float]]]) -> list[Row]:
    """Rows `coverage/camera/controller/score`, and those of all controllers together.

    Parameters
    ----------
    runs: counts of frames of each run, by controller
    """
    rows = []
    for name, counted in runs.items():
        target = Bounds(80.0, 100.0)
        rows.append(measured(("coverage", "camera", name, "inside"), _inside(counted), "%", target))
    every = [run for counted in runs.values() for run in counted]
    case = ("coverage", "camera", "all")
    low, high = _bootstrapped(every)
    with_frames = [run for run in every if run["frames"]]
    outside = [run for run in with_frames if run["outside"] > OUTSIDE * run["frames"]]
    wrong = [run for run in outside if run["wrong"] > OUTSIDE * run["frames"]]
    whole = max(len(with_frames), 1)
    flagged = sum(run["flagged"] for run in every)
    return [
        *rows,
        reported((*case, "runs"), len(with_frames), "runs"),
        measured((*case, "inside"), _inside(every), "%", Bounds(85.0, 97.0)),
        reported((*case, "inside_low"), low, "%", "5th percentile of the bootstrap over runs"),
        reported((*case, "inside_high"), high, "%", "95th percentile of the bootstrap over runs"),
        measured((*case, "unsafe"), _share(every, "unsafe"), "%", Bounds(0.0, 5.0)),
        measured((*case, "runs_outside"), 100.0 * len(outside) / whole, "%", Bounds(0.0, 12.0)),
        measured((*case, "runs_wrong"), len(wrong), "runs", Bounds(0.0, 0.0)),
        reported((*case, "flagged"), _percent(flagged, flagged + _total(every)), "%"),
    ]


def slip_rows(slips: Mapping[str, Sequence[tuple[float, float]]]) -> list[Row]:
    """Rows of slip by camera wherever the truth path holds, `beyond/camera/controller/score`.

    Parameters
    ----------
    slips: lateral displacement on the truth path and by camera of each run [mm], by controller
    """
    rows, every = [], []
    for name, pairs in slips.items():
        held = [camera for truth, camera in pairs if truth <= 1e3 * GROSS_SLIP]
        every += held
        case, slid = ("beyond", "camera", name), sum(slip > 1e3 * GROSS_SLIP for slip in held)
        note = f"{slid} of {len(held)} runs"
        rows.append(
            reported((*case, "gross_where_truth_holds"), _percent(slid, len(held)), "%", note)
        )
        if name == "react-to-slip":
            waited = [camera for truth, camera in pairs if truth < WAITS_MM]
            worst = max(waited, default=None)
            case_target = Bounds(0.0, REACTS_MM)
            rows.append(measured((*case, "largest_where_truth_waits"), worst, "mm", case_target))
    slid = sum(slip > 1e3 * GROSS_SLIP for slip in every)
    row = ("beyond", "camera", "all", "gross_where_truth_holds")
    note = f"{slid} of {len(every)} runs"
    return [*rows, measured(row, _percent(slid, len(every)), "%", Bounds(0.0, 3.0), note)]


def _total(runs: Sequence[Mapping[str, float]]) -> float:
    return sum(run["frames"] for run in runs)


def _share(runs: Sequence[Mapping[str, float]], kind: str) -> float | None:
    return _percent(sum(run[kind] for run in runs), _total(runs))


def _inside(runs: Sequence[Mapping[str, float]]) -> float | None:
    outside = _share(runs, "outside")
    return None if outside is None else 100.0 - outside


def _percent(part: float, whole: float) -> float | None:
    return 100.0 * part / whole if whole else None


def _bootstrapped(runs: Sequence[Mapping[str, float]]) -> tuple[float | None, float | None]:
    """5th and 95th percentile of the frames inside, over draws of as many runs [%]."""
    frames = np.array([run["frames"] for run in runs])
    outside = np.array([run["outside"] for run in runs])
    if not frames.sum():
        return None, None
    drawn = np.random.default_rng(SEED).integers(len(runs), size=(DRAWS, len(runs)))
    whole = np.maximum(frames[drawn].sum(axis=1), 1.0)
    inside = 100.0 * (1.0 - outside[drawn].sum(axis=1) / whole)
    return float(np.percentile(inside, 5.0)), float(np.percentile(inside, 95.0))


def _tilted(degrees: float) -> list[list[float]]:
    """Points of a plane that is tilted about y, in mm."""
    rise = 20.0 * math.tan(math.radians(degrees))
    return [[-20.0, -rise], [0.0, 0.0], [20.0, rise]]


#: A bump of 0.3 mm, 4 mm wide [mm].
_BUMP = [[-20.0, 0.0], [-2.0, 0.0], [-1.0, -0.2], [0.0, -0.3], [1.0, -0.2], [2.0, 0.0], [20.0, 0.0]]
#: Loads of the runs beyond, each as changes of a scene.
_LOADS: dict[str, dict[str, Any]] = {
    "small": {"load.times_s": [0.04, 0.8], "load.forces_n": [0.1, 0.65]},
    "large": {"load.times_s": [0.04, 0.8], "load.forces_n": [0.05, 1.5]},
    "jerk": {
        "load.times_s": [0.04, 0.8, 0.82, 0.92, 0.94],
        "load.forces_n": [0.4, 0.4, 1.2, 1.2, 0.4],
        "load.interpolation": "linear",
    },
    "reversal": {
        "load.times_s": [0.04, 0.14, 0.8, 0.9],
        "load.forces_n": [0.0, 0.4, 0.4, -0.4],
        "load.interpolation": "linear",
    },
    "sine": {
        "load.times_s": [0.04],
        "load.forces_n": [0.4],
        "load.sine_n": 0.25,
        "load.sine_hz": 1.5,
    },
}


def _case(
    load: str, friction: float, kpa: float, shape: float | list[list[float]]
) -> dict[str, Any]:
    key = "object.profile_mm" if isinstance(shape, list) else "object.radius_mm"
    return {
        **_LOADS[load],
        "object.friction": friction,
        "object.stiffness_kpa": kpa,
        key: shape,
        "duration_s": 1.6,
    }


#: Load, µ, Young's modulus [kPa], and radius [mm] or profile, as changes of a scene.
BEYOND: list[dict[str, Any]] = [
    _case("small", 0.5, 200.0, math.inf),
    _case("small", 0.15, 200.0, 20.0),
    _case("small", 0.9, 16.0, 3.0),
    _case("small", 0.3, 400.0, 3.0),
    _case("small", 0.5, 100.0, _tilted(2.0)),
    _case("large", 0.15, 400.0, math.inf),
    _case("large", 0.5, 32.0, 10.0),
    _case("large", 0.9, 200.0, 5.0),
    _case("large", 0.7, 100.0, _BUMP),
    _case("jerk", 0.3, 32.0, 20.0),
    _case("jerk", 0.7, 400.0, 5.0),
    _case("jerk", 0.5, 200.0, _tilted(5.0)),
    _case("reversal", 0.15, 100.0, math.inf),
    _case("reversal", 0.5, 16.0, 10.0),
    _case("reversal", 0.5, 200.0, _tilted(10.0)),
    _case("sine", 0.3, 200.0, 5.0),
    _case("sine", 0.9, 400.0, math.inf),
    _case("sine", 0.5, 100.0, _BUMP),
]
