"""Compiled fit of pairs of overlapping markers to the image. `pair_fit.py` documents the use.

Model of a pixel, in linear light: γ · ground · (1 − a₀·C₀ − a₁·C₁ + b·C₀₁), γ being the local gain,
a what a dye absorbs, b what both together leave over, C the coverage of a blurred ellipse of known
shape and C₀₁ that of both. Markers of other pairs that reach into the window darken the ground by
where they were last seen. Free, for both layers: centre (x, y), logarithmic size e and the strain
(p, q) that turns the shape S into eᵉ·[[1+p, q], [q, 1−p]]·S; and γ of each channel.

The pixels of a pair are gathered into rows of one flat buffer whose distances the compiler knows:
so the model is computed many pixels at a time, and what it takes to solve it are products of rows.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..model.compiled import njit
from ..render.coverage import EDGE_RANGE, edge, edge_slope, togetherness

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

#: Markers do not shrink, grow or stretch by more than this.
MAX_STRAIN = 0.5
#: Fewer pixels do not determine a pair.
_FEWEST_PIXELS = 24
#: A pair moves no further than this in one step [px], and strains no more.
_LONGEST_STEP, _LONGEST_STRAIN = 2.0, 0.1
#: Pixels of a pair, at most; more are thinned out. Not a power of two: rows must not share cache.
ROOM = 2256
#: Pixels that a processor takes at a time, with what it has in flight.
_AT_ONCE = 32
#: Rows of the buffer: place, light seen, its weight, ground, of each pixel …
_X, _Y, _SEEN, _WEIGHT, _GROUND = 0, 1, 2, 5, 8
#: … coverage of both layers, and how it changes with their five numbers each …
_COVERED, _CHANGE = 11, 13
#: … what the light tells of the first layer's coverage, the second's, of both together; what the
#: residuals say of each; what they share with the gain of each channel; and the model …
_TELLS, _PULL, _GAIN, _MODEL = 23, 26, 28, 34
#: … where the light is uneven: its terms, and what the model tells of light, of each channel, of
#: all, what the residuals say, and what it shares with both layers.
_TERM, _LIGHT, _ALL_LIGHT, _LACK, _SHARED = 37, 42, 45, 46, 47
BUFFER = 49 * ROOM
#: Terms of uneven light: x, y, x², xy, y²; second powers in units of so many pixels.
TERMS, _UNIT = 5, np.float32(1.0 / 16.0)
#: Gains of three channels, and uneven light.
_LIGHTS = 3 + TERMS

#: Shade further than this many standard deviations outside an edge is not seen.
_SHADE = 2.4
#: A light that is off by a hundredth counts as much as a step of so many hundredth pixels.
_LIGHT_STEP = 8.0
#: Coverages this far from 0 and 1 are edges.
_EDGE = 0.03

_F0, _F1, _HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
_TINY = np.float32(1e-12)


class Optics(NamedTuple):
    """What the pixels of one sensor are made of."""

    linear: Array32  # (3, 256) linear light of each channel's levels
    weight: Array32  # (3, 256) 1/variance of that light
    ground: Array32  # (H, W, 3) linear light of the unmarked skin; 0 where there is none
    absorbed: Array32  # (3, 3) a₀, a₁ and b of each channel
    shapes: Array  # (2, M, 2, 2) semi-axes of each marker at nominal size, as columns [px]
    neighbours: NDArray[np.int64]  # (M, K) pairs near each pair, −1 for none
    width: float  # standard deviation of an edge [px]
    reach: float  # pixels further than this many of those outside an edge are not read


@njit()
def fit_step(
    image: NDArray[np.uint8],
    optics: Any,
    active: NDArray[np.bool_],
    present: NDArray[np.bool_],
    uneven: NDArray[np.bool_],
    free: int,
    stride: int,
    fits: Array,
    gains: Array,
    slopes: Array,
    steps: Array,
    covariance: Array,
    misfit: Array,
    buffer: Array32,
) -> None:
    """One Gauss–Newton step on every active pair, in place.

    Parameters
    ----------
    image: sRGB, shape (H, W, 3)
    optics: see Optics
    active: pairs to step, shape (M,)
    present: layers that are taken to be there, shape (M, 2)
    uneven: pairs whose light is fitted to second order, else its slopes are as given, shape (M,)
    free: numbers of each layer that are free, 5 or the first 2
    stride: every so manieth row of the image is read
    fits: (x, y, e, p, q) of each layer, shape (M, 2, 5)
    gains: light over the ground's, of each channel, shape (M, 3)
    slopes: terms of the light on a pair relative to its gain, see TERMS, shape (M, 5)
    steps: result, how far the step moved an edge [px], or light as much, shape (M,)
    covariance: result, of (x, y, e) of both layers before the step, shape (M, 6, 6)
    misfit: result, mean squared residual over noise variance before the step, shape (M,); infinite
        where the fit left the image or ran away
    buffer: room to work in, shape (BUFFER,)
    """
    shapes, inverses = np.empty((2, 2, 2)), np.empty((2, 2, 2))
    outlines = np.empty((2, 3, 2))
    size = 2 * free
    normal, gradient, change = np.empty((size, size)), np.empty(size), np.empty(size)
    cross, box = np.zeros((_LIGHTS, size)), np.empty(4)
    lights, says, brighter = np.zeros((_LIGHTS, _LIGHTS)), np.zeros(_LIGHTS), np.zeros(_LIGHTS)
    extents = _extents(optics, fits)
    for m in range(fits.shape[0]):
        if not active[m]:
            continue
        misfit[m], steps[m] = np.inf, 0.0
        if not (present[m, 0] or present[m, 1]):
            continue
        for k in range(2):
            _stretch(optics.shapes[k, m], fits[m, k], shapes[k])
            _invert(shapes[k], inverses[k])
            outlines[k, 0] = fits[m, k, :2]
            outlines[k, 1:] = shapes[k].T
        count = _gather(
            image, optics, present[m], fits[m], gains[m], slopes[m], shapes, inverses, stride,
            box, buffer,
        )  # fmt: skip
        if count < _FEWEST_PIXELS:
            continue
        padded = _pad(count, buffer)
        _shade(optics, present, fits, extents, m, box, padded, buffer)
        together = togetherness(outlines[0], outlines[1]) if present[m].all() else 0.0
        squares = _model(
            optics, present[m], fits[m], inverses, together, free, padded, lights, says, buffer
        )
        misfit[m] = squares / max(3 * count - size - 3, 1)
        _normal_equations(padded, free, buffer, normal, gradient, cross)
        terms = 3
        if uneven[m]:
            terms = _LIGHTS
            _uneven_light(fits[m], padded, free, lights, says, cross, buffer)
        if not _solve_light(lights, says, cross, terms, normal, gradient):
            misfit[m] = np.inf
            continue
        if not _solve(normal, gradient, change, covariance[m]):
            misfit[m] = np.inf
            continue
        steps[m] = _improve(fits[m], shapes, present[m], change, free)
        _light_step(lights, says, cross, change, terms, brighter)
        for c in range(3):
            gains[m, c] *= math.exp(min(max(brighter[c], -0.7), 0.7))
            steps[m] = max(steps[m], _LIGHT_STEP * abs(brighter[c]))
        for j in range(terms - 3):
            slopes[m, j] += brighter[3 + j]
        if not _plausible(fits[m]):
            misfit[m] = np.inf


@njit()
def _gather(
    image: NDArray[np.uint8],
    optics: Any,
    present: NDArray[np.bool_],
    fit: Array,
    gain: Array,
    slope: Array,
    shapes: Array,
    inverses: Array,
    stride: int,
    box: Array,
    buffer: Array32,
) -> int:
    """Pixels that a pair's markers reach, as rows of the buffer; returns how many.

    Their ground is under today's light. `box` receives (left, right, top, bottom) of them.
    """
    height, breadth = image.shape[0], image.shape[1]
    reach = optics.reach * optics.width
    top, bottom = 1e9, -1e9
    wide = np.empty(2)
    pixels = 0.0
    for k in range(2):
        s = shapes[k]
        radius = math.sqrt(abs(s[0, 0] * s[1, 1] - s[0, 1] * s[1, 0]))
        wide[k] = 1.0 + reach / radius
        if present[k]:
            half = wide[k] * math.sqrt(s[1, 0] ** 2 + s[1, 1] ** 2)
            top, bottom = min(top, fit[k, 1] - half), max(bottom, fit[k, 1] + half)
            pixels += math.pi * (radius + reach) ** 2
    while pixels > 0.9 * ROOM * stride:
        stride += 1
    count = 0
    box[0], box[1], box[2], box[3] = breadth, 0.0, top, bottom
    if not (bottom > top and bottom > 0.0 and top < height):
        return 0
    g0, g1, g2 = np.float32(gain[0]), np.float32(gain[1]), np.float32(gain[2])
    along_x, along_y = np.float32(slope[0]), np.float32(slope[1])
    xx, xy, yy = np.float32(slope[2]), np.float32(slope[3]), np.float32(slope[4])
    middle_x, middle_y = _middle(fit)
    linear, weight, ground = optics.linear, optics.weight, optics.ground
    first = int(max(top, 0.0)) + 1
    for row in range(first - first % stride, min(int(bottom), height - 1) + 1, stride):
        left, right = 1e9, -1e9
        for k in range(2):
            if not present[k]:
                continue
            # Where the row cuts the widened ellipse |S⁻¹·d| = wide.
            a, b = inverses[k, 0], inverses[k, 1]
            dy = row - fit[k, 1]
            square = a[0] * a[0] + b[0] * b[0]
            mixed = (a[0] * a[1] + b[0] * b[1]) * dy
            root = mixed**2 - square * ((a[1] * a[1] + b[1] * b[1]) * dy * dy - wide[k] ** 2)
            if root > 0.0:
                half = math.sqrt(root) / square
                left = min(left, fit[k, 0] - mixed / square - half)
                right = max(right, fit[k, 0] - mixed / square + half)
        box[0], box[1] = min(box[0], left), max(box[1], right)
        start = int(max(left, 0.0)) + 1
        # Floats that count along: conversions of counters would take most of the time.
        x, y = np.float32(start), np.float32(row)
        dy32 = y - middle_y
        for col in range(start, int(min(right, breadth - 1.0)) + 1):
            if ground[row, col, 0] > _F0 and count < ROOM - _AT_ONCE:
                at, dx32 = np.uint64(count), x - middle_x
                light = _F1 + dx32 * (along_x + _UNIT * (xx * dx32 + xy * dy32))
                light += dy32 * (along_y + _UNIT * yy * dy32)
                buffer[_row(_X) + at] = x
                buffer[_row(_Y) + at] = y
                level = image[row, col, 0]
                buffer[_row(_SEEN) + at] = linear[0, level]
                buffer[_row(_WEIGHT) + at] = weight[0, level]
                buffer[_row(_GROUND) + at] = g0 * light * ground[row, col, 0]
                level = image[row, col, 1]
                buffer[_row(_SEEN + 1) + at] = linear[1, level]
                buffer[_row(_WEIGHT + 1) + at] = weight[1, level]
                buffer[_row(_GROUND + 1) + at] = g1 * light * ground[row, col, 1]
                level = image[row, col, 2]
                buffer[_row(_SEEN + 2) + at] = linear[2, level]
                buffer[_row(_WEIGHT + 2) + at] = weight[2, level]
                buffer[_row(_GROUND + 2) + at] = g2 * light * ground[row, col, 2]
                count += 1
            x += _F1
    return count


@njit()
def _pad(count: int, buffer: Array32) -> int:
    """Pixels without weight behind the last, to be done many at a time; returns their end."""
    end = (count + _AT_ONCE - 1) // _AT_ONCE * _AT_ONCE
    for row in range(_GROUND + 3):
        first = _row(row)
        same = buffer[first + np.uint64(count - 1)] if row < _SEEN else _F0
        for i in range(np.uint64(count), np.uint64(end)):
            buffer[first + i] = same
    return end


@njit(inline="always")
def _middle(fit: Array) -> tuple[np.float32, np.float32]:
    """Where the light on a pair is its gain."""
    return np.float32(0.5 * (fit[0, 0] + fit[1, 0])), np.float32(0.5 * (fit[0, 1] + fit[1, 1]))


@njit()
def _extents(optics: Any, fits: Array) -> Array:
    """Largest distance of each marker's edge from its centre [px], about, shape (M, 2)."""
    extents, shape = np.empty((fits.shape[0], 2)), np.empty((2, 2))
    for m in range(fits.shape[0]):
        for k in range(2):
            _stretch(optics.shapes[k, m], fits[m, k], shape)
            extents[m, k] = max(
                math.hypot(shape[0, 0], shape[1, 0]), math.hypot(shape[0, 1], shape[1, 1])
            )
    return extents


