"""Compiled sums over the marker pairs of a frame. `codes.py` documents the use."""

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit

Array = NDArray[np.float64]
Short = NDArray[np.float32]
Mask = NDArray[np.bool_]


@njit()
def whitened(
    shifts: Array, mean: Array, visible: Mask, largest: float, whiten: Short, out: Short
) -> None:
    """Whiten shifts minus their mean; 0 where a pair is not visible.

    Parameters
    ----------
    shifts, mean: (x, y, log size) of both layers of P pairs, shape (P, 6)
    visible: whether each pair is visible, shape (P,)
    largest: bound to which changes of log size are clipped
    whiten: lower triangular whitening matrices, shape (P, 6, 6)
    out: result, shape (P, 6)
    """
    centred = np.empty(shifts.shape[1], dtype=np.float32)
    for p in range(len(shifts)):
        for i in range(shifts.shape[1]):
            value = shifts[p, i]
            if i % 3 == 2:
                value = min(max(value, -largest), largest)
            centred[i] = value - mean[p, i] if visible[p] else 0.0
        for i in range(shifts.shape[1]):
            total = np.float32(0.0)
            for j in range(i + 1):
                total += whiten[p, i, j] * centred[j]
            out[p, i] = total


@njit()
def left_over(white: Short, explained: Short, missed: Short, misfit: Short) -> None:
    """Compute residuals of whitened shifts, (P, 6), and each pair's sum of their squares, (P,)."""
    for p in range(len(white)):
        total = np.float32(0.0)
        for i in range(white.shape[1]):
            left = white[p, i] - explained[p, i]
            missed[p, i] = left
            total += left * left
        misfit[p] = total


@njit()
def find_vague(
    covariance: Array, pairs: NDArray[np.intp], visible: Mask, sizes: Array, times: float, out: Mask
) -> bool:
    """Find visible pairs whose log sizes have unusually large variances.

    Parameters
    ----------
    covariance: covariance of the tracks, shape (M, 6, 6)
    pairs: indices of the P used pairs, shape (P,)
    visible: whether these are visible, shape (P,)
    sizes: usual variances of the log sizes, shape (P, 2)
    times: factor on these above which a variance is unusual
    out: result, shape (P,)

    Returns
    -------
    Whether there are any.
    """
    found = False
    for p in range(len(pairs)):
        out[p] = False
        for k in range(2):
            i = 3 * k + 2
            if visible[p] and covariance[pairs[p], i, i] > times * sizes[p, k]:
                out[p] = found = True
    return found


@njit()
def typical_variance(covariance: Array, pairs: NDArray[np.intp], visible: Mask) -> float:
    """Median variance of x of the visible pairs; see `vague`."""
    found = covariance[pairs[visible], 0, 0]
    return float(np.median(found[np.isfinite(found)]))
