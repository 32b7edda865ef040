"""Compiled model of a pair of overlapping markers, pixel by pixel. `pair_fit.py` documents the use.

The linear light of a pixel is γ · ground · (1 − a₀·C₀ − a₁·C₁ + b·C₀₁), with the local gain γ, the
share a that a dye absorbs, the correction b where both dyes lie, the coverage C by a blurred
ellipse of known shape, and C₀₁ by both. Markers of other pairs that reach into the window darken
the ground; their positions are those of the last fit.

The pixels of a pair are gathered into rows of one flat buffer. The rows' offsets are known at
compile time, so that the model is computed for many pixels at a time. The normal equations are then
products of rows.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit
from ....render.drawing import EDGE_RANGE, edge, edge_slope
from .lanes import sum_of_products

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

#: Smallest number of pixels that determine a pair.
FEWEST_PIXELS = 24
#: Length of a row: largest number of pixels of a pair; more are thinned out. It is no power of two,
#: so that rows do not compete for the same cache lines.
ROOM = 2256
# Rows of the buffer: "of each channel" or "layer" means that many rows from this one on.
#: First row of the buffer for the coordinates of the pixels along x …
X = 0
#: … along y …
Y = 1
#: … for the observed level, of each channel …
OBSERVED = 2
#: … the weight of the light, of each channel …
WEIGHT = 5
#: … the light of the ground, of each channel …
GROUND = 8
#: … the coverage, by each layer …
COVERED = 11
#: … the derivatives of the coverage with respect to the five parameters of each layer …
CHANGE = 13
#: … the information on the coverage by the first layer, by the second, and shared by both …
TELLS = 23
#: … the gradient with respect to the coverage, of each layer …
PULL = 26
#: … the information that the coverage of each layer shares with the gain of each channel …
GAIN = 28
#: … the light of the model, of each channel …
MODEL = 34
#: … the terms of uneven light …
TERM = 37
#: … the information on the light of each channel …
LIGHT = 42
#: … and of all channels …
ALL_LIGHT = 45
#: … the gradient with respect to the light of all channels …
LACK = 46
#: … the information that the light shares with the coverage, of each layer …
SHARED = 47
#: … the coverage by both layers …
BOTH = 49
#: … its derivatives with respect to the coverage by each layer …
BY = 50
#: … the part of the light that does not depend on this pair, due to pairs next to it, of each
#: channel …
BESIDE = 52
#: … the residual of the light, observed minus model, of each channel …
LEFT = 55
#: … the level of the model's light, of each channel …
LEVEL = 58
#: … and whether a pixel is read, 1 or 0.
READ = 61
#: Length of the buffer.
BUFFER = 62 * ROOM
#: Number of the terms of uneven light: x, y, x², xy, y².
TERMS = 5
#: Scale of the second-order terms [1/px].
UNIT = np.float32(1.0 / 16.0)

F0 = np.float32(0.0)
F1 = np.float32(1.0)
F2 = np.float32(2.0)
#: sRGB: the toe ends at this light, and its slope is this [grey levels] …
_TOE_LIGHT = np.float32(0.0031308)
_TOE_SLOPE = np.float32(255.0 * 12.92)
#: … above it levels are _CURVE·light^_EXPONENT − _CURVE_OFFSET.
_CURVE = np.float32(255.0 * 1.055)
_CURVE_OFFSET = np.float32(255.0 * 0.055)
_EXPONENT = np.float32(1.0 / 2.4)
#: Highest level: a camera shows more light as white.
_WHITE = np.float32(255.0)
#: Levels this many standard deviations below it may be white.
_WHITE_RANGE = np.float32(4.0)
#: Parabola near the cube root, between the roots of the toe's end and of white.
_START = (np.float32(0.4587), np.float32(0.8765), np.float32(-0.3354))
#: Lower bound of radicands.
TINY = np.float32(1e-12)


class Optics(NamedTuple):
    """Constants of the pixel model of one sensor."""

    linear: Array32  # (3, 256) linear light of each channel's levels
    weight: Array32  # (3, 256) 1/variance of that light
    black: Array32  # (3,) black level of each channel, which means no light
    variance: np.float32  # variance of a level, by noise and rounding
    ground: Array32  # (H, W, 3) linear light of the unmarked skin; 0 off the skin
    absorbed: Array32  # (3, 3) a₀, a₁ and b (rows) of each channel
    shapes: Array  # (2, M, 2, 2) semi-axes of each marker at nominal size, as columns [px]
    neighbours: NDArray[np.int64]  # (M, K) indices of pairs near each pair, −1 for none
    width: float  # standard deviation of an edge [px]
    reach: float  # distance outside an edge up to which pixels are read [widths]


@njit(inline="always")
def row_at(number: int) -> np.uint64:
    """Start of a row in the buffer; unsigned, as loops over signed indices do not vectorise."""
    return np.uint64(number * ROOM)


@njit(inline="always")
def middle_of(fit: Array) -> tuple[np.float32, np.float32]:
    """Middle of a pair [px], at which the light equals the gain."""
    return np.float32(0.5 * (fit[0, 0] + fit[1, 0])), np.float32(0.5 * (fit[0, 1] + fit[1, 1]))


@njit()
def extents_of(optics: Any, fits: Array) -> Array:
    """Approximate largest distance of each marker's edge from its centre [px], shape (M, 2)."""
    extents, shape = np.empty((fits.shape[0], 2)), np.empty((2, 2))
    for m in range(fits.shape[0]):
        for k in range(2):
            stretch(optics.shapes[k, m], fits[m, k], shape)
            extents[m, k] = max(
                math.hypot(shape[0, 0], shape[1, 0]), math.hypot(shape[0, 1], shape[1, 1])
            )
    return extents