@njit()
def _shade(
    optics: Any,
    present: NDArray[np.bool_],
    fits: Array,
    extents: Array,
    m: int,
    box: Array,
    count: int,
    buffer: Array32,
) -> None:
    """Darken a pair's ground by the markers of other pairs that reach into its box."""
    shape, inverse = np.empty((2, 2)), np.empty((2, 2))
    width = optics.width
    for other in optics.neighbours[m]:
        if other < 0:
            continue
        for k in range(2):
            if not present[other, k]:
                continue
            x, y = fits[other, k, 0], fits[other, k, 1]
            reach = _SHADE * width + extents[other, k]
            dx = max(box[0] - x, 0.0, x - box[1])
            dy = max(box[2] - y, 0.0, y - box[3])
            if dx * dx + dy * dy > reach * reach:
                continue
            _stretch(optics.shapes[k, other], fits[other, k], shape)
            _invert(shape, inverse)
            _cover(x, y, inverse, width, count, buffer)
            for c in range(3):
                _darken(_row(_GROUND + c), optics.absorbed[k, c], count, buffer)


@njit()
def _cover(x: float, y: float, inverse: Array, width: float, count: int, buffer: Array32) -> None:
    """Coverage of a pair's pixels by another marker, to the first row of the terms."""
    cx, cy, per_range = np.float32(x), np.float32(y), np.float32(1.0 / (EDGE_RANGE * width))
    correction = np.float32(0.5 * width * width)
    i00, i01 = np.float32(inverse[0, 0]), np.float32(inverse[0, 1])
    i10, i11 = np.float32(inverse[1, 0]), np.float32(inverse[1, 1])
    at_x, at_y, covered = _row(_X), _row(_Y), _row(_TERM)
    for i in range(np.uint64(count)):
        dx, dy = buffer[at_x + i] - cx, buffer[at_y + i] - cy
        qx, qy = i00 * dx + i01 * dy, i10 * dx + i11 * dy
        radius = np.sqrt(qx * qx + qy * qy + _TINY)
        gx, gy = (i00 * qx + i10 * qy) / radius, (i01 * qx + i11 * qy) / radius
        slope = np.sqrt(gx * gx + gy * gy + _TINY)
        buffer[covered + i] = edge(((_F1 - radius) / slope - correction * slope) * per_range)


