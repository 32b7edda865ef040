"""Compiled products of a pair's pixels, and the light on it. `pair_fit.py` documents the use.

Light is a gain for each channel and, for uneven light, terms up to second order that all channels
share. It is eliminated from the normal equations, which then contain the markers alone.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit
from ....render.drawing import togetherness
from .cholesky_kernels import factorise
from .gather_kernels import ROWS, gather
from .lanes import sum_of_products
from .pixel_kernels import (
    ALL_LIGHT,
    BOTH,
    CHANGE,
    COVERED,
    F0,
    FEWEST_PIXELS,
    GAIN,
    GROUND,
    LACK,
    LEFT,
    LIGHT,
    MODEL,
    READ,
    ROOM,
    SHARED,
    TERM,
    TERMS,
    UNIT,
    WEIGHT,
    Array,
    Array32,
    X,
    Y,
    extents_of,
    middle_of,
    model_pixels,
    outline,
    row_at,
)
from .shade_kernels import shade

#: Number of unknowns of the light: gains of three channels, and terms of uneven light.
LIGHTS = 3 + TERMS
#: Smallest distance of the coverage from 0 and from 1 at an edge.
_EDGE = 0.03


@njit()
def dot(buffer: Array32, first: int, second: int, count: int) -> float:
    """Scalar product of two rows of the buffer."""
    rows = row_at(first), row_at(second)
    return np.float64(sum_of_products(buffer, rows, np.uint64(count)))


@njit()
def weighted_dot(buffer: Array32, weight: int, first: int, second: int, count: int) -> float:
    """Weighted scalar product of two rows of the buffer."""
    rows = row_at(weight), row_at(first), row_at(second)
    return np.float64(sum_of_products(buffer, rows, np.uint64(count)))


@njit()
def uneven_light(
    fit: Array, count: int, free: int, lights: Array, rhs: Array, cross: Array, buffer: Array32
) -> None:
    """Add the terms of uneven light to the normal equations of the gains."""
    mx, my = middle_of(fit)
    for i in range(np.uint64(count)):
        dx, dy = buffer[row_at(X) + i] - mx, buffer[row_at(Y) + i] - my
        buffer[row_at(TERM) + i], buffer[row_at(TERM + 1) + i] = dx, dy
        buffer[row_at(TERM + 2) + i] = UNIT * dx * dx
        buffer[row_at(TERM + 3) + i] = UNIT * dx * dy
        buffer[row_at(TERM + 4) + i] = UNIT * dy * dy
        all_light, lack = F0, F0
        for c in range(3):
            weighted = buffer[row_at(WEIGHT + c) + i] * buffer[row_at(MODEL + c) + i]
            part = weighted * buffer[row_at(MODEL + c) + i]
            buffer[row_at(LIGHT + c) + i] = part
            all_light += part
            lack += weighted * buffer[row_at(LEFT + c) + i]
        buffer[row_at(ALL_LIGHT) + i], buffer[row_at(LACK) + i] = all_light, lack
        for k in range(2):
            first = GAIN + 3 * k
            buffer[row_at(SHARED + k) + i] = (
                buffer[row_at(first) + i]
                + buffer[row_at(first + 1) + i]
                + buffer[row_at(first + 2) + i]
            )
    for j in range(TERMS):
        term = TERM + j
        rhs[3 + j] = dot(buffer, term, LACK, count)
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
    lights: Array, rhs: Array, cross: Array, terms: int, normal: Array, gradient: Array
) -> bool:
    """Eliminate the light from the normal equations; False if the light is not determined.

    `lights`, the information matrix of the light, becomes its Cholesky factor L; `rhs` and `cross`
    are multiplied by L⁻¹.
    """
    if not factorise(lights, terms):
        return False
    size = gradient.shape[0]
    for i in range(terms):
        for k in range(i):
            factor = lights[i, k]
            if factor != 0.0:
                rhs[i] -= factor * rhs[k]
                for j in range(size):
                    cross[i, j] -= factor * cross[k, j]
        rhs[i] /= lights[i, i]
        for j in range(size):
            cross[i, j] /= lights[i, i]
        for j in range(size):
            gradient[j] -= cross[i, j] * rhs[i]
            for k in range(size):
                normal[j, k] -= cross[i, j] * cross[i, k]
    return True


@njit()
def light_step(
    lights: Array, rhs: Array, cross: Array, change: Array, terms: int, out: Array
) -> None:
    """Compute the change of the light that follows from a change of the markers."""
    for i in range(terms - 1, -1, -1):
        total = rhs[i]
        for j in range(change.shape[0]):
            total -= cross[i, j] * change[j]
        for k in range(i + 1, terms):
            total -= lights[k, i] * out[k]
        out[i] = total / lights[i, i]


@njit()
def share_light(lights: Array, cross: Array, factor: Array, covariance: Array) -> None:
    """Compute covariances of log gains with (x, y, e) of both layers, and among themselves.

    Parameters
    ----------
    lights, cross: results of `solve_light` for even light
    factor: Cholesky factor of the information matrix of all five parameters of both layers
    covariance: result, shape (9, 9), gains last
    """
    size = factor.shape[0]
    first = place_of(0, 0, 5)
    response = np.empty((3, size))
    for i in range(size):
        # Response of the markers to the light of each channel, by forward substitution …
        inverse = 1.0 / factor[i, i]
        for c in range(3):
            total = cross[c, i] / lights[c, c]
            for k in range(i):
                total -= factor[i, k] * response[c, k]
            response[c, i] = total * inverse
    for c in range(3):
        for d in range(c + 1):
            total = 1.0 / lights[c, c] ** 2 if c == d else 0.0
            for i in range(size):
                total += response[c, i] * response[d, i]
            covariance[6 + c, 6 + d] = covariance[6 + d, 6 + c] = total
    for i in range(size - 1, first - 1, -1):
        # … and back, for places and sizes, which are the last unknowns.
        inverse = 1.0 / factor[i, i]
        for c in range(3):
            total = response[c, i]
            for k in range(i + 1, size):
                total -= factor[k, i] * response[c, k]
            response[c, i] = total * inverse
            covariance[6 + c, i - first] = covariance[i - first, 6 + c] = -response[c, i]


@njit(inline="always")
def place_of(layer: int, number: int, free: int) -> int:
    """Index of a layer's parameter among the unknowns.

    Strains come first, so that the covariance of all others follows from a corner of the factor.
    """
    if free == 2:
        return 2 * layer + number
    return 2 * layer + number - 3 if number > 2 else 4 + 3 * layer + number


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
    """Sum weighted products of (1, C₀, C₁, C₀₁, light over ground) for each pair and channel.

    `sums` receives them, shape (M, 3, 5, 5). Other parameters are as in `fit_step`.
    """
    shapes, inverses = np.empty((2, 2, 2)), np.empty((2, 2, 2))
    outlines, box = np.empty((2, 3, 2)), np.empty(4)
    lights, rhs = np.zeros((LIGHTS, LIGHTS)), np.zeros(LIGHTS)
    values, extents = np.empty(5), extents_of(optics, fits)
    runs = np.empty((ROWS, 3), dtype=np.int64)
    for m in range(fits.shape[0]):
        outline(optics, fits, m, shapes, inverses, outlines)
        count, padded = gather(
            image, optics, present[m], fits[m], gains[m], slopes[m], shapes, inverses, stride,
            box, runs, buffer,
        )  # fmt: skip
        sums[m] = 0.0
        if count < FEWEST_PIXELS:
            continue
        shade(optics, present, fits, extents, m, False, box, padded, buffer)
        t = togetherness(outlines[0], outlines[1]) if present[m].all() else 1.0
        model_pixels(optics, present[m], fits[m], inverses, t, 2, padded, lights, rhs, buffer)
        for i in range(padded):
            if buffer[READ * ROOM + i] == F0:
                continue
            first, second = buffer[COVERED * ROOM + i], buffer[(COVERED + 1) * ROOM + i]
            # Edges depend more on tone curve, blur and positions than on colours.
            if _EDGE < first < 1.0 - _EDGE or _EDGE < second < 1.0 - _EDGE:
                continue
            values[0], values[1], values[2] = 1.0, first, second
            values[3] = buffer[BOTH * ROOM + i]
            row, column = int(buffer[Y * ROOM + i]), int(buffer[X * ROOM + i])
            for c in range(3):
                # The model's colours may be wrong: take observed light and weight.
                level, light = image[row, column, c], buffer[(GROUND + c) * ROOM + i]
                values[4] = optics.linear[c, level] / light
                weight = optics.weight[c, level] * light * light
                for a in range(5):
                    for b in range(5):
                        sums[m, c, a, b] += weight * values[a] * values[b]
