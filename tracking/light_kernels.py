"""Compiled products of a pair's pixels, and the light on it. `pair_fit.py` documents the use.

Light is a gain for each channel and, where it is uneven, terms up to second order, shared by all
channels. It is solved for first, whatever the markers are, and what is left tells of them.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.compiled import njit
from ..render.coverage import (
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
    ALL_LIGHT,
    BESIDE,
    BOTH,
    CHANGE,
    COVERED,
    F0,
    F1,
    FEWEST_PIXELS,
    GAIN,
    GROUND,
    LACK,
    LIGHT,
    MODEL,
    ROOM,
    SEEN,
    SHARED,
    TERM,
    TERMS,
    TINY,
    UNIT,
    WEIGHT,
    Array,
    Array32,
    X,
    Y,
    clear,
    extents_of,
    gather,
    invert,
    middle_of,
    model_pixels,
    row_at,
    stretch,
)

#: Gains of three channels, and uneven light.
LIGHTS = 3 + TERMS
#: Shade further than this many standard deviations outside an edge is not seen.
_SHADE = 2.4
#: Coverages this far from 0 and 1 are edges.
_EDGE = 0.03
_LITTLE = np.float32(1e-6)
#: Rows that uneven light needs later: coverages of a pair; how much all other pairs cover, and
#: absorb of each channel; which of them covers most, or how its edges and the pair's go together.
_PAIR, _OTHERS, _MOST = TERM, TERM + 3, TERM + 7


@njit(reassociate=True)
def dot(buffer: Array32, first: int, second: int, count: int) -> float:
    """Product of two rows of the buffer."""
    total, a, b = F0, row_at(first), row_at(second)
    for i in range(np.uint64(count)):
        total += buffer[a + i] * buffer[b + i]
    return np.float64(total)


@njit(reassociate=True)
def weighted_dot(buffer: Array32, weight: int, first: int, second: int, count: int) -> float:
    """Weighted product of two rows of the buffer."""
    total, w, a, b = F0, row_at(weight), row_at(first), row_at(second)
    for i in range(np.uint64(count)):
        total += buffer[w + i] * buffer[a + i] * buffer[b + i]
    return np.float64(total)


@njit()
def uneven_light(
    fit: Array, count: int, free: int, lights: Array, says: Array, cross: Array, buffer: Array32
) -> None:
    """Information on the terms of uneven light, beside that on the gains."""
    mx, my = middle_of(fit)
    for i in range(np.uint64(count)):
        dx, dy = buffer[row_at(X) + i] - mx, buffer[row_at(Y) + i] - my
        buffer[row_at(TERM) + i], buffer[row_at(TERM + 1) + i] = dx, dy
        buffer[row_at(TERM + 2) + i] = UNIT * dx * dx
        buffer[row_at(TERM + 3) + i] = UNIT * dx * dy
        buffer[row_at(TERM + 4) + i] = UNIT * dy * dy
        whole, lack = F0, F0
        for c in range(3):
            weighted = buffer[row_at(WEIGHT + c) + i] * buffer[row_at(MODEL + c) + i]
            part = weighted * buffer[row_at(MODEL + c) + i]
            buffer[row_at(LIGHT + c) + i] = part
            whole += part
            lack += weighted * (buffer[row_at(SEEN + c) + i] - buffer[row_at(MODEL + c) + i])
        buffer[row_at(ALL_LIGHT) + i], buffer[row_at(LACK) + i] = whole, lack
        for k in range(2):
            first = GAIN + 3 * k
            buffer[row_at(SHARED + k) + i] = (
                buffer[row_at(first) + i]
                + buffer[row_at(first + 1) + i]
                + buffer[row_at(first + 2) + i]
            )
    for j in range(TERMS):
        term = TERM + j
        says[3 + j] = dot(buffer, term, LACK, count)
        for c in range(3):
            lights[c, 3 + j] = lights[3 + j, c] = dot(buffer, term, LIGHT + c, count)
        for i in range(TERMS):
            lights[3 + j, 3 + i] = weighted_dot(buffer, ALL_LIGHT, term, TERM + i, count)
        for i in range(free):
            for k in range(2):
                cross[3 + j, place_of(k, i, free)] = weighted_dot(
                    buffer, SHARED + k, term, CHANGE + 5 * k + i, count
                )


@njit()
def solve_light(
    lights: Array, says: Array, cross: Array, terms: int, normal: Array, gradient: Array
) -> bool:
    """Solve for the light, whatever the markers are; what is left is on them.

    `lights`, `says` and `cross` become the factor L of the information on light and what is left
    when they are divided by it.
    """
    size = gradient.shape[0]
    for i in range(terms):
        for j in range(i + 1):
            total = lights[i, j]
            for k in range(j):
                total -= lights[i, k] * lights[j, k]
            if i > j:
                lights[i, j] = total / lights[j, j]
            elif total > 1e-9 * lights[i, i] and lights[i, i] > 0.0:
                lights[i, i] = math.sqrt(total)
            else:
                return False
    for i in range(terms):
        for k in range(i):
            factor = lights[i, k]
            if factor != 0.0:
                says[i] -= factor * says[k]
                for j in range(size):
                    cross[i, j] -= factor * cross[k, j]
        says[i] /= lights[i, i]
        for j in range(size):
            cross[i, j] /= lights[i, i]
        for j in range(size):
            gradient[j] -= cross[i, j] * says[i]
            for k in range(size):
                normal[j, k] -= cross[i, j] * cross[i, k]
    return True


@njit()
def light_step(
    lights: Array, says: Array, cross: Array, change: Array, terms: int, out: Array
) -> None:
    """What the light changes by when the markers change so."""
    for i in range(terms - 1, -1, -1):
        total = says[i]
        for j in range(change.shape[0]):
            total -= cross[i, j] * change[j]
        for k in range(i + 1, terms):
            total -= lights[k, i] * out[k]
        out[i] = total / lights[i, i]


@njit()
def share_light(lights: Array, cross: Array, factor: Array, covariance: Array) -> None:
    """Covariance of the gains' logarithms with (x, y, e) of both layers, and of their own.

    Parameters
    ----------
    lights, cross: as `solve_light` left them, of even light
    factor: Cholesky's, of the information on all five numbers of both layers
    covariance: result, shape (9, 9), the gains' last
    """
    size = factor.shape[0]
    first = place_of(0, 0, 5)
    answers = np.empty((3, size))
    for i in range(size):
        # How the markers answer to the light of each channel, by forward substitution …
        whole = 1.0 / factor[i, i]
        for c in range(3):
            total = cross[c, i] / lights[c, c]
            for k in range(i):
                total -= factor[i, k] * answers[c, k]
            answers[c, i] = total * whole
    for c in range(3):
        for d in range(c + 1):
            total = 1.0 / lights[c, c] ** 2 if c == d else 0.0
            for i in range(size):
                total += answers[c, i] * answers[d, i]
            covariance[6 + c, 6 + d] = covariance[6 + d, 6 + c] = total
    for i in range(size - 1, first - 1, -1):
        # … and back, as far as places and sizes, which stand last.
        whole = 1.0 / factor[i, i]
        for c in range(3):
            total = answers[c, i]
            for k in range(i + 1, size):
                total -= factor[k, i] * answers[c, k]
            answers[c, i] = total * whole
            covariance[6 + c, i - first] = covariance[i - first, 6 + c] = -answers[c, i]


@njit(inline="always")
def place_of(layer: int, number: int, free: int) -> int:
    """Where a number of a layer stands among the unknowns.

    Strains first: so the covariance of all others is the inverse of one corner of the factor.
    """
    if free == 2:
        return 2 * layer + number
    return 2 * layer + number - 3 if number > 2 else 4 + 3 * layer + number


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
    """Take from a pair's light what the markers of other pairs absorb that reach into its box.

    Neighbours lie beside the pair, see `render.coverage.beside`: the ground is darker where they
    lie on it, and elsewhere leaves less light, whatever the pair covers. That holds where the pair
    is, and not where it may be far from; unless `beside`, pairs darken each other by chance.
    """
    for c in range(3):
        clear(buffer, row_at(BESIDE + c), count)
    near, there = np.empty(2, dtype=np.bool_), present.copy()
    meeting, found = np.empty(len(optics.neighbours[m]), dtype=np.int64), 0
    for other in optics.neighbours[m]:
        if other < 0:
            continue
        for k in range(2):
            x, y = fits[other, k, 0], fits[other, k, 1]
            reach = _SHADE * optics.width + extents[other, k]
            dx = max(box[0] - x, 0.0, x - box[1])
            dy = max(box[2] - y, 0.0, y - box[3])
            near[k] = present[other, k] and dx * dx + dy * dy < reach * reach
        if not near.any():
            continue
        there[other] = near
        if beside and _meet(optics.width, there, fits, extents, m, other):
            meeting[found] = other
            found += 1
            continue
        _cover_pair(optics, near, fits, other, count, buffer)
        for c in range(3):
            a = optics.absorbed[:, c]
            _darken(row_at(GROUND + c), a[0], a[1], a[2], count, buffer)
    if found == 0:
        return
    for row in range(_OTHERS, _MOST):
        clear(buffer, row_at(row), count)
    for other in meeting[:found]:
        _cover_pair(optics, there[other], fits, other, count, buffer)
        _add(optics, there, fits, other, other == meeting[0], count, buffer)
    _cover_pair(optics, present[m], fits, m, count, buffer)
    _to_odds(optics, there, fits, m, meeting[0], count, buffer)
    for c in range(3):
        a = optics.absorbed[:, c]
        _split(c, a[0], a[1], a[2], count, buffer)


@njit()
def _meet(
    width: float, there: NDArray[np.bool_], fits: Array, extents: Array, m: int, other: int
) -> bool:
    """Whether edges of two pairs come close."""
    for i in range(2):
        for j in range(2):
            if there[m, i] and there[other, j]:
                dx, dy = fits[m, i, 0] - fits[other, j, 0], fits[m, i, 1] - fits[other, j, 1]
                reach = extents[m, i] + extents[other, j] + APART * width
                if dx * dx + dy * dy < reach * reach:
                    return True
    return False


@njit()
def _side_by_side(
    optics: Any, there: NDArray[np.bool_], fits: Array, m: int, other: int
) -> np.float32:
    """How much the edges of two pairs go together, where their discs are deepest in each other."""
    deepest, shape = -1.0, np.empty((2, 2))
    for i in range(2):
        stretch(optics.shapes[i, m], fits[m, i], shape)
        r2 = abs(shape[0, 0] * shape[1, 1] - shape[0, 1] * shape[1, 0])
        for j in range(2):
            if there[m, i] and there[other, j]:
                stretch(optics.shapes[j, other], fits[other, j], shape)
                s2 = abs(shape[0, 0] * shape[1, 1] - shape[0, 1] * shape[1, 0])
                dx, dy = fits[m, i, 0] - fits[other, j, 0], fits[m, i, 1] - fits[other, j, 1]
                deepest = max(deepest, crossing(r2, s2, dx * dx + dy * dy))
    return np.float32(odds_ratio(math.acos(deepest)))


@njit()
def _cover_pair(
    optics: Any,
    there: NDArray[np.bool_],
    fits: Array,
    m: int,
    count: int,
    buffer: Array32,
) -> None:
    """Coverage of pixels by the layers of a pair and by both."""
    inverse, outlines = np.empty((2, 2)), np.empty((2, 3, 2))
    for k in range(2):
        if not there[k]:
            clear(buffer, row_at(_PAIR + k), count)
            continue
        stretch(optics.shapes[k, m], fits[m, k], inverse)
        outlines[k, 0], outlines[k, 1:] = fits[m, k, :2], inverse.T
        invert(outlines[k, 1:].T, inverse)
        _cover(outlines[k, 0], inverse, optics.width, row_at(_PAIR + k), count, buffer)
    odds = np.float32(togetherness(outlines[0], outlines[1]) if there.all() else 1.0)
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
    """Coverage of a pair's pixels by another marker, to a row of the buffer."""
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
    """Take away what the dyes of a pair absorb that does not meet this one."""
    c0, c1, both = row_at(_PAIR), row_at(_PAIR + 1), row_at(_PAIR + 2)
    for i in range(np.uint64(count)):
        first, second, pair = buffer[c0 + i], buffer[c1 + i], buffer[both + i]
        buffer[row + i] *= F1 - a0 * first - a1 * second + b * pair


