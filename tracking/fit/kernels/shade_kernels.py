"""Compiled shading of pairs by each other. `pair_fit.py` documents the use.

Pairs apart from each other darken each other's ground. Where edges of two pairs come close, the
light of a pixel depends on the angle between these edges, see `render.drawing.coverage.beside`.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit
from ....render.drawing import (
    APART,
    EDGE_RANGE,
    covered_by_both,
    covered_slope,
    crossing,
    edge,
    odds_ratio,
    togetherness,
)
from .pixel_kernels import (
    BESIDE,
    F1,
    GROUND,
    TERM,
    TINY,
    Array,
    Array32,
    X,
    Y,
    clear,
    invert,
    row_at,
    stretch,
)

#: Distance outside an edge at which its shade ends [standard deviations of the edge].
_SHADE = 2.4
#: Lower bound of coverages in denominators.
_LITTLE = np.float32(1e-6)
#: First row for the coverages by a pair's layers and by both. It and the next ones are used by
#: uneven light afterwards …
_PAIR = TERM
#: … for the coverage by all other pairs, and the light that they absorb, of each channel …
_OTHERS = TERM + 3
#: … and for the pair that covers most of a pixel, later for the odds ratio with its edges.
_MOST = TERM + 7


@njit()
def shade(
    optics: Any,
    present: NDArray[np.bool_],
    fits: Array,
    extents: Array,
    m: int,
    beside: bool,
    box: Array,
    count: int,
    buffer: Array32,
) -> None:
    """Subtract from a pair's light what the markers of other pairs in its box absorb.

    With `beside`, edges of neighbours run side by side with those of the pair, see
    `render.drawing.coverage.beside`: a part of their absorption adds to that of the pair. This
    needs a pair near its final position. Otherwise the pairs' transmittances multiply.
    """
    for c in range(3):
        clear(buffer, row_at(BESIDE + c), count)
    near = np.empty((len(optics.neighbours[m]), 2), dtype=np.bool_)
    meeting, met = np.empty(len(near), dtype=np.int64), 0
    for n, other in enumerate(optics.neighbours[m]):
        if other < 0:
            continue
        for k in range(2):
            x, y = fits[other, k, 0], fits[other, k, 1]
            reach = _SHADE * optics.width + extents[other, k]
            dx = max(box[0] - x, 0.0, x - box[1])
            dy = max(box[2] - y, 0.0, y - box[3])
            near[n, k] = present[other, k] and dx * dx + dy * dy < reach * reach
        if not near[n].any():
            continue
        if beside and _meet(optics.width, present, fits, extents, m, other):
            meeting[met] = n
            met += 1
            continue
        _cover_pair(optics, near[n], fits, other, count, buffer)
        for c in range(3):
            a = optics.absorbed[:, c]
            _darken(row_at(GROUND + c), a[0], a[1], a[2], count, buffer)
    if met == 0:
        return
    for row in range(_OTHERS, _MOST):
        clear(buffer, row_at(row), count)
    for n in meeting[:met]:
        other = optics.neighbours[m, n]
        _cover_pair(optics, near[n], fits, other, count, buffer)
        _add(optics, present, fits, other, n == meeting[0], count, buffer)
    _cover_pair(optics, present[m], fits, m, count, buffer)
    _to_odds(optics, present, fits, m, count, buffer)
    for c in range(3):
        a = optics.absorbed[:, c]
        _split(c, a[0], a[1], a[2], count, buffer)


@njit()
def _meet(
    width: float, present: NDArray[np.bool_], fits: Array, extents: Array, m: int, other: int
) -> bool:
    """Whether edges of two pairs come close."""
    for i in range(2):
        for j in range(2):
            if present[m, i] and present[other, j]:
                dx, dy = fits[m, i, 0] - fits[other, j, 0], fits[m, i, 1] - fits[other, j, 1]
                reach = extents[m, i] + extents[other, j] + APART * width
                if dx * dx + dy * dy < reach * reach:
                    return True
    return False


@njit()
def _side_by_side(
    optics: Any, present: NDArray[np.bool_], fits: Array, m: int, other: int
) -> np.float32:
    """Odds ratio of the edges of two pairs, for those two discs that overlap most."""
    deepest, shape = -1.0, np.empty((2, 2))
    for i in range(2):
        stretch(optics.shapes[i, m], fits[m, i], shape)
        r2 = abs(shape[0, 0] * shape[1, 1] - shape[0, 1] * shape[1, 0])
        for j in range(2):
            if present[m, i] and present[other, j]:
                stretch(optics.shapes[j, other], fits[other, j], shape)
                s2 = abs(shape[0, 0] * shape[1, 1] - shape[0, 1] * shape[1, 0])
                dx, dy = fits[m, i, 0] - fits[other, j, 0], fits[m, i, 1] - fits[other, j, 1]
                deepest = max(deepest, crossing(r2, s2, dx * dx + dy * dy))
    return np.float32(odds_ratio(math.acos(deepest)))


@njit()
def _cover_pair(
    optics: Any,
    present: NDArray[np.bool_],
    fits: Array,
    m: int,
    count: int,
    buffer: Array32,
) -> None:
    """Compute the coverage of pixels by the layers of a pair and by both."""
    shape, inverse, outlines = np.empty((2, 2)), np.empty((2, 2)), np.empty((2, 3, 2))
    for k in range(2):
        if not present[k]:
            clear(buffer, row_at(_PAIR + k), count)
            continue
        stretch(optics.shapes[k, m], fits[m, k], shape)
        for i in range(2):
            outlines[k, 0, i] = fits[m, k, i]
            for j in range(2):
                outlines[k, 1 + j, i] = shape[i, j]
        invert(shape, inverse)
        _cover(outlines[k, 0], inverse, optics.width, row_at(_PAIR + k), count, buffer)
    odds = np.float32(togetherness(outlines[0], outlines[1]) if present.all() else 1.0)
    c0, c1, both = row_at(_PAIR), row_at(_PAIR + 1), row_at(_PAIR + 2)
    for i in range(np.uint64(count)):
        buffer[both + i] = covered_by_both(buffer[c0 + i], buffer[c1 + i], odds)


@njit()
def _cover(
    centre: Array,
    inverse: Array,
    width: float,
    covered: np.uint64,
    count: int,
    buffer: Array32,
) -> None:
    """Write the coverage of a pair's pixels by another pair's marker to a row of the buffer."""
    cx, cy = np.float32(centre[0]), np.float32(centre[1])
    per_range, correction = np.float32(1.0 / (EDGE_RANGE * width)), np.float32(0.5 * width * width)
    i00, i01 = np.float32(inverse[0, 0]), np.float32(inverse[0, 1])
    i10, i11 = np.float32(inverse[1, 0]), np.float32(inverse[1, 1])
    at_x, at_y = row_at(X), row_at(Y)
    for i in range(np.uint64(count)):
        dx, dy = buffer[at_x + i] - cx, buffer[at_y + i] - cy
        qx, qy = i00 * dx + i01 * dy, i10 * dx + i11 * dy
        radius = np.sqrt(qx * qx + qy * qy + TINY)
        gx, gy = (i00 * qx + i10 * qy) / radius, (i01 * qx + i11 * qy) / radius
        slope = np.sqrt(gx * gx + gy * gy + TINY)
        buffer[covered + i] = edge(((F1 - radius) / slope - correction * slope) * per_range)


@njit()
def _darken(
    row: np.uint64, a0: np.float32, a1: np.float32, b: np.float32, count: int, buffer: Array32
) -> None:
    """Darken a row of ground light by the absorption of a pair that lies apart."""
    c0, c1, both = row_at(_PAIR), row_at(_PAIR + 1), row_at(_PAIR + 2)
    for i in range(np.uint64(count)):
        first, second, pair = buffer[c0 + i], buffer[c1 + i], buffer[both + i]
        buffer[row + i] *= F1 - a0 * first - a1 * second + b * pair


@njit()
def _add(
    optics: Any,
    present: NDArray[np.bool_],
    fits: Array,
    m: int,
    first: bool,
    count: int,
    buffer: Array32,
) -> None:
    """Add coverage and absorption of another pair to the sums over all others."""
    absorbed, partner, odds = optics.absorbed, -1, F1
    for i in range(np.uint64(count)):
        c0, c1 = buffer[row_at(_PAIR) + i], buffer[row_at(_PAIR + 1) + i]
        both = buffer[row_at(_PAIR + 2) + i]
        cover, before = c0 + c1 - both, buffer[row_at(_OTHERS) + i]
        share = F1
        if cover * before > _LITTLE:
            most = int(buffer[row_at(_MOST) + i])
            if most != partner:
                partner, odds = most, _side_by_side(optics, present, fits, m, most)
            share = covered_by_both(before, cover, odds) / (before * cover)
        if first or cover > before:
            buffer[row_at(_MOST) + i] = m
        buffer[row_at(_OTHERS) + i] = before + cover - share * before * cover
        for c in range(3):
            dark = absorbed[0, c] * c0 + absorbed[1, c] * c1 - absorbed[2, c] * both
            old = buffer[row_at(_OTHERS + 1 + c) + i]
            buffer[row_at(_OTHERS + 1 + c) + i] = old + dark - share * old * dark


@njit()
def _to_odds(
    optics: Any,
    present: NDArray[np.bool_],
    fits: Array,
    m: int,
    count: int,
    buffer: Array32,
) -> None:
    """Compute the odds ratio between a pair's edges and those of the main coverer of each pixel."""
    partner, odds = -1, F1
    for i in range(np.uint64(count)):
        most = int(buffer[row_at(_MOST) + i])
        if most != partner:
            partner, odds = most, _side_by_side(optics, present, fits, m, most)
        buffer[row_at(_MOST) + i] = odds