@njit()
def model_pixels(
    optics: Any,
    present: NDArray[np.bool_],
    fit: Array,
    inverses: Array,
    together: float,
    free: int,
    count: int,
    lights: Array,
    rhs: Array,
    buffer: Array32,
) -> float:
    """Fill the model's rows of the buffer; return the sum of weighted squared residuals.

    The diagonal of `lights` receives the information on each channel's gain, `rhs` the gradient
    with respect to it.
    """
    per_range = np.float32(1.0 / (EDGE_RANGE * optics.width))
    correction = np.float32(0.5 * optics.width * optics.width)
    for k in range(2):
        exists = np.float32(1.0 if present[k] else 0.0)
        cx, cy = np.float32(fit[k, 0]), np.float32(fit[k, 1])
        i00, i01 = np.float32(inverses[k, 0, 0]), np.float32(inverses[k, 0, 1])
        i10, i11 = np.float32(inverses[k, 1, 0]), np.float32(inverses[k, 1, 1])
        covered, x, y = row_at(COVERED + k), row_at(X), row_at(Y)
        j0, j1, j2 = (
            row_at(CHANGE + 5 * k),
            row_at(CHANGE + 5 * k + 1),
            row_at(CHANGE + 5 * k + 2),
        )
        j3, j4 = row_at(CHANGE + 5 * k + 3), row_at(CHANGE + 5 * k + 4)
        for i in range(np.uint64(count)):
            # First-order distance to the edge, positive inside; coverage and its derivative.
            dx, dy = buffer[x + i] - cx, buffer[y + i] - cy
            qx, qy = i00 * dx + i01 * dy, i10 * dx + i11 * dy
            radius = np.sqrt(qx * qx + qy * qy + TINY)
            to_radius = F1 / radius
            gx, gy = (i00 * qx + i10 * qy) * to_radius, (i01 * qx + i11 * qy) * to_radius
            slope = np.sqrt(gx * gx + gy * gy + TINY)
            to_slope = F1 / slope
            u = ((F1 - radius) * to_slope - correction * slope) * per_range
            buffer[covered + i] = exists * edge(u)
            rise = exists * edge_slope(u) * per_range * to_slope
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
        clear(buffer, row_at(TELLS) + i * np.uint64(ROOM), count)
    clear(buffer, row_at(PULL), count)
    clear(buffer, row_at(PULL + 1), count)
    _cover_both(np.float32(together), count, buffer)
    # No loop: rows must be known at compile time for vectorised sums.
    a = optics.absorbed
    squares += _channel(optics, a[0, 0], a[1, 0], a[2, 0], 0, count, lights, rhs, buffer)
    squares += _channel(optics, a[0, 1], a[1, 1], a[2, 1], 1, count, lights, rhs, buffer)
    squares += _channel(optics, a[0, 2], a[1, 2], a[2, 2], 2, count, lights, rhs, buffer)
    return squares


