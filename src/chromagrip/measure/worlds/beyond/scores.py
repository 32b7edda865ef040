"""Scores of the world `beyond`: whether an estimate that is wrong says so.

A frame is *flagged* if it has no estimate, with a reason, or if its interval of Γ has no end: then
it says nothing of Γ either. The scores of a quantity (ΣFn, ΣFf, Γ, and µ where Γ < 0.85) are

- `honest`: share of frames that are flagged, or whose truth lies in the 90 % interval;
- `narrow`: share of frames that are wrong, narrow and unflagged: the truth lies further from the
  estimate than twice the interval's half-width; an estimate without an interval has the width 0;
- `coverage`, `width`, `error` and `bias`: of the frames that are read, which are those that are not
  flagged and whose interval has an end. `width` is the mean half-width over the RMS error, `error`
  the RMS error, of ΣFn as a share.

Without a quantity before it, `honest` is the mean over frames and quantities, and `narrow` the
share of frames in which any quantity is wrong, narrow and unflagged.
"""

import numpy as np
from numpy.typing import NDArray

from ..force_scores import OBSERVABLE, QUANTITIES, Answers, average, rms

Array = NDArray[np.float64]

#: Unit of every score.
UNITS = {
    "honest": "%",
    "narrow": "%",
    "flagged": "%",
    **{f"{quantity}_honest": "%" for quantity in QUANTITIES},
    **{f"{quantity}_narrow": "%" for quantity in QUANTITIES},
    **{f"{quantity}_coverage": "%" for quantity in QUANTITIES},
    **{f"{quantity}_width": "× RMS" for quantity in QUANTITIES},
    **{
        f"{quantity}_{score}": unit
        for quantity, unit in zip(QUANTITIES, ("%", "N", "", ""), strict=True)
        for score in ("error", "bias")
    },
    "scenes": "",
}


def beyond_scores(estimate: Answers, true: Array) -> dict[str, float]:
    """Every score of UNITS; NaN where no frame has it.

    Parameters
    ----------
    estimate: estimates of S scenes
    true: (ΣFn, ΣFf, µ, Γ) of each, shape (S, 4)
    """
    low, high = np.moveaxis(estimate.interval, -1, 0)
    half = np.nan_to_num(0.5 * (high - low), nan=0.0, posinf=np.inf)
    error = estimate.value - true
    flagged = estimate.flagged | np.isinf(half[:, QUANTITIES.index("margin")])
    silent = flagged[:, None] | np.isinf(half)
    inside = (low <= true) & (true <= high)
    honest, narrow = silent | inside, ~silent & (abs(error) > 2.0 * half)
    asked = np.ones_like(true, dtype=np.bool_)
    asked[:, QUANTITIES.index("mu")] = true[:, QUANTITIES.index("margin")] < OBSERVABLE
    scale = np.ones_like(true)
    scale[:, 0] = 100.0 / true[:, 0]
    result = {
        "honest": 100.0 * average(honest[asked]),
        "narrow": 100.0 * average((narrow & asked).any(axis=1)),
        "flagged": 100.0 * average(flagged),
        "scenes": float(len(true)),
    }
    for k, name in enumerate(QUANTITIES):
        mine = asked[:, k]
        read = mine & ~silent[:, k]
        off = (scale * error)[read, k]
        width = average((scale * half)[read, k])
        result |= {
            f"{name}_honest": 100.0 * average(honest[mine, k]),
            f"{name}_narrow": 100.0 * average(narrow[mine, k]),
            f"{name}_coverage": 100.0 * average(inside[read, k]),
            f"{name}_width": width / rms(off) if rms(off) > 0.0 else float("nan"),
            f"{name}_error": rms(off),
            f"{name}_bias": average(off),
        }
    return {name: result[name] for name in UNITS}
