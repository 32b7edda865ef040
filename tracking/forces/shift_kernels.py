"""Compiled reading of the pairs' shifts off tracks. `shifts.py` documents the use."""

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@njit()
def seen_by_design(
    position: Array,
    log_size: Array,
    pairs: NDArray[np.intp],
    middle: Array,
    radius: float,
    coefficients: Array,
    degree: int,
    out: Array,
) -> None:
    """(x, y, log size) of the pairs' layers as the design's camera would have shown them.

    Parameters
    ----------
    position, log_size: of tracks, shapes (L, M, 2) and (L, M)
    pairs: numbers of those that are read, shape (P,)
    middle, radius, coefficients, degree: see `Alignment`
    out: result, shape (P, 3L)
    """
    basis = np.empty(coefficients.shape[1])
    for p in range(len(pairs)):
        for k in range(position.shape[0]):
            x = (position[k, pairs[p], 0] - middle[0]) / radius
            y = (position[k, pairs[p], 1] - middle[1]) / radius
            basis[0] = 1.0
            end = 1
            for power in range(1, degree + 1):
                begin = end - power  # of the terms of the power before
                for j in range(power):
                    basis[end + j] = basis[begin + j] * x
                basis[end + power] = basis[end - 1] * y
                end += power + 1
            for i in range(3):
                total = 0.0
                for j in range(end):
                    total += coefficients[i, j] * basis[j]
                out[p, 3 * k + i] = total
            out[p, 3 * k + 2] += log_size[k, pairs[p]]


@njit()
def whole_pairs(
    visible: Mask,
    ambiguous: Mask,
    pairs: NDArray[np.intp],
    there: Mask,
    certain: Mask,
    whole: Mask,
) -> int:
    """Pairs of which every marker that was there at rest is visible, and certain as well.

    Parameters
    ----------
    visible, ambiguous: of tracks, shape (L, M)
    pairs: numbers of those that are read, shape (P,)
    there: markers of these that were there at rest, shape (L, P)
    certain, whole: results, shape (P,)

    Returns
    -------
    Number of certain pairs.
    """
    number = 0
    for p in range(len(pairs)):
        whole[p] = certain[p] = True
        for k in range(there.shape[0]):
            if there[k, p]:
                seen = visible[k, pairs[p]]
                whole[p] = whole[p] and seen
                certain[p] = certain[p] and seen and not ambiguous[k, pairs[p]]
        number += certain[p]
    return number