@njit()
def _darken(row: np.uint64, absorbed: np.float32, count: int, buffer: Array32) -> None:
    covered = _row(_TERM)
    for i in range(np.uint64(count)):
        buffer[row + i] *= _F1 - absorbed * buffer[covered + i]


@njit(inline="always")
def _row(number: int) -> np.uint64:
    """First place of a row. Unsigned: what may be negative is gathered one by one."""
    return np.uint64(number * ROOM)


@njit(reassociate=True)
def _model(
    optics: Any,
    present: NDArray[np.bool_],
    fit: Array,
    inverses: Array,
    together: float,
    free: int,
    count: int,
    lights: Array,
    says: Array,
    buffer: Array32,
) -> float:
    """The model's rows of the buffer; returns the sum of squared residuals over noise variance.

    The diagonal of `lights` receives the information on each channel's gain, `says` what the
    residuals say of it.
    """
    per_range = np.float32(1.0 / (EDGE_RANGE * optics.width))
    correction = np.float32(0.5 * optics.width * optics.width)
    for k in range(2):
        there = np.float32(1.0 if present[k] else 0.0)
        cx, cy = np.float32(fit[k, 0]), np.float32(fit[k, 1])
        i00, i01 = np.float32(inverses[k, 0, 0]), np.float32(inverses[k, 0, 1])
        i10, i11 = np.float32(inverses[k, 1, 0]), np.float32(inverses[k, 1, 1])
        covered, x, y = _row(_COVERED + k), _row(_X), _row(_Y)
        j0, j1, j2 = (_row(_CHANGE + 5 * k), _row(_CHANGE + 5 * k + 1), _row(_CHANGE + 5 * k + 2))
        j3, j4 = _row(_CHANGE + 5 * k + 3), _row(_CHANGE + 5 * k + 4)
        for i in range(np.uint64(count)):
            # Distance to the edge, positive inside, to first order; coverage and its rise.
            dx, dy = buffer[x + i] - cx, buffer[y + i] - cy
            qx, qy = i00 * dx + i01 * dy, i10 * dx + i11 * dy
            radius = np.sqrt(qx * qx + qy * qy + _TINY)
            to_radius = _F1 / radius
            gx, gy = (i00 * qx + i10 * qy) * to_radius, (i01 * qx + i11 * qy) * to_radius
            slope = np.sqrt(gx * gx + gy * gy + _TINY)
            to_slope = _F1 / slope
            u = ((_F1 - radius) * to_slope - correction * slope) * per_range
            buffer[covered + i] = there * edge(u)
            rise = there * edge_slope(u) * per_range * to_slope
            nx, ny = rise * gx, rise * gy
            buffer[j0 + i] = nx
            buffer[j1 + i] = ny
        if free == 2:
            continue
        for i in range(np.uint64(count)):
            dx, dy = buffer[x + i] - cx, buffer[y + i] - cy
            nx, ny = buffer[j0 + i], buffer[j1 + i]
            buffer[j2 + i] = nx * dx + ny * dy
            buffer[j3 + i] = nx * dx - ny * dy
            buffer[j4 + i] = nx * dy + ny * dx
    squares = 0.0
    for i in range(np.uint64(3)):
        _clear(buffer, _row(_TELLS) + i * np.uint64(ROOM), count)
    _clear(buffer, _row(_PULL), count)
    _clear(buffer, _row(_PULL + 1), count)
    # One by one: rows must be known when this is compiled, or it would not be vectorised.
    t, a = np.float32(together), optics.absorbed
    squares += _channel(t, a[0, 0], a[1, 0], a[2, 0], 0, count, lights, says, buffer)
    squares += _channel(t, a[0, 1], a[1, 1], a[2, 1], 1, count, lights, says, buffer)
    squares += _channel(t, a[0, 2], a[1, 2], a[2, 2], 2, count, lights, says, buffer)
    return squares


