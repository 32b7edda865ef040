"""Scores of a run with two fingers from the truth, by the names of those with one."""

import math

import numpy as np

from ...loop.column import OUTCOMES
from ...loop.record import Result
from .scorecard import of_command

#: Unit of each score.
UNITS = {
    "gross": "runs", "displacement": "mm", "overloaded": "s", "turn": "°", "pressure_max": "kPa",
    "pressure_mean": "kPa", "energy": "N²/s", "chatter": "N/s",
}  # fmt: skip

#: Digits of a turn [°]: further ones are the solver's noise.
_DIGITS = 3

#: Explanation of them.
NOTES = (
    "lost: runs in which the object was dropped, turned or crushed, or that did not come to their "
    "end. turn: the largest about the axis of the pinch, without the elastic twist. pressure: mean "
    "pressure of a contact, at most, while lifted."
)


def pinch_scores(result: Result) -> dict[str, float]:
    """Scores of a run.

    `gross` is 1 where the object was not held, `displacement` its slide in the hand, `overloaded`
    the time for which a finger has no margin left; the pressures are those while lifted.
    """
    trace, scene = result.trace, result.scene
    lifted = trace["time_s"] > scene.pinch.lifts_at
    limits = np.fmin(trace["first_limit_margin_true"], trace["second_limit_margin_true"])[lifted]
    pressure = trace["pressure_kpa"][lifted]
    return {
        "gross": float(trace["outcome"][-1] != OUTCOMES.index("held")),
        "displacement": float(trace["slide_mm"][-1]),
        "overloaded": scene.period * float((limits <= 0.0).sum()),
        "turn": round(float(abs(trace["turn_deg"]).max()), _DIGITS),
        "pressure_max": float(pressure.max()) if len(pressure) else math.nan,
        "pressure_mean": float(pressure.mean()) if len(pressure) else math.nan,
        **of_command(trace, scene.period),
    }
