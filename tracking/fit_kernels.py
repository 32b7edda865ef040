"""Compiled fit of a pair of overlapping markers to the image. `tracker.py` documents the use.

Model of a pixel, in linear light: ground · (1 − a₀·C₀ − a₁·C₁ + a₀·a₁·C₀₁), a being what a dye
absorbs, C the coverage of a blurred ellipse of known shape and C₀₁ that of both together. Markers
of other pairs that reach into the window darken the ground by where they were last seen. Free, for
both layers: centre (x, y), logarithmic size e and the strain (p, q) that turns the shape S into
eᵉ·[[1+p, q], [q, 1−p]]·S.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..model.compiled import njit
from ..render.coverage import EDGE_RANGE, edge, signed_distance, togetherness

Array = NDArray[np.float64]

#: A fit has converged when its last step moved no edge by more than this [px].
CONVERGED = 2e-2
#: A pair that moved more than this makes its neighbours be fitted once more [px].
DISTURBING = 5e-2
#: Markers do not shrink, grow or stretch by more than this.
MAX_STRAIN = 0.4
#: Pixels further than this many standard deviations from an edge say nothing about it.
FIT_RANGE = 3.0
#: A strain moves the edge of a marker by about its radius [px].
_RADIUS = 5.0

_GAUSS = 1.0 / math.sqrt(2.0 * math.pi)


class Optics(NamedTuple):
    """What the pixels of one sensor are made of, fixed when the rest frame is read."""

    linear: Array  # (256,) linear light of each level
    weight: Array  # (256,) 1/variance of that light
    ground: Array  # (H, W, 3) linear light of the unmarked skin
    absorbed: Array  # (2, 3) 1 − transmittance of the dyes
    shapes: Array  # (2, M, 2, 2) semi-axes of each marker at nominal size, as columns [px]
    neighbours: NDArray[np.int64]  # (M, K) pairs near each pair
    width: float  # standard deviation of an edge [px]


@njit()
def fit_pairs(
    image: NDArray[np.uint8],
    optics: Any,
    fits: Array,
    covariance: Array,
    misfit: Array,
    iterations: int,
) -> None:
    """Gauss–Newton on all pairs, in place, and once more on those whose neighbours moved.

    Parameters
    ----------
    image: sRGB, shape (H, W, 3)
    optics: see Optics
    fits: start and result, (x, y, e, p, q) of each layer, shape (M, 2, 5)
    covariance: result, of all ten numbers of a pair, shape (M, 10, 10)
    misfit: result, mean squared residual over noise variance on the edges, shape (M,); infinite
        where the fit left the image or ran away
    iterations: at most this many
    """
    count = fits.shape[0]
    normal, gradient = np.empty((10, 10)), np.empty(10)
    inverses = np.empty((2 + 2 * optics.neighbours.shape[1], 2, 2))
    outlines = np.empty((2, 3, 2))
    places = np.empty((2 * optics.neighbours.shape[1], 4))
    crowded = np.zeros(count, dtype=np.bool_)
    moved = np.zeros(count)
    for visit in range(2 * count):
        m = visit % count
        if visit >= count:
            disturbed = False
            for other in optics.neighbours[m]:
                disturbed = disturbed or moved[other] > DISTURBING
            if not (crowded[m] and disturbed and np.isfinite(misfit[m])):
                continue
        misfit[m] = np.inf
        for _ in range(iterations):
            window = _window(optics, fits, m, inverses, outlines)
            if not (
                window[0] >= 0
                and window[2] >= 0
                and window[1] < image.shape[1] - 1
                and window[3] < image.shape[0] - 1
            ):
                misfit[m] = np.inf
                break
            others = _reaching_in(optics, fits, m, window, places, inverses)
            crowded[m] = others > 0
            misfit[m] = _normal_equations(
                image,
                optics,
                fits[m],
                togetherness(outlines[0], outlines[1]),
                window,
                places,
                inverses,
                others,
                normal,
                gradient,
            )
            covariance[m] = np.linalg.inv(normal)
            largest = _improve(fits[m], covariance[m] @ gradient)
            moved[m] += largest
            if not _plausible(fits[m]):
                misfit[m] = np.inf
                break
            if largest < CONVERGED:
                break


@njit()
def _window(
    optics: Any, fits: Array, m: int, inverses: Array, outlines: Array
) -> tuple[float, float, float, float]:
    """Box (x0, x1, y0, y1) around both layers; their inverse shapes go to the first inverses."""
    shape = np.empty((2, 2))
    reach = FIT_RANGE * optics.width
    x0, x1, y0, y1 = 1e9, -1e9, 1e9, -1e9
    for k in range(2):
        _stretch(optics.shapes[k, m], fits[m, k], shape)
        _invert(shape, inverses[k])
        outlines[k, 0] = fits[m, k, :2]
        outlines[k, 1:] = shape.T
        half_x = math.sqrt(shape[0, 0] ** 2 + shape[0, 1] ** 2) + reach
        half_y = math.sqrt(shape[1, 0] ** 2 + shape[1, 1] ** 2) + reach
        x0 = min(x0, fits[m, k, 0] - half_x)
        x1 = max(x1, fits[m, k, 0] + half_x)
        y0 = min(y0, fits[m, k, 1] - half_y)
        y1 = max(y1, fits[m, k, 1] + half_y)
    return x0, x1, y0, y1


@njit()
def _reaching_in(
    optics: Any,
    fits: Array,
    m: int,
    window: tuple[float, float, float, float],
    places: Array,
    inverses: Array,
) -> int:
    """Markers of other pairs that reach into a window, and how many.

    `places` receives (x, y, squared radius of influence, layer) of each, `inverses` the inverse
    shapes behind the two of the pair itself.
    """
    shape = np.empty((2, 2))
    count = 0
    for other in optics.neighbours[m]:
        for k in range(2):
            x, y = fits[other, k, 0], fits[other, k, 1]
            _stretch(optics.shapes[k, other], fits[other, k], shape)
            radius = 0.8 * FIT_RANGE * optics.width + max(
                math.hypot(shape[0, 0], shape[1, 0]), math.hypot(shape[0, 1], shape[1, 1])
            )
            dx = max(window[0] - x, 0.0, x - window[1])
            dy = max(window[2] - y, 0.0, y - window[3])
            if dx * dx + dy * dy < radius * radius:
                _invert(shape, inverses[2 + count])
                places[count, 0], places[count, 1] = x, y
                places[count, 2], places[count, 3] = radius * radius, k
                count += 1
    return count


@njit()
def _normal_equations(
    image: NDArray[np.uint8],
    optics: Any,
    fit: Array,
    together: float,
    window: tuple[float, float, float, float],
    places: Array,
    inverses: Array,
    others: int,
    normal: Array,
    gradient: Array,
) -> float:
    """Information matrix and gradient of one pair at `fit`; returns the mean squared residual."""
    width, absorbed = optics.width, optics.absorbed
    reach, correction = FIT_RANGE * width, 0.5 * width * width
    jac, covered, light = np.zeros((2, 5)), np.zeros(2), np.empty(3)
    normal[:] = 0.0
    gradient[:] = 0.0
    squares, count = 0.0, 0
    for row in range(int(window[2]), int(window[3]) + 2):
        for col in range(int(window[0]), int(window[1]) + 2):
            informative = False
            for k in range(2):
                dx, dy = col - fit[k, 0], row - fit[k, 1]
                distance, gx, gy = signed_distance(dx, dy, inverses[k], correction)
                covered[k] = edge(distance / (EDGE_RANGE * width))
                slope = 0.0
                if abs(distance) < reach:
                    informative = True
                    slope = _GAUSS / width * math.exp(-0.5 * (distance / width) ** 2)
                # The edge moves outwards, against the gradient of the distance inside.
                jac[k, 0] = -slope * gx
                jac[k, 1] = -slope * gy
                jac[k, 2] = -slope * (gx * dx + gy * dy)
                jac[k, 3] = -slope * (gx * dx - gy * dy)
                jac[k, 4] = -slope * (gx * dy + gy * dx)
            if not informative:
                continue
            count += 1
            light[:] = optics.ground[row, col]
            for o in range(others):
                dx, dy = col - places[o, 0], row - places[o, 1]
                if dx * dx + dy * dy < places[o, 2]:
                    distance, _, _ = signed_distance(dx, dy, inverses[2 + o], correction)
                    shade = edge(distance / (EDGE_RANGE * width))
                    for ch in range(3):
                        light[ch] *= 1.0 - shade * absorbed[int(places[o, 3]), ch]
            c0, c1 = covered[0], covered[1]
            # See `togetherness`: both cover this, and change it so.
            both = (1.0 - together) * c0 * c1 + together * min(c0, c1)
            by0 = (1.0 - together) * c1 + (together if c0 < c1 else 0.0)
            by1 = (1.0 - together) * c0 + (together if c1 < c0 else 0.0)
            if c0 == c1:
                by0 += 0.5 * together
                by1 += 0.5 * together
            w00 = w01 = w11 = b0 = b1 = 0.0
            for ch in range(3):
                level = image[row, col, ch]
                a0, a1 = absorbed[0, ch], absorbed[1, ch]
                seen = 1.0 - a0 * c0 - a1 * c1 + a0 * a1 * both
                residual = optics.linear[level] - light[ch] * seen
                d0 = -light[ch] * a0 * (1.0 - a1 * by0)
                d1 = -light[ch] * a1 * (1.0 - a0 * by1)
                w = optics.weight[level]
                w00 += w * d0 * d0
                w01 += w * d0 * d1
                w11 += w * d1 * d1
                b0 += w * d0 * residual
                b1 += w * d1 * residual
                squares += w * residual * residual
            for i in range(5):
                gradient[i] += b0 * jac[0, i]
                gradient[5 + i] += b1 * jac[1, i]
                for j in range(i, 5):
                    normal[i, j] += w00 * jac[0, i] * jac[0, j]
                    normal[5 + i, 5 + j] += w11 * jac[1, i] * jac[1, j]
                for j in range(5):
                    normal[i, 5 + j] += w01 * jac[0, i] * jac[1, j]
    for i in range(10):
        for j in range(i):
            normal[i, j] = normal[j, i]
        # Keeps the matrix invertible where one layer is not there to be seen.
        normal[i, i] += 1e-6
    return squares / max(3 * count, 1)


@njit()
def _improve(fit: Array, step: Array) -> float:
    """Add a step, limited where it would leave the linear range; returns how far edges moved."""
    largest = 0.0
    for i in range(10):
        place = i % 5 < 2
        limit = 2.0 if place else 0.1
        change = min(max(step[i], -limit), limit)
        largest = max(largest, abs(change) if place else _RADIUS * abs(change))
        fit[i // 5, i % 5] += change
    return largest


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
    """Hue [°], −180…180, of the mean colour inside each magenta marker; NaN where it is lost.

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
        half_x = math.sqrt(shape[0, 0] ** 2 + shape[0, 1] ** 2)
        half_y = math.sqrt(shape[1, 0] ** 2 + shape[1, 1] ** 2)
        red = green = blue = 0.0
        for row in range(max(0, int(y - half_y)), min(height, int(y + half_y) + 2)):
            for col in range(max(0, int(x - half_x)), min(breadth, int(x + half_x) + 2)):
                dx, dy = col - x, row - y
                qx = inverse[0, 0] * dx + inverse[0, 1] * dy
                qy = inverse[1, 0] * dx + inverse[1, 1] * dy
                if qx * qx + qy * qy < 1.0:
                    red += image[row, col, 0]
                    green += image[row, col, 1]
                    blue += image[row, col, 2]
        hues[m] = math.degrees(
            math.atan2(math.sqrt(3.0) * (green - blue), 2.0 * red - green - blue)
        )
    return hues