@njit()
def _clear(buffer: Array32, row: np.uint64, count: int) -> None:
    for i in range(np.uint64(count)):
        buffer[row + i] = _F0


@njit(reassociate=True, inline="always")
def _channel(
    t: np.float32,
    a0: np.float32,
    a1: np.float32,
    b: np.float32,
    c: int,
    count: int,
    lights: Array,
    says: Array,
    buffer: Array32,
) -> float:
    """What one channel says, added to the rows of all; returns its sum of squared residuals."""
    light, seen, weight = _row(_GROUND + c), _row(_SEEN + c), _row(_WEIGHT + c)
    c0, c1, gain0, gain1 = _row(_COVERED), _row(_COVERED + 1), _row(_GAIN + c), _row(_GAIN + 3 + c)
    own0, own1, cross, whole = _row(_TELLS), _row(_TELLS + 1), _row(_TELLS + 2), _row(_MODEL + c)
    pull0, pull1 = _row(_PULL), _row(_PULL + 1)
    information, lack, squares = _F0, _F0, _F0
    for i in range(np.uint64(count)):
        first, second, g, w = buffer[c0 + i], buffer[c1 + i], buffer[light + i], buffer[weight + i]
        # See `togetherness`: both cover this, and change it so.
        both = (_F1 - t) * first * second + t * min(first, second)
        smaller = _F1 if first < second else _F0
        by_first = (_F1 - t) * second + t * smaller
        by_second = (_F1 - t) * first + t * (_F1 - smaller)
        model = g * (_F1 - a0 * first - a1 * second + b * both)
        residual = buffer[seen + i] - model
        d0, d1 = g * (b * by_first - a0), g * (b * by_second - a1)
        buffer[own0 + i] += w * d0 * d0
        buffer[own1 + i] += w * d1 * d1
        buffer[cross + i] += w * d0 * d1
        buffer[pull0 + i] += w * d0 * residual
        buffer[pull1 + i] += w * d1 * residual
        buffer[gain0 + i] = w * model * d0
        buffer[gain1 + i] = w * model * d1
        buffer[whole + i] = model
        information += w * model * model
        lack += w * model * residual
        squares += w * residual * residual
    lights[c, :] = 0.0
    lights[c, c], says[c] = information, lack
    return np.float64(squares)