@njit()
def _add(
    optics: Any,
    there: NDArray[np.bool_],
    fits: Array,
    m: int,
    first: bool,
    count: int,
    buffer: Array32,
) -> None:
    """Add a pair, whose coverages are there, to the others."""
    absorbed, partner, odds = optics.absorbed, -1, F1
    for i in range(np.uint64(count)):
        c0, c1 = buffer[row_at(_PAIR) + i], buffer[row_at(_PAIR + 1) + i]
        both = buffer[row_at(_PAIR + 2) + i]
        cover, before = c0 + c1 - both, buffer[row_at(_OTHERS) + i]
        share = F1
        if cover * before > _LITTLE:
            most = int(buffer[row_at(_MOST) + i])
            if most != partner:
                partner, odds = most, _side_by_side(optics, there, fits, m, most)
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
    there: NDArray[np.bool_],
    fits: Array,
    m: int,
    other: int,
    count: int,
    buffer: Array32,
) -> None:
    """How the edges of a pair go together with those of the one that covers most of a pixel."""
    partner, odds = other, _side_by_side(optics, there, fits, m, other)
    for i in range(np.uint64(count)):
        most = int(buffer[row_at(_MOST) + i])
        if most != partner:
            partner, odds = most, _side_by_side(optics, there, fits, m, most)
        buffer[row_at(_MOST) + i] = odds


