"""Times of the slowest frames: a controller feels the worst one, not the median."""

import numpy as np
from numpy.typing import ArrayLike

#: Shares of frames that take no longer, by the name of a score [%].
SLOWEST = {"time_p95": 95.0, "time_p99": 99.0, "time_worst": 100.0}


def slowest(milliseconds: ArrayLike) -> dict[str, float]:
    """Percentiles of times of single frames, by the names of SLOWEST; NaN without any [ms]."""
    known = np.asarray(milliseconds, float)
    return {
        name: float(np.percentile(known, share)) if len(known) else float("nan")
        for name, share in SLOWEST.items()
    }