@njit()
def _cover_both(odds: np.float32, count: int, buffer: Array32) -> None:
    """Compute the coverage by both layers, see `covered_by_both`, and its derivatives."""
    c0, c1, both, by0, by1 = (
        row_at(COVERED),
        row_at(COVERED + 1),
        row_at(BOTH),
        row_at(BY),
        row_at(BY + 1),
    )
    more, half = odds - F1, np.float32(0.5)
    for i in range(np.uint64(count)):
        first, second = buffer[c0 + i], buffer[c1 + i]
        apart, sum_ = more * (first - second), first + second
        square = F1 + F2 * more * (sum_ - F2 * first * second) + apart * apart
        root = np.sqrt(max(square, TINY))
        buffer[both + i] = F2 * odds * first * second / (F1 + more * sum_ + root)
        to_root = half / root
        buffer[by0 + i] = half - to_root * (F1 - F2 * second + apart)
        buffer[by1 + i] = half - to_root * (F1 - F2 * first - apart)


@njit()
def clear(buffer: Array32, row: np.uint64, count: int) -> None:
    """Set a row to zeros."""
    for i in range(np.uint64(count)):
        buffer[row + i] = F0


@njit(inline="always")
def _channel(
    optics: Any,
    a0: np.float32,
    a1: np.float32,
    b: np.float32,
    c: int,
    count: int,
    lights: Array,
    rhs: Array,
    buffer: Array32,
) -> float:
    """Add one channel to the rows of all channels; return its sum of squared residuals.

    Residuals are differences of levels, whose noise is uniform: weights that depend on a pixel's
    own noise would bias the fit. Divided by the slope of the sRGB curve they are residuals of
    light, with matching weights.
    """
    light, rest, left, weight = (
        row_at(GROUND + c),
        row_at(BESIDE + c),
        row_at(LEFT + c),
        row_at(WEIGHT + c),
    )
    c0, c1, gain0, gain1 = (
        row_at(COVERED),
        row_at(COVERED + 1),
        row_at(GAIN + c),
        row_at(GAIN + 3 + c),
    )
    own0, own1, cross, modelled = (
        row_at(TELLS),
        row_at(TELLS + 1),
        row_at(TELLS + 2),
        row_at(MODEL + c),
    )
    pull0, pull1 = row_at(PULL), row_at(PULL + 1)
    both, by0, by1 = row_at(BOTH), row_at(BY), row_at(BY + 1)
    for i in range(np.uint64(count)):
        first, second, g = buffer[c0 + i], buffer[c1 + i], buffer[light + i]
        model = g * (F1 - a0 * first - a1 * second + b * buffer[both + i]) + buffer[rest + i]
        buffer[modelled + i] = model
    _encode(optics, c, count, buffer)
    for i in range(np.uint64(count)):
        g, w, residual = buffer[light + i], buffer[weight + i], buffer[left + i]
        d0, d1 = g * (b * buffer[by0 + i] - a0), g * (b * buffer[by1 + i] - a1)
        buffer[own0 + i] += w * d0 * d0
        buffer[own1 + i] += w * d1 * d1
        buffer[cross + i] += w * d0 * d1
        buffer[pull0 + i] += w * d0 * residual
        buffer[pull1 + i] += w * d1 * residual
        model = buffer[modelled + i]
        buffer[gain0 + i] = w * model * d0
        buffer[gain1 + i] = w * model * d1
    lights[c, :] = 0.0
    end = np.uint64(count)
    lights[c, c] = sum_of_products(buffer, (weight, modelled, modelled), end)
    rhs[c] = sum_of_products(buffer, (weight, modelled, left), end)
    return np.float64(sum_of_products(buffer, (weight, left, left), end))