@njit()
def _split(
    channel: int, a0: np.float32, a1: np.float32, b: np.float32, count: int, buffer: Array32
) -> None:
    """Split the ground's light: what this pair may still absorb, and what it may not.

    Of the light that pairs leave beside each other, see `beside`, the part that changes with what
    this one absorbs, and the rest at what it absorbs now.
    """
    c0, c1, both = row_at(_PAIR), row_at(_PAIR + 1), row_at(_PAIR + 2)
    cover, taken, odds = row_at(_OTHERS), row_at(_OTHERS + 1 + channel), row_at(_MOST)
    ground, rest = row_at(GROUND + channel), row_at(BESIDE + channel)
    for i in range(np.uint64(count)):
        first, second, pair = buffer[c0 + i], buffer[c1 + i], buffer[both + i]
        here, there = max(first + second - pair, _LITTLE), max(buffer[cover + i], _LITTLE)
        now, dark = a0 * first + a1 * second - b * pair, buffer[taken + i]
        under = dark / there  # what the others absorb of what is under them
        slope = under * covered_slope(here, there, buffer[odds + i])
        shared = under * covered_by_both(here, there, buffer[odds + i]) / here
        light = buffer[ground + i]
        buffer[rest + i] = light * (slope - dark + now * (shared - slope))
        buffer[ground + i] = light * (F1 - slope)


