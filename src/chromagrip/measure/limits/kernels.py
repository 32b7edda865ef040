"""Compiled Fisher information of marker positions. `track_limit.py` documents the use."""

import math

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit
from ...render.drawing.coverage import covered_by_both, signed_distance, togetherness

Array = NDArray[np.float64]

#: Centres are moved by this for a central difference [px], sizes by this share of themselves, and
#: edges end after so many widths.
_STEP, _GROWTH, _REACH = 0.01, 1e-3, 5.0
#: The positions among (x, y, log size) of both markers of a pair.
_POSITION = np.array([0, 1, 3, 4])


@njit()
def encode_level(linear: float) -> float:
    """SRGB level 0…255 of linear light, not rounded; what is too bright or dark tells nothing."""
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
            found[m, 0], found[m, 1] = max(int(low_x), 0), min(int(high_x) + 2, wide)
            found[m, 2], found[m, 3] = max(int(low_y), 0), min(int(high_y) + 2, height)
    return found


@njit()
def _pass(c0: float, c1: float, together: float, absorbed: Array, channel: int) -> float:
    """Share of the light that a pair lets through where its markers cover so much."""
    both = covered_by_both(c0, c1, together)
    a0, a1 = absorbed[0, channel], absorbed[1, channel]
    return 1.0 - a0 * c0 - a1 * c1 + a0 * a1 * both


@njit()
def _together(shapes: Array, m: int) -> float:
    found = togetherness(shapes[0, m], shapes[1, m])
    return 1.0 if math.isnan(found) else found


def fisher_information(
    shapes: Array, inverses: Array, width: float, absorbed: Array, ground: Array, contrast: float
) -> Array:
    """`pair_information` about (x, y) alone, sizes being known, shape (M, 4, 4) [1/px²]."""
    whole = pair_information(shapes, inverses, width, absorbed, ground, contrast)
    return whole[:, _POSITION[:, None], _POSITION]


@njit()
def pair_information(
    shapes: Array, inverses: Array, width: float, absorbed: Array, ground: Array, contrast: float
) -> Array:
    """Of the levels of a frame about (x, y, log size) of both markers of pairs, at noise 1 level.

    Parameters
    ----------
    shapes: (c, a₁, a₂) of each marker [px], NaN for one that is not there, shape (2, M, 3, 2)
    inverses: of the matrices with columns a₁ and a₂ [1/px], shape (2, M, 2, 2)
    width: standard deviation of an edge [px]
    absorbed: 1 − transmittance of each layer, shape (2, 3)
    ground: linear light without markers, shape (H, W, 3)
    contrast: of the levels

    Returns
    -------
    Shape (M, 6, 6) [1/px², 1/px, 1], rows of markers that are not there 0.
    """
    height, wide = ground.shape[:2]
    count = shapes.shape[1]
    boxes = _boxes(shapes, width, height, wide)
    through = np.ones((height, wide, 3))
    # Coverage of either layer: where the marker is, and with x, y and log size moved up and down.
    moved = np.zeros((2, 7))
    for m in range(count):
        together = _together(shapes, m)
        for y in range(boxes[m, 2], boxes[m, 3]):
            for x in range(boxes[m, 0], boxes[m, 1]):
                for k in range(2):
                    at = shapes[k, m, 0]
                    moved[k, 0] = 0.0
                    if not math.isnan(at[0]):
                        moved[k, 0] = _covered(x - at[0], y - at[1], inverses[k, m], width)
                for c in range(3):
                    through[y, x, c] *= _pass(moved[0, 0], moved[1, 0], together, absorbed, c)
    information = np.zeros((count, 6, 6))
    edges = np.zeros((6, 2))
    slope = np.zeros(6)
    for m in range(count):
        together = _together(shapes, m)
        for i in range(6):
            shape = shapes[i // 3, m]
            before = shape.copy()
            for j in range(2):
                sign = 1.0 - 2.0 * j
                if i % 3 < 2:
                    shape[0, i % 3] += sign * _STEP
                else:
                    shape[1:] *= 1.0 + sign * _GROWTH
                edges[i, j] = _together(shapes, m)
                shape[:] = before
        for y in range(boxes[m, 2], boxes[m, 3]):
            for x in range(boxes[m, 0], boxes[m, 1]):
                for k in range(2):
                    at = shapes[k, m, 0]
                    moved[k] = 0.0
                    if math.isnan(at[0]):
                        continue
                    dx, dy, inverse = x - at[0], y - at[1], inverses[k, m]
                    moved[k, 0] = _covered(dx, dy, inverse, width)
                    moved[k, 1] = _covered(dx - _STEP, dy, inverse, width)
                    moved[k, 2] = _covered(dx + _STEP, dy, inverse, width)
                    moved[k, 3] = _covered(dx, dy - _STEP, inverse, width)
                    moved[k, 4] = _covered(dx, dy + _STEP, inverse, width)
                    moved[k, 5] = _covered(dx, dy, inverse / (1.0 + _GROWTH), width)
                    moved[k, 6] = _covered(dx, dy, inverse / (1.0 - _GROWTH), width)
                for c in range(3):
                    own = _pass(moved[0, 0], moved[1, 0], together, absorbed, c)
                    light = ground[y, x, c] * through[y, x, c] / own
                    for i in range(6):
                        k = i // 3
                        slope[i] = 0.0
                        up = moved[k, 1 + 2 * (i % 3)]
                        down = moved[k, 2 + 2 * (i % 3)]
                        if up == down:  # far from the edge, or no marker
                            continue
                        if k == 0:
                            high = _pass(up, moved[1, 0], edges[i, 0], absorbed, c)
                            low = _pass(down, moved[1, 0], edges[i, 1], absorbed, c)
                        else:
                            high = _pass(moved[0, 0], up, edges[i, 0], absorbed, c)
                            low = _pass(moved[0, 0], down, edges[i, 1], absorbed, c)
                        change = encode_level(light * high) - encode_level(light * low)
                        nudge = _STEP if i % 3 < 2 else _GROWTH
                        slope[i] = contrast * change / (2.0 * nudge)
                    for i in range(6):
                        for j in range(6):
                            information[m, i, j] += slope[i] * slope[j]
    return information