@njit(reassociate=True)
def _dot(buffer: Array32, first: int, second: int, count: int) -> float:
    """Product of two rows of the buffer."""
    total, a, b = _F0, _row(first), _row(second)
    for i in range(np.uint64(count)):
        total += buffer[a + i] * buffer[b + i]
    return np.float64(total)


@njit(reassociate=True)
def _weighted(buffer: Array32, weight: int, first: int, second: int, count: int) -> float:
    """Weighted product of two rows of the buffer."""
    total, w, a, b = _F0, _row(weight), _row(first), _row(second)
    for i in range(np.uint64(count)):
        total += buffer[w + i] * buffer[a + i] * buffer[b + i]
    return np.float64(total)


@njit()
def _normal_equations(
    count: int,
    free: int,
    buffer: Array32,
    normal: Array,
    gradient: Array,
    cross: Array,
) -> None:
    """Information on a pair and its gradient.

    `cross` receives the information shared with the gain of each channel.
    """
    for i in range(free):
        at, other = _place(0, i, free), _place(1, i, free)
        here, there = _CHANGE + i, _CHANGE + 5 + i
        gradient[at] = _dot(buffer, here, _PULL, count)
        gradient[other] = _dot(buffer, there, _PULL + 1, count)
        for c in range(3):
            cross[c, at] = _dot(buffer, here, _GAIN + c, count)
            cross[c, other] = _dot(buffer, there, _GAIN + 3 + c, count)
        for j in range(free):
            near, far = _place(0, j, free), _place(1, j, free)
            if j <= i:
                normal[at, near] = _weighted(buffer, _TELLS, here, _CHANGE + j, count)
                normal[near, at] = normal[at, near]
                normal[other, far] = _weighted(buffer, _TELLS + 1, there, _CHANGE + 5 + j, count)
                normal[far, other] = normal[other, far]
            normal[other, near] = _weighted(buffer, _TELLS + 2, there, _CHANGE + j, count)
            normal[near, other] = normal[other, near]


