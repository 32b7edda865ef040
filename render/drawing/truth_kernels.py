"""Compiled overlap of the two layers' markers. `truth.py` documents the use."""

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit

Array = NDArray[np.float64]


@njit()
def shares_inside(magenta: Array, yellow: Array, square: bool, samples: Array) -> Array:
    """Share of each magenta outline's sample points inside its yellow partner, shape (M,).

    Parameters
    ----------
    magenta, yellow: centre and axes (c, a₁, a₂) of each outline [px], shape (M, 3, 2)
    square: whether markers are squares, else discs
    samples: coordinates of K points q of the unit outline, shape (2, K)
    """
    shares = np.full(len(magenta), np.nan)
    to = np.empty((3, 2))
    for m in range(len(magenta)):
        a, b = yellow[m, 1], yellow[m, 2]
        det = a[0] * b[1] - a[1] * b[0]
        # Magenta's coordinates to yellow's: p = c + A·q, and back by the inverse of yellow's A.
        for k in range(3):
            x, y = magenta[m, k, 0], magenta[m, k, 1]
            if k == 0:
                x, y = x - yellow[m, 0, 0], y - yellow[m, 0, 1]
            to[k, 0], to[k, 1] = (x * b[1] - y * b[0]) / det, (y * a[0] - x * a[1]) / det
        if not np.isfinite(to).all():
            continue
        u0, u1, u2, v0, v1, v2 = to[0, 0], to[1, 0], to[2, 0], to[0, 1], to[1, 1], to[2, 1]
        count = 0
        for i in range(samples.shape[1]):
            u = u0 + samples[0, i] * u1 + samples[1, i] * u2
            v = v0 + samples[0, i] * v1 + samples[1, i] * v2
            size = max(abs(u), abs(v)) if square else u * u + v * v
            count += 1 if size < 1.0 else 0
        shares[m] = count / samples.shape[1]
    return shares
