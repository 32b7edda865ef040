"""Compiled comparisons of pairs with neighbouring pairs. `pair_fit.py` documents the use."""

import math

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit

Array = NDArray[np.float64]

#: Smallest number of neighbours from which the scatter of the gains is estimated.
_FEWEST = 3


@njit()
def median(values: Array) -> float:
    """Median of K values without NaN."""
    return float(np.median(values))


@njit()
def slopes_of(gains: Array, near: NDArray[np.int64], to_slope: Array, out: Array) -> None:
    """Compute the relative slope of the gains at each of M pairs [1/px] from its neighbours.

    Parameters
    ----------
    gains: gains of each channel, shape (M, 3)
    near: indices of K neighbours of each pair, shape (M, K)
    to_slope: matrices from differences of log gain, neighbours minus own, to slopes, (M, 2, K)
    out: result, shape (M, 2); NaN where a gain is not above zero
    """
    light = np.empty(gains.shape[0])
    for m in range(gains.shape[0]):
        product = gains[m, 0] * gains[m, 1] * gains[m, 2]
        lit = gains[m, 0] > 0.0 and gains[m, 1] > 0.0 and gains[m, 2] > 0.0
        light[m] = math.log(product) / 3.0 if lit else np.nan
    for m in range(gains.shape[0]):
        x = y = 0.0
        for j in range(near.shape[1]):
            more = light[near[m, j]] - light[m]
            x += to_slope[m, 0, j] * more
            y += to_slope[m, 1, j] * more
        out[m, 0], out[m, 1] = x, y


@njit()
def lying(
    fits: Array, present: NDArray[np.bool_], near: NDArray[np.int64], radii: Array
) -> NDArray[np.bool_]:
    """Mask (R, M) of pairs with a marker within one of R distances of another of its layer.

    Parameters
    ----------
    fits, present, near: as in `crowded`
    radii: distances in each layer [px], shape (R, 2)
    """
    out = np.empty((len(radii), len(fits)), dtype=np.bool_)
    for r in range(len(radii)):
        close = crowded(fits, present, near, radii[r])
        for m in range(len(fits)):
            out[r, m] = close[m, 0] or close[m, 1]
    return out


@njit()
def tie_light(
    light: Array,
    visible: NDArray[np.bool_],
    near: NDArray[np.int64],
    covariance: Array,
    fits: Array,
) -> None:
    """Correct positions and sizes, with the neighbours' light as a prior of each pair's light.

    The prior is the mean of the neighbours' gains. Its variance is the scatter of the gains around
    beyond their noise.

    Parameters
    ----------
    light: logarithms of the gains over those at rest, shape (M, 3)
    visible: pairs whose gains are known, shape (M,)
    near: indices of K neighbours of each pair, shape (M, K)
    covariance: covariance of (x, y, e) of both layers and `light`, shape (M, 9, 9), in place
    fits: (x, y, e, p, q) of each layer, shape (M, 2, 5), in place
    """
    count = len(light)
    lack, doubt, excess = np.zeros((count, 3)), np.zeros((count, 3)), np.full(count, np.nan)
    change, shared = np.empty(9), np.empty(9)
    for m in range(count):
        if not (visible[m] and covariance[m, 6, 6] > 0.0):
            continue
        known = 0
        for n in near[m]:
            if visible[n] and covariance[n, 6, 6] > 0.0:
                known += 1
                for c in range(3):
                    lack[m, c] += light[n, c] - light[m, c]
                    doubt[m, c] += covariance[n, 6 + c, 6 + c]
        if known < _FEWEST:
            continue
        excess[m] = 0.0
        for c in range(3):
            lack[m, c] /= known
            doubt[m, c] /= known * known
            excess[m] += (lack[m, c] ** 2 - doubt[m, c] - covariance[m, 6 + c, 6 + c]) / 3.0
    for m in range(count):
        if not math.isfinite(excess[m]):
            continue
        scatter, known = excess[m], 1
        for n in near[m]:
            if math.isfinite(excess[n]):
                scatter += excess[n]
                known += 1
        scatter = max(scatter / known, 0.0)
        spread = covariance[m]
        change[:] = 0.0
        # One channel after the other: their priors are independent.
        for c in range(6, 9):
            variance = spread[c, c] + doubt[m, c - 6] + scatter
            missing = (lack[m, c - 6] - change[c]) / variance
            for i in range(9):
                shared[i] = spread[i, c]
                change[i] += shared[i] * missing
            for i in range(9):
                share = shared[i] / variance
                for j in range(i + 1):
                    spread[i, j] -= share * shared[j]
                    spread[j, i] = spread[i, j]
        for k in range(2):
            for i in range(3):
                fits[m, k, i] += change[3 * k + i]


@njit()
def torn_off(
    moved: Array, visible: NDArray[np.bool_], near: NDArray[np.int64], limit: float
) -> NDArray[np.bool_]:
    """Mask (M, 2) of markers that moved otherwise than half or more of their visible neighbours.

    Parameters
    ----------
    moved: displacements since rest [px], shape (M, 2, 2)
    visible: whether each marker is visible, shape (M, 2)
    near: indices of K neighbours of each pair, shape (M, K)
    limit: largest difference along x or y [px]
    """
    torn = np.zeros(visible.shape, dtype=np.bool_)
    for m in range(visible.shape[0]):
        for k in range(2):
            if not visible[m, k]:
                continue
            known = apart = 0
            for n in near[m]:
                if visible[n, k]:
                    known += 1
                    dx = abs(moved[n, k, 0] - moved[m, k, 0])
                    dy = abs(moved[n, k, 1] - moved[m, k, 1])
                    apart += dx > limit or dy > limit
            torn[m, k] = known > 0 and 2 * apart >= known
    return torn


@njit()
def crowded(
    fits: Array, visible: NDArray[np.bool_], near: NDArray[np.int64], limit: Array
) -> NDArray[np.bool_]:
    """Mask (M, 2) of markers within a distance of another one of their layer.

    Parameters
    ----------
    fits: (x, y, …) of each layer, shape (M, 2, 5)
    visible: whether each marker is visible, shape (M, 2)
    near: indices of K pairs that may come near each pair, shape (M, K)
    limit: distance in each layer [px], shape (2,)
    """
    close = np.zeros(visible.shape, dtype=np.bool_)
    for m in range(visible.shape[0]):
        for n in near[m]:
            for k in range(2):
                if visible[m, k] and visible[n, k]:
                    dx, dy = fits[n, k, 0] - fits[m, k, 0], fits[n, k, 1] - fits[m, k, 1]
                    if dx * dx + dy * dy < limit[k] * limit[k]:
                        close[m, k] = close[n, k] = True
    return close