@njit(inline="always")
def _encode(optics: Any, c: int, count: int, buffer: Array32) -> None:
    """Compute levels of a channel's light, their residuals to the observed ones, and weights.

    The exponent of sRGB is 5/12 = 1/4 + 1/6: two square roots, and a further cube root by Newton's
    method, exact to 1e-4 of a level. A table would need a memory access for each pixel.
    """
    modelled, level, left, weight = (
        row_at(MODEL + c),
        row_at(LEVEL + c),
        row_at(LEFT + c),
        row_at(WEIGHT + c),
    )
    observed, read = row_at(OBSERVED + c), row_at(READ)
    black, span = optics.black[c], (F1 - optics.black[c] * np.float32(1.0 / 255.0))
    per_variance, third = F1 / optics.variance, np.float32(1.0 / 3.0)
    deviation = np.sqrt(optics.variance)
    white, above = _WHITE - _WHITE_RANGE * deviation, _WHITE + F2 * deviation
    for i in range(np.uint64(count)):
        light = buffer[modelled + i]
        bright = max(light, _TOE_LIGHT)
        fourth = np.sqrt(np.sqrt(bright))
        twelfth = _START[0] + fourth * (_START[1] + fourth * _START[2])
        twelfth -= third * (twelfth - fourth / (twelfth * twelfth))
        twelfth -= third * (twelfth - fourth / (twelfth * twelfth))
        curve = _CURVE * fourth * twelfth * twelfth
        in_toe = light < _TOE_LIGHT
        # Below black the toe's line goes on, above white the curve.
        shown = _TOE_SLOPE * light if in_toe else curve - _CURVE_OFFSET
        slope = span * (_TOE_SLOPE if in_toe else curve * _EXPONENT / bright)
        now = black + span * shown
        buffer[level + i] = now
        seen = buffer[observed + i]
        # A pixel that is white, as expected, tells nothing more.
        tells = F0 if now > above and seen > white else buffer[read + i]
        buffer[left + i] = (seen - now) / slope
        buffer[weight + i] = tells * slope * slope * per_variance


@njit()
def stretch(nominal: Array, fit: Array, out: Array) -> None:
    """Shape of a marker: its nominal semi-axes with the size and the strain of the fit."""
    size = math.exp(fit[2])
    for j in range(2):
        a, b = nominal[0, j], nominal[1, j]
        out[0, j] = size * ((1.0 + fit[3]) * a + fit[4] * b)
        out[1, j] = size * (fit[4] * a + (1.0 - fit[3]) * b)


@njit()
def outline(
    optics: Any, fits: Array, m: int, shapes: Array, inverses: Array, outlines: Array
) -> None:
    """Compute shapes of a pair's markers, their inverses (2, 2, 2), and (c, a₁, a₂), (2, 3, 2)."""
    for k in range(2):
        stretch(optics.shapes[k, m], fits[m, k], shapes[k])
        invert(shapes[k], inverses[k])
        for i in range(2):
            outlines[k, 0, i] = fits[m, k, i]
            for j in range(2):
                outlines[k, 1 + j, i] = shapes[k, i, j]


@njit()
def invert(a: Array, out: Array) -> None:
    """Inverse of a 2 × 2 matrix."""
    det = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    out[0, 0], out[0, 1] = a[1, 1] / det, -a[0, 1] / det
    out[1, 0], out[1, 1] = -a[1, 0] / det, a[0, 0] / det