@njit()
def _uneven_light(
    fit: Array, count: int, free: int, lights: Array, says: Array, cross: Array, buffer: Array32
) -> None:
    """Information on the terms of uneven light, beside that on the gains."""
    mx, my = _middle(fit)
    for i in range(np.uint64(count)):
        dx, dy = buffer[_row(_X) + i] - mx, buffer[_row(_Y) + i] - my
        buffer[_row(_TERM) + i], buffer[_row(_TERM + 1) + i] = dx, dy
        buffer[_row(_TERM + 2) + i] = _UNIT * dx * dx
        buffer[_row(_TERM + 3) + i] = _UNIT * dx * dy
        buffer[_row(_TERM + 4) + i] = _UNIT * dy * dy
        whole, lack = _F0, _F0
        for c in range(3):
            weighted = buffer[_row(_WEIGHT + c) + i] * buffer[_row(_MODEL + c) + i]
            part = weighted * buffer[_row(_MODEL + c) + i]
            buffer[_row(_LIGHT + c) + i] = part
            whole += part
            lack += weighted * (buffer[_row(_SEEN + c) + i] - buffer[_row(_MODEL + c) + i])
        buffer[_row(_ALL_LIGHT) + i], buffer[_row(_LACK) + i] = whole, lack
        for k in range(2):
            first = _GAIN + 3 * k
            buffer[_row(_SHARED + k) + i] = (
                buffer[_row(first) + i] + buffer[_row(first + 1) + i] + buffer[_row(first + 2) + i]
            )
    for j in range(TERMS):
        term = _TERM + j
        says[3 + j] = _dot(buffer, term, _LACK, count)
        for c in range(3):
            lights[c, 3 + j] = lights[3 + j, c] = _dot(buffer, term, _LIGHT + c, count)
        for i in range(TERMS):
            lights[3 + j, 3 + i] = _weighted(buffer, _ALL_LIGHT, term, _TERM + i, count)
        for i in range(free):
            for k in range(2):
                cross[3 + j, _place(k, i, free)] = _weighted(
                    buffer, _SHARED + k, term, _CHANGE + 5 * k + i, count
                )


