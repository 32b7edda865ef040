"""Compiled Fisher information of marker positions and sizes; `positions` documents the use."""

import math

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit
from ...render.drawing import covered_by_both, signed_distance, togetherness

Array = NDArray[np.float64]

#: Step of central differences of a centre [px].
_STEP = 0.01
#: Step of central differences of a size, as a share of it.
_GROWTH = 1e-3
#: Distance at which a blurred edge ends [standard deviations].
_REACH = 5.0
#: The positions among (x, y, log size) of both markers of a pair.
_POSITION = np.array([0, 1, 3, 4])


@njit()
def encode_level(linear: float) -> float:
    """SRGB level 0…255 of linear light, clipped and not rounded."""
    v = min(max(linear, 0.0), 1.0)
    if v <= 0.0031308:
        return 255.0 * 12.92 * v
    return 255.0 * (1.055 * v ** (1.0 / 2.4) - 0.055)


@njit()
def _covered(dx: float, dy: float, inverse: Array, width: float) -> float:
    """Share of a pixel that a blurred marker covers, at an offset from its centre [px]."""
    inside = signed_distance(dx, dy, inverse, 0.5 * width * width)[0]
    if abs(inside) > _REACH * width:
        return 1.0 if inside > 0.0 else 0.0
    return 0.5 * math.erfc(-inside / (math.sqrt(2.0) * width))


@njit()
def _boxes(shapes: Array, width: float, height: int, wide: int) -> NDArray[np.int64]:
    """Pixels (x0, x1, y0, y1) that each pair reaches, shape (M, 4); empty for none of both."""
    found = np.zeros((shapes.shape[1], 4), dtype=np.int64)
    for m in range(shapes.shape[1]):
        low_x, low_y, high_x, high_y = np.inf, np.inf, -np.inf, -np.inf
        for layer in range(2):
            shape = shapes[layer, m]
            if math.isnan(shape[0, 0]):
                continue
            reach_x = math.hypot(shape[1, 0], shape[2, 0]) + _REACH * width
            reach_y = math.hypot(shape[1, 1], shape[2, 1]) + _REACH * width
            low_x, high_x = min(low_x, shape[0, 0] - reach_x), max(high_x, shape[0, 0] + reach_x)
            low_y, high_y = min(low_y, shape[0, 1] - reach_y), max(high_y, shape[0, 1] + reach_y)
        if high_x > low_x:
            x0, x1 = max(int(low_x), 0), min(int(high_x) + 2, wide)
            y0, y1 = max(int(low_y), 0), min(int(high_y) + 2, height)
            if x1 > x0 and y1 > y0:  # else it lies outside of the picture
                found[m, 0], found[m, 1], found[m, 2], found[m, 3] = x0, x1, y0, y1
    return found


@njit()
def _cover(marker: Array, inverse: Array, width: float, box: NDArray[np.int64]) -> Array:
    """Share of each pixel of a box that a marker covers, row by row; 0 for an absent marker."""
    wide = box[1] - box[0]
    cover = np.zeros((box[3] - box[2]) * wide)
    for n in range(0 if math.isnan(marker[0, 0]) else len(cover)):
        dx, dy = box[0] + n % wide - marker[0, 0], box[2] + n // wide - marker[0, 1]
        cover[n] = _covered(dx, dy, inverse, width)
    return cover


@njit()
def _transmitted(cover: Array, pair: Array, absorbed: Array) -> Array:
    """Share of the light that pixels let through which a pair covers so much, shape (N, 3).

    Parameters
    ----------
    cover: by each marker, shape (2, N)
    pair: (c, a₁, a₂) of both markers [px], shape (2, 3, 2)
    absorbed: 1 − transmittance of each layer, shape (2, 3)
    """
    together = togetherness(pair[0], pair[1])
    if math.isnan(together):
        together = 1.0
    share = np.empty((cover.shape[1], 3))
    for n in range(len(share)):
        c0, c1 = cover[0, n], cover[1, n]
        both = covered_by_both(c0, c1, together)
        for c in range(3):
            a0, a1 = absorbed[0, c], absorbed[1, c]
            share[n, c] = 1.0 - a0 * c0 - a1 * c1 + a0 * a1 * both
    return share


def fisher_information(
    shapes: Array, inverses: Array, width: float, absorbed: Array, ground: Array, contrast: float
) -> Array:
    """`pair_information` about (x, y) alone, sizes being known, shape (M, 4, 4) [1/px²]."""
    information = pair_information(shapes, inverses, width, absorbed, ground, contrast)
    return information[:, _POSITION[:, None], _POSITION]


@njit()
def pair_information(
    shapes: Array, inverses: Array, width: float, absorbed: Array, ground: Array, contrast: float
) -> Array:
    """Information of a frame's levels on (x, y, log size) of both markers of pairs, at noise 1.

    Parameters
    ----------
    shapes: (c, a₁, a₂) of each marker [px], NaN for an absent one, shape (2, M, 3, 2)
    inverses: of the matrices with columns a₁ and a₂ [1/px], shape (2, M, 2, 2)
    width: standard deviation of an edge [px]
    absorbed: 1 − transmittance of each layer, shape (2, 3)
    ground: linear light without markers, shape (H, W, 3)
    contrast: of the levels

    Returns
    -------
    Shape (M, 6, 6) [1/px², 1/px, 1], rows of absent markers 0.
    """
    count = shapes.shape[1]
    boxes = _boxes(shapes, width, ground.shape[0], ground.shape[1])
    light = ground.copy()
    covers, own = [], []
    for m in range(count):
        x0, x1, y0, y1 = boxes[m]
        cover = np.zeros((2, (x1 - x0) * (y1 - y0)))
        for k in range(2):
            cover[k] = _cover(shapes[k, m], inverses[k, m], width, boxes[m])
        covers.append(cover)
        own.append(_transmitted(cover, shapes[:, m], absorbed))
        light[y0:y1, x0:x1] *= own[m].reshape(y1 - y0, x1 - x0, 3)
    information = np.zeros((count, 6, 6))
    for m in range(count):
        x0, x1, y0, y1 = boxes[m]
        others = light[y0:y1, x0:x1].copy().reshape(-1, 3) / own[m]
        slope = np.zeros((6, others.size))
        for i in range(6):
            k, axis = i // 3, i % 3
            nudge = _STEP if axis < 2 else _GROWTH
            moved, shares = [], []
            for step in (nudge, -nudge):
                pair, cover, inverse = shapes[:, m].copy(), covers[m].copy(), inverses[k, m]
                if axis < 2:
                    pair[k, 0, axis] += step
                else:
                    pair[k, 1:] *= 1.0 + step
                    inverse = inverse / (1.0 + step)
                cover[k] = _cover(pair[k], inverse, width, boxes[m])
                moved.append(cover[k])
                shares.append(_transmitted(cover, pair, absorbed))
            up, down = shares[0], shares[1]
            for n in np.flatnonzero(moved[0] != moved[1]):  # the others are far from the edge
                for c in range(3):
                    high, low = others[n, c] * up[n, c], others[n, c] * down[n, c]
                    change = encode_level(high) - encode_level(low)
                    slope[i, 3 * n + c] = contrast * change / (2.0 * nudge)
        if others.size:
            information[m] = slope @ slope.T
    return information