@njit()
def _split(
    channel: int, a0: np.float32, a1: np.float32, b: np.float32, count: int, buffer: Array32
) -> None:
    """Split the ground's light into a part that this pair may absorb, and the rest.

    The light that passes pairs next to each other, see `beside`, is linearised at the pair's
    present coverage.
    """
    c0, c1, both = row_at(_PAIR), row_at(_PAIR + 1), row_at(_PAIR + 2)
    cover, taken, odds = row_at(_OTHERS), row_at(_OTHERS + 1 + channel), row_at(_MOST)
    ground, rest = row_at(GROUND + channel), row_at(BESIDE + channel)
    for i in range(np.uint64(count)):
        first, second, pair = buffer[c0 + i], buffer[c1 + i], buffer[both + i]
        own, other = max(first + second - pair, _LITTLE), max(buffer[cover + i], _LITTLE)
        now, dark = a0 * first + a1 * second - b * pair, buffer[taken + i]
        under = dark / other  # light absorbed by the others, over their coverage
        slope = under * covered_slope(own, other, buffer[odds + i])
        shared = under * covered_by_both(own, other, buffer[odds + i]) / own
        light = buffer[ground + i]
        buffer[rest + i] = light * (slope - dark + now * (shared - slope))
        buffer[ground + i] = light * (F1 - slope)