@njit()
def _solve_light(
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
def _light_step(
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


@njit(inline="always")
def _place(layer: int, number: int, free: int) -> int:
    """Where a number of a layer stands among the unknowns.

    Strains first: so the covariance of all others is the inverse of one corner of the factor.
    """
    if free == 2:
        return 2 * layer + number
    return 2 * layer + number - 3 if number > 2 else 4 + 3 * layer + number


@njit()
def _solve(normal: Array, gradient: Array, change: Array, covariance: Array) -> bool:
    """Solve by Cholesky, in place; False where the information is not positive definite."""
    size = gradient.shape[0]
    for i in range(size):
        if not normal[i, i] > 0.0:  # a layer that is not there
            normal[i, i] = 1.0
        for j in range(i + 1):
            total = normal[i, j]
            for k in range(j):
                total -= normal[i, k] * normal[j, k]
            if i > j:
                normal[i, j] = total / normal[j, j]
            elif total > 1e-9 * normal[i, i]:
                normal[i, i] = math.sqrt(total)
            else:
                return False
    for i in range(size):
        total = gradient[i]
        for k in range(i):
            total -= normal[i, k] * change[k]
        change[i] = total / normal[i, i]
    for i in range(size - 1, -1, -1):
        total = change[i]
        for k in range(i + 1, size):
            total -= normal[k, i] * change[k]
        change[i] = total / normal[i, i]
    _invert_corner(normal, covariance)
    return True


@njit()
def _invert_corner(factor: Array, covariance: Array) -> None:
    """Covariance of (x, y, e) of both layers; of (x, y) alone where only they are free."""
    size = factor.shape[0]
    first = 4 if size == 10 else 0
    corner = size - first
    inverse = np.zeros((6, 6))
    for j in range(corner):
        inverse[j, j] = 1.0 / factor[first + j, first + j]
        for i in range(j + 1, corner):
            total = 0.0
            for k in range(j, i):
                total -= factor[first + i, first + k] * inverse[k, j]
            inverse[i, j] = total / factor[first + i, first + i]
    covariance[:] = np.nan
    for i in range(corner):
        for j in range(i + 1):
            total = 0.0
            for k in range(i, corner):
                total += inverse[k, i] * inverse[k, j]
            row, col = (i, j) if corner == 6 else (i + i // 2, j + j // 2)
            covariance[row, col] = covariance[col, row] = total


@njit()
def _improve(
    fit: Array, shapes: Array, present: NDArray[np.bool_], change: Array, free: int
) -> float:
    """Add a step, shortened where it would leave the linear range; returns how far edges went."""
    longest = 0.0
    for k in range(2):
        if not present[k]:
            continue
        dx, dy = change[_place(k, 0, free)], change[_place(k, 1, free)]
        length = math.hypot(dx, dy)
        longest = max(longest, min(length, _LONGEST_STEP))
        share = min(1.0, _LONGEST_STEP / max(length, 1e-9))
        fit[k, 0] += share * dx
        fit[k, 1] += share * dy
        radius = math.sqrt(
            abs(shapes[k, 0, 0] * shapes[k, 1, 1] - shapes[k, 0, 1] * shapes[k, 1, 0])
        )
        for i in range(2, free):
            by = min(max(change[_place(k, i, free)], -_LONGEST_STRAIN), _LONGEST_STRAIN)
            longest = max(longest, radius * abs(by))
            fit[k, i] += by
    return longest


@njit()
def _stretch(nominal: Array, fit: Array, out: Array) -> None:
    size = math.exp(fit[2])
    for j in range(2):
        a, b = nominal[0, j], nominal[1, j]
        out[0, j] = size * ((1.0 + fit[3]) * a + fit[4] * b)
        out[1, j] = size * (fit[4] * a + (1.0 - fit[3]) * b)


@njit()
def _invert(a: Array, out: Array) -> None:
    det = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    out[0, 0], out[0, 1] = a[1, 1] / det, -a[0, 1] / det
    out[1, 0], out[1, 1] = -a[1, 0] / det, a[0, 0] / det


@njit()
def _plausible(fit: Array) -> bool:
    for k in range(2):
        for i in range(2, 5):
            if not abs(fit[k, i]) < MAX_STRAIN:
                return False
    return True


@njit()
def mean_hues(image: NDArray[np.uint8], shapes: Array, fits: Array) -> Array:
    """Hue [°], −180…180, of the mean colour inside each first-layer marker; NaN where it is lost.

    Computed in float: 8-bit hue has steps of 2°, coarser than the noise.
    """
    height, breadth = image.shape[0], image.shape[1]
    hues = np.full(fits.shape[0], np.nan)
    shape, inverse = np.empty((2, 2)), np.empty((2, 2))
    for m in range(fits.shape[0]):
        x, y = fits[m, 0, 0], fits[m, 0, 1]
        if not math.isfinite(x + y):
            continue
        _stretch(shapes[0, m], fits[m, 0], shape)
        _invert(shape, inverse)
        half_y = math.sqrt(shape[1, 0] ** 2 + shape[1, 1] ** 2)
        xx = inverse[0, 0] ** 2 + inverse[1, 0] ** 2
        xy = inverse[0, 0] * inverse[0, 1] + inverse[1, 0] * inverse[1, 1]
        yy = inverse[0, 1] ** 2 + inverse[1, 1] ** 2
        red = green = blue = 0
        for row in range(max(0, int(y - half_y)), min(height, int(y + half_y) + 2)):
            dy = row - y
            root = (xy * dy) ** 2 - xx * (yy * dy * dy - 1.0)
            if root <= 0.0:
                continue
            half, middle = math.sqrt(root) / xx, x - xy * dy / xx
            for col in range(max(0, int(middle - half) + 1), min(breadth, int(middle + half) + 1)):
                red += image[row, col, 0]
                green += image[row, col, 1]
                blue += image[row, col, 2]
        hues[m] = math.degrees(
            math.atan2(math.sqrt(3.0) * (green - blue), 2.0 * red - green - blue)
        )
    return hues


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
    lights, says = np.zeros((_LIGHTS, _LIGHTS)), np.zeros(_LIGHTS)
    values, extents = np.empty(5), _extents(optics, fits)
    for m in range(fits.shape[0]):
        for k in range(2):
            _stretch(optics.shapes[k, m], fits[m, k], shapes[k])
            _invert(shapes[k], inverses[k])
            outlines[k, 0] = fits[m, k, :2]
            outlines[k, 1:] = shapes[k].T
        count = _gather(
            image, optics, present[m], fits[m], gains[m], slopes[m], shapes, inverses, stride,
            box, buffer,
        )  # fmt: skip
        sums[m] = 0.0
        if count < _FEWEST_PIXELS:
            continue
        _shade(optics, present, fits, extents, m, box, count, buffer)
        t = togetherness(outlines[0], outlines[1]) if present[m].all() else 0.0
        _model(optics, present[m], fits[m], inverses, t, 2, count, lights, says, buffer)
        for i in range(count):
            first, second = buffer[_COVERED * ROOM + i], buffer[(_COVERED + 1) * ROOM + i]
            # Edges tell less of colours than of tone curves, blur, and where markers are.
            if _EDGE < first < 1.0 - _EDGE or _EDGE < second < 1.0 - _EDGE:
                continue
            values[0], values[1], values[2] = 1.0, first, second
            values[3] = (1.0 - t) * first * second + t * min(first, second)
            for c in range(3):
                light = buffer[(_GROUND + c) * ROOM + i]
                values[4] = buffer[(_SEEN + c) * ROOM + i] / light
                weight = buffer[(_WEIGHT + c) * ROOM + i] * light * light
                for a in range(5):
                    for b in range(5):
                        sums[m, c, a, b] += weight * values[a] * values[b]


@njit()
def torn_off(
    moved: Array, visible: NDArray[np.bool_], near: NDArray[np.int64], limit: float
) -> NDArray[np.bool_]:
    """Markers that moved otherwise than at least half of their visible neighbours, shape (M, 2).

    Parameters
    ----------
    moved: since rest [px], shape (M, 2, 2)
    visible: shape (M, 2)
    near: neighbours, shape (M, K)
    limit: of the difference, along x or y [px]
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
