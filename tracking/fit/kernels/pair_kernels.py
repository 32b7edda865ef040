"""Compiled fit of pairs of overlapping markers to the image. `pair_fit.py` documents the use.

Fitted parameters of each layer's marker are its centre (x, y) [px], its logarithmic size e over the
nominal one and its strain (p, q): the nominal shape S becomes eᵉ·[[1+p, q], [q, 1−p]]·S. The light
is fitted too. The model is in `pixel_kernels`.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit
from ....render.drawing import togetherness
from .cholesky_kernels import factorise, invert_corner
from .gather_kernels import ROWS, gather
from .light_kernels import (
    LIGHTS,
    dot,
    light_step,
    place_of,
    share_light,
    solve_light,
    uneven_light,
    weighted_dot,
)
from .neighbour_kernels import slopes_of
from .pixel_kernels import (
    CHANGE,
    FEWEST_PIXELS,
    GAIN,
    PULL,
    TELLS,
    Array,
    Array32,
    extents_of,
    invert,
    model_pixels,
    outline,
    stretch,
)
from .shade_kernels import shade
from .template_kernels import UNKNOWNS, keep_template

#: Upper bound of a marker's strains and logarithmic size.
MAX_STRAIN = 0.5
#: Longest motion in one step [px].
_LONGEST_STEP = 2.0
#: Largest change of strain or logarithmic size in one step.
_LONGEST_STRAIN = 0.1
#: Motion of an edge that a relative change of the light by 1 counts as, for convergence [px].
_LIGHT_STEP = 8.0


@njit()
def converge(
    image: NDArray[np.uint8],
    optics: Any,
    around: Any,
    wanted: NDArray[np.bool_],
    present: NDArray[np.bool_],
    beside: NDArray[np.bool_],
    kept: NDArray[np.bool_],
    free: int,
    stride: int,
    most: int,
    arrived: float,
    sloped: float,
    fits: Array,
    gains: Array,
    slopes: Array,
    moved: Array,
    covariance: Array,
    misfit: Array,
    pool: Any,
    buffer: Array32,
) -> None:
    """Step the wanted pairs in place until they converge; slopes of the light are the neighbours'.

    Parameters
    ----------
    around: neighbours of each pair, see `Around`
    wanted: pairs to fit, shape (M,)
    most: largest number of steps
    arrived: largest motion of an edge in the step of a converged pair [px]
    sloped: change of the light's slope above which another step is made [1/px]
    moved: result: last step of each pair [px], shape (M,)

    Other parameters are as in `fit_step`.
    """
    active, even = wanted.copy(), np.zeros(len(wanted), dtype=np.bool_)
    seen = np.empty((len(wanted), 2))
    extents = extents_of(optics, fits)
    for _ in range(most):
        fit_step(
            image, optics, extents, active, present, even, beside, kept, free, stride, fits, gains,
            slopes, moved, covariance, misfit, pool, buffer,
        )  # fmt: skip
        slopes_of(gains, around.near, around.to_slope, seen)
        left = False
        for m in range(len(wanted)):
            if not wanted[m]:
                continue
            turned = False
            for i in range(2):
                turned = turned or abs(seen[m, i] - slopes[m, i]) > sloped
            for i in range(2):
                slopes[m, i] = seen[m, i] if turned else 0.5 * (seen[m, i] + slopes[m, i])
            if active[m]:
                active[m] = math.isfinite(misfit[m]) and (moved[m] > arrived or turned)
            left = left or active[m]
        if not left:
            break


@njit()
def fit_step(
    image: NDArray[np.uint8],
    optics: Any,
    extents: Array,
    active: NDArray[np.bool_],
    present: NDArray[np.bool_],
    uneven: NDArray[np.bool_],
    beside: NDArray[np.bool_],
    kept: NDArray[np.bool_],
    free: int,
    stride: int,
    fits: Array,
    gains: Array,
    slopes: Array,
    steps: Array,
    covariance: Array,
    misfit: Array,
    pool: Any,
    buffer: Array32,
) -> None:
    """Make one Gauss–Newton step on every active one of M pairs, in place.

    Parameters
    ----------
    image: sRGB image, shape (H, W, 3)
    optics: constants of the pixel model
    extents: extents of the markers, see `extents_of`, shape (M, 2)
    active: pairs to step, shape (M,)
    present: whether the model has each layer's marker, shape (M, 2)
    uneven: pairs whose light is fitted to second order; others keep their slopes, shape (M,)
    beside: pairs whose edges share light with those of other pairs, see `shade`, shape (M,)
    kept: pairs whose template is replaced, by the model before the step, shape (M,)
    free: number of fitted parameters per marker, 5 or the first 2
    stride: every `stride`-th row of the image is read
    fits: (x, y, e, p, q) of each layer, shape (M, 2, 5)
    gains: light over that of the ground, of each channel, shape (M, 3)
    slopes: terms of the light on a pair relative to its gain, see TERMS, shape (M, 5)
    steps: result: motion of an edge in the step, or its equivalent change of light [px], (M,)
    covariance: result: covariance of (x, y, e) of both layers and of the logarithms of the gains
        before the step, shape (M, 9, 9); NaN where not fitted, and for gains under uneven light
    misfit: result: mean squared residual over noise variance before the step, shape (M,); infinite
        where the fit left the image or diverged
    pool: templates, see `Pool`
    buffer: working memory, shape (BUFFER,)
    """
    shapes, inverses = np.empty((2, 2, 2)), np.empty((2, 2, 2))
    outlines = np.empty((2, 3, 2))
    size = 2 * free
    normal, gradient, change = np.empty((size, size)), np.empty(size), np.empty(size)
    cross, box = np.zeros((LIGHTS, size)), np.empty(4)
    lights, rhs, brighter = np.zeros((LIGHTS, LIGHTS)), np.zeros(LIGHTS), np.zeros(LIGHTS)
    information = np.empty((2, UNKNOWNS, UNKNOWNS))
    runs = np.empty((ROWS, 3), dtype=np.int64)
    for m in range(fits.shape[0]):
        if not active[m]:
            continue
        misfit[m], steps[m] = np.inf, 0.0
        if kept[m]:
            pool.counts[m, 0] = 0
        if not (present[m, 0] or present[m, 1]):
            continue
        outline(optics, fits, m, shapes, inverses, outlines)
        count, padded = gather(
            image, optics, present[m], fits[m], gains[m], slopes[m], shapes, inverses, stride,
            box, runs, buffer,
        )  # fmt: skip
        if count < FEWEST_PIXELS:
            continue
        shade(optics, present, fits, extents, m, beside[m], box, padded, buffer)
        together = togetherness(outlines[0], outlines[1]) if present[m].all() else 1.0
        squares = model_pixels(
            optics, present[m], fits[m], inverses, together, free, padded, lights, rhs, buffer
        )
        misfit[m] = squares / max(3 * count - size - 3, 1)
        _normal_equations(padded, free, buffer, normal, gradient, cross)
        terms = 3
        if kept[m] and free == 5:
            keep_template(
                optics, present, fits, gains, slopes, extents, m, count, runs, buffer, normal,
                cross, lights, information, pool,
            )  # fmt: skip
        if uneven[m]:
            terms = LIGHTS
            uneven_light(fits[m], padded, free, lights, rhs, cross, buffer)
        if not solve_light(lights, rhs, cross, terms, normal, gradient):
            misfit[m] = np.inf
            continue
        if not _solve(normal, gradient, change, covariance[m]):
            misfit[m] = np.inf
            continue
        if free == 5 and terms == 3:
            share_light(lights, cross, normal, covariance[m])
        if kept[m]:
            pool.misfit[m], pool.covariance[m] = misfit[m], covariance[m]
        steps[m] = _improve(fits[m], shapes, present[m], change, free)
        light_step(lights, rhs, cross, change, terms, brighter)
        for c in range(3):
            gains[m, c] *= math.exp(min(max(brighter[c], -0.7), 0.7))
            steps[m] = max(steps[m], _LIGHT_STEP * abs(brighter[c]))
        for j in range(terms - 3):
            slopes[m, j] += brighter[3 + j]
        if not _plausible(fits[m]):
            misfit[m] = np.inf


@njit()
def _normal_equations(
    count: int,
    free: int,
    buffer: Array32,
    normal: Array,
    gradient: Array,
    cross: Array,
) -> None:
    """Compute the information matrix and the gradient of a pair's parameters.

    `cross` receives the information that they share with the gain of each channel.
    """
    for i in range(free):
        at, other = place_of(0, i, free), place_of(1, i, free)
        here, there = CHANGE + i, CHANGE + 5 + i
        gradient[at] = dot(buffer, here, PULL, count)
        gradient[other] = dot(buffer, there, PULL + 1, count)
        for c in range(3):
            cross[c, at] = dot(buffer, here, GAIN + c, count)
            cross[c, other] = dot(buffer, there, GAIN + 3 + c, count)
        for j in range(free):
            near, far = place_of(0, j, free), place_of(1, j, free)
            if j <= i:
                normal[at, near] = weighted_dot(buffer, TELLS, here, CHANGE + j, count)
                normal[near, at] = normal[at, near]
                normal[other, far] = weighted_dot(buffer, TELLS + 1, there, CHANGE + 5 + j, count)
                normal[far, other] = normal[other, far]
            normal[other, near] = weighted_dot(buffer, TELLS + 2, there, CHANGE + j, count)
            normal[near, other] = normal[other, near]


@njit()
def _solve(normal: Array, gradient: Array, change: Array, covariance: Array) -> bool:
    """Solve the normal equations in place; False if they are not positive definite."""
    size = gradient.shape[0]
    for i in range(size):
        if not normal[i, i] > 0.0:  # a missing layer
            normal[i, i] = 1.0
    if not factorise(normal, size):
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
    _cover(normal, covariance)
    return True


@njit()
def _cover(factor: Array, covariance: Array) -> None:
    """Compute the covariance of (x, y, e) of both layers; of (x, y) if only these are fitted."""
    sized = factor.shape[0] == 10
    corner, half = np.empty((6, 6)), np.empty((6, 6))
    invert_corner(factor, 4 if sized else 0, half, corner)
    covariance[:] = np.nan
    count = 6 if sized else 4
    for i in range(count):
        for j in range(count):
            row, col = (i, j) if sized else (i + i // 2, j + j // 2)
            covariance[row, col] = corner[i, j]


@njit()
def _improve(
    fit: Array, shapes: Array, present: NDArray[np.bool_], change: Array, free: int
) -> float:
    """Add a step, limited to the linear range; return the largest motion of an edge [px]."""
    longest = 0.0
    for k in range(2):
        if not present[k]:
            continue
        dx, dy = change[place_of(k, 0, free)], change[place_of(k, 1, free)]
        length = math.hypot(dx, dy)
        longest = max(longest, min(length, _LONGEST_STEP))
        share = min(1.0, _LONGEST_STEP / max(length, 1e-9))
        fit[k, 0] += share * dx
        fit[k, 1] += share * dy
        radius = math.sqrt(
            abs(shapes[k, 0, 0] * shapes[k, 1, 1] - shapes[k, 0, 1] * shapes[k, 1, 0])
        )
        for i in range(2, free):
            by = min(max(change[place_of(k, i, free)], -_LONGEST_STRAIN), _LONGEST_STRAIN)
            longest = max(longest, radius * abs(by))
            fit[k, i] += by
    return longest


@njit()
def _plausible(fit: Array) -> bool:
    """Whether sizes and strains of both layers are within bounds."""
    for k in range(2):
        for i in range(2, 5):
            if not abs(fit[k, i]) < MAX_STRAIN:
                return False
    return True


@njit()
def mean_hues(image: NDArray[np.uint8], shapes: Array, fits: Array) -> Array:
    """Hue [°], −180…180, of the mean colour inside each marker of the first layer; NaN if lost.

    It is computed in float: 8-bit hue has steps of 2°, larger than the noise.
    """
    height, breadth = image.shape[0], image.shape[1]
    hues = np.full(fits.shape[0], np.nan)
    shape, inverse = np.empty((2, 2)), np.empty((2, 2))
    for m in range(fits.shape[0]):
        x, y = fits[m, 0, 0], fits[m, 0, 1]
        if not math.isfinite(x + y):
            continue
        stretch(shapes[0, m], fits[m, 0], shape)
        invert(shape, inverse)
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