@njit()
def light_sums(
    image: NDArray[np.uint8],
    optics: Any,
    present: NDArray[np.bool_],
    stride: int,
    fits: Array,
    gains: Array,
    slopes: Array,
    sums: Array,
    buffer: Array32,
) -> None:
    """Weighted products of (1, C₀, C₁, C₀₁, light seen over ground) of each pair and channel.

    `sums` receives them, shape (M, 3, 5, 5); the rest is as in `fit_step`.
    """
    shapes, inverses = np.empty((2, 2, 2)), np.empty((2, 2, 2))
    outlines, box = np.empty((2, 3, 2)), np.empty(4)
    lights, says = np.zeros((LIGHTS, LIGHTS)), np.zeros(LIGHTS)
    values, extents = np.empty(5), extents_of(optics, fits)
    for m in range(fits.shape[0]):
        for k in range(2):
            stretch(optics.shapes[k, m], fits[m, k], shapes[k])
            invert(shapes[k], inverses[k])
            outlines[k, 0] = fits[m, k, :2]
            outlines[k, 1:] = shapes[k].T
        count = gather(
            image, optics, present[m], fits[m], gains[m], slopes[m], shapes, inverses, stride,
            box, buffer,
        )  # fmt: skip
        sums[m] = 0.0
        if count < FEWEST_PIXELS:
            continue
        shade(optics, present, fits, extents, m, False, box, count, buffer)
        t = togetherness(outlines[0], outlines[1]) if present[m].all() else 1.0
        model_pixels(optics, present[m], fits[m], inverses, t, 2, count, lights, says, buffer)
        for i in range(count):
            first, second = buffer[COVERED * ROOM + i], buffer[(COVERED + 1) * ROOM + i]
            # Edges tell less of colours than of tone curves, blur, and where markers are.
            if _EDGE < first < 1.0 - _EDGE or _EDGE < second < 1.0 - _EDGE:
                continue
            values[0], values[1], values[2] = 1.0, first, second
            values[3] = buffer[BOTH * ROOM + i]
            for c in range(3):
                light = buffer[(GROUND + c) * ROOM + i]
                values[4] = buffer[(SEEN + c) * ROOM + i] / light
                weight = buffer[(WEIGHT + c) * ROOM + i] * light * light
                for a in range(5):
                    for b in range(5):
                        sums[m, c, a, b] += weight * values[a] * values[b]
