"""Compiled overlap of the two layers' markers. `truth.py` documents the use."""

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit

Array = NDArray[np.float64]


@njit()
def shares_inside(magenta: Array, yellow: Array, square: bool, samples: Array) -> Array:
    """Share of points q of each magenta outline that lie within its yellow partner's, shape (M,).

    Parameters
    ----------
    magenta, yellow: centre and axes (c, a₁, a₂) of each outline, shape (M, 3, 2)
    square: whether markers are squares, else discs
    samples: points q of the unit outline, shape (K, 2)
    """
    shares = np.full(len(magenta), np.nan)
    for m in range(len(magenta)):
        a, b = yellow[m, 1], yellow[m, 2]
        det = a[0] * b[1] - a[1] * b[0]
        # Magenta's coordinates to yellow's: p = c + A·q, and back by the inverse of yellow's A.
        to = np.empty((3, 2))
        for k in range(3):
            x, y = magenta[m, k, 0], magenta[m, k, 1]
            if k == 0:
                x, y = x - yellow[m, 0, 0], y - yellow[m, 0, 1]
            to[k, 0], to[k, 1] = (x * b[1] - y * b[0]) / det, (y * a[0] - x * a[1]) / det
        if not np.isfinite(to).all():
            continue
        count = 0
        for i in range(len(samples)):
            u = to[0, 0] + samples[i, 0] * to[1, 0] + samples[i, 1] * to[2, 0]
            v = to[0, 1] + samples[i, 0] * to[1, 1] + samples[i, 1] * to[2, 1]
            if square:
                count += abs(u) < 1.0 and abs(v) < 1.0
            else:
                count += u * u + v * v < 1.0
        shares[m] = count / len(samples)
    return shares
