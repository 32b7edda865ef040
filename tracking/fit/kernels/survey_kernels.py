"""Compiled judgement of a frame's fit, and its reported results. `looks.py` documents the use."""

import math

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit
from .neighbour_kernels import crowded, tie_light, torn_off

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@njit()
def survey(
    fits: Array,
    misfit: Array,
    present: Mask,
    rest: Array,
    near: NDArray[np.int64],
    over: NDArray[np.int64],
    limits: Array,
    apart: float,
    share: float,
    radii: Array,
    visible: Mask,
    torn: Mask,
    on_others: Mask,
    touching: Mask,
) -> None:
    """Find the markers that a fit explains, and those of them at suspicious positions.

    Parameters
    ----------
    fits, rest: parameters of the markers now and at rest, shape (M, 2, 5)
    misfit: misfit of each pair, shape (M,)
    present: whether the fit has each layer's marker, shape (M, 2)
    near, over: indices of pairs next to each pair, and that may lie on it, shapes (M, K)
    limits: misfit of each pair above which it counts as lost, shape (M,)
    apart: largest difference between the displacements of neighbours or layers [px]
    share: displacement of the inner layer over that of the outer one; NaN if unknown
    radii: distances at which markers may be confused, and touch (rows), by layer [px], (2, 2)
    visible, torn, on_others: results, see `Look`, shape (M, 2)
    touching: result, see `Look`, shape (M,)
    """
    moved = np.empty((len(fits), 2, 2))
    for m in range(len(fits)):
        for k in range(2):
            visible[m, k] = misfit[m] < limits[m] and present[m, k]
            for i in range(2):
                moved[m, k, i] = fits[m, k, i] - rest[m, k, i]
    strayed = torn_off(moved, visible, near, apart)
    meeting = crowded(fits, visible, over, radii[0])
    close = crowded(fits, visible, over, radii[1])
    for m in range(len(fits)):
        for k in range(2):
            torn[m, k], on_others[m, k] = strayed[m, k], meeting[m, k]
        touching[m] = close[m, 0] or close[m, 1]
        if visible[m, 0] and visible[m, 1]:
            for i in range(2):
                if abs(moved[m, 1, i] - share * moved[m, 0, i]) > apart:
                    torn[m, :] = True


@njit()
def report(
    gains: Array,
    rest_gains: Array,
    misfit: Array,
    visible: Mask,
    near: NDArray[np.int64],
    spread: Array,
    doubt: Array,
    fits: Array,
    covariance: Array,
    log_size: Array,
) -> None:
    """Turn a fit into the reported values of the markers, with light tied to the neighbours'.

    Parameters
    ----------
    gains, rest_gains: light now and at rest, shape (M, 3)
    misfit: mean squared residual over noise variance, shape (M,)
    visible: whether each marker is visible, shape (M, 2)
    near: indices of K neighbours of each pair, shape (M, K)
    spread: factors on the standard deviations of (x, y, e) of both layers, shape (M, 6)
    doubt: variances that are added to those of (x, y, e) of both layers, shape (M, 6)
    fits, covariance: parameters and covariance of the fit, corrected in place, shapes (M, 2, 5) and
        (M, 9, 9); set to NaN where not visible
    log_size: result: logarithm of the markers' sizes over those at rest, shape (2, M)
    """
    count = len(fits)
    light, seen = np.empty((count, 3)), np.empty(count, dtype=np.bool_)
    for m in range(count):
        seen[m] = visible[m, 0] or visible[m, 1]
        # Where the model leaves more than noise unexplained, the fit is less certain.
        excess = max(misfit[m], 1.0) if seen[m] else 1.0
        covariance[m] *= excess
        for c in range(3):  # the gain of an invisible pair may be 0
            gained = gains[m, c] / rest_gains[m, c]
            light[m, c] = math.log(gained) if gained > 0.0 else np.nan
        for k in range(2):
            if not visible[m, k]:
                fits[m, k] = np.nan
    tie_light(light, seen, near, covariance, fits)
    for m in range(count):
        for k in range(2):
            p, q = fits[m, k, 3], fits[m, k, 4]
            log_size[k, m] = fits[m, k, 2] + 0.5 * math.log(1.0 - p * p - q * q)
        for i in range(6):
            for j in range(6):
                covariance[m, i, j] *= spread[m, i] * spread[m, j]
            covariance[m, i, i] += doubt[m, i]
        for k in range(2):
            if not visible[m, k]:
                covariance[m, 3 * k : 3 * k + 3, :] = np.nan


@njit()
def velocities(
    fits: Array, before: Array, steady: Mask, near: NDArray[np.int64], out: Array
) -> None:
    """Predict the motion until the next frame: the mean motion of each pair and its neighbours.

    Parameters
    ----------
    fits, before: parameters in this frame and in the previous one, shape (M, 2, 5)
    steady: markers whose motion is known, shape (M, 2)
    near: indices of K neighbours of each pair, shape (M, K)
    out: result, shape (M, 2, 5); 0 except for positions
    """
    out[:] = 0.0
    for m in range(len(fits)):
        for k in range(2):
            for i in range(2):
                total = fits[m, k, i] - before[m, k, i] if steady[m, k] else 0.0
                for n in near[m]:
                    if steady[n, k]:
                        total += fits[n, k, i] - before[n, k, i]
                out[m, k, i] = total / (1 + near.shape[1])
