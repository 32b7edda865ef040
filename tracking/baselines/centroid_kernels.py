"""Compiled weighted centroids of the dyes' coverage. `centroid.py` documents the use.

Light over the ground's is 1 − a₀C₀ − a₁C₁ + a₀a₁C₀₁, a being what a dye absorbs and C the share
of a blurred pixel that it covers. C₀₁, what both cover, is about the smaller of the two: edges of a
pair run side by side. Light is then linear in both, once it is known which is the smaller. What it
is less where edges cross (`togetherness`) is taken off afterwards.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit
from ...render.drawing.coverage import SIDE_BY_SIDE, covered_by_both, togetherness

Array = NDArray[np.float64]
Single = NDArray[np.float32]

#: Weight of a pixel is 0 up to this share of a marker's coverage, 1 from as far below all of it.
SOFT = 0.12
#: Windows are laid anew while a marker lies further from where it was looked for [px], so often.
MOVED, PASSES = 0.5, 8
#: Light of the ground differs from its mean by less than this share, as found in so many rounds.
PLAIN, ROUNDS = 0.15, 3
#: Markers cover their middles by this share at least, and have these areas over that at rest.
LEAST_COVER = 0.25
SMALLEST, LARGEST = 0.5, 2.0
#: A middle that lost more than this of its cover is perhaps not the middle.
FADED = 0.7
#: What fills the disc around a marker by more than this share is none.
FULL = 0.9


class Windows(NamedTuple):
    """What is fixed with the rest frame; radii count from a marker's middle, per layer."""

    linear: Single  # (256,) linear light of each level
    noise: Single  # (256,) variance of that light
    ground: Single  # (H, W, 3) 1 over the linear light of the unmarked skin
    # (2, 2, 3) coverage of both layers by 1 − light, where the first covers less, then where more.
    unmixing: Single
    crossing: Single  # (2, 2) what coverage by that is too much by, over what C₀₁ is too much by
    bright: bool  # markers are brighter than the ground
    radius: Array  # (L,) of the marker [px]
    core: Array  # (L,) of the marker's middle [px]
    reach: Array  # (L,) of what its blurred edge does not reach beyond [px]
    margin: int  # of ground beyond that [px]
    side: int  # windows are not wider than this [px]
    near: NDArray[np.intp]  # (M, K) numbers near each number


@njit()
def weigh_markers(
    image: NDArray[np.uint8],
    windows: Any,
    area: Array,
    cover: Array,
    expected: Array,
    place: Array,
    size: Array,
    covariance: Array,
) -> None:
    """Centroids of all markers near their expected places.

    Parameters
    ----------
    image: sRGB, shape (H, W, 3)
    windows: see Windows
    area: at rest [px²], shape (L, M); NaN where it is not known
    cover: of each marker's middle, in the last frame and result, shape (L, M)
    expected: places [px], shape (L, M, 2)
    place: result [px], shape (L, M, 2); NaN where lost
    size: result, area [px²], shape (L, M)
    covariance: result, of (x, y, ln √area) of all layers, shape (M, 3L, 3L)
    """
    layers, count, _ = place.shape
    side = windows.side
    light = np.empty((3, side, side), dtype=np.float32)
    covered = np.empty((2, side, side), dtype=np.float32)
    weight = np.empty((layers, side, side), dtype=np.float32)
    plain = np.empty((side * side, 3), dtype=np.float32)
    # Left, top, width and height of the window.
    box = np.empty(4, dtype=np.int64)
    # Gain of each channel, and its variance.
    gain = np.empty((2, 3), dtype=np.float32)
    # Of each layer: slope of the weights over coverage, their sum, the middle's cover, and the
    # variance of ln √area by the noise of ground and middle.
    sums = np.empty((layers, 4))
    middle = np.empty((layers, 2))
    for m in range(count):
        middle[:] = expected[:, m]
        sums[:] = 0.0
        sums[:, 2] = cover[:, m]
        moved = np.inf
        for _ in range(PASSES):
            if not _lay(image, windows, middle, box):
                moved = np.inf
                break
            _look(image, windows, middle, sums[:, 2], box, light, plain, gain, covered)
            moved = 0.0
            for k in range(layers):
                if math.isfinite(middle[k, 0]):
                    _exclude(windows, k, m, expected, box, covered[k])
                    step = _weigh(windows, k, box, covered[k], gain, middle[k], weight[k], sums[k])
                    moved = max(moved, step)
            if not moved > MOVED:
                break
        for k in range(layers):
            share = sums[k, 1] / area[k, m]
            full = sums[k, 1] > FULL * math.pi * windows.reach[k] ** 2
            good = moved <= MOVED and sums[k, 2] > LEAST_COVER and not full
            if good and not (share < SMALLEST or share > LARGEST):
                place[k, m] = middle[k]
                cover[k, m] = sums[k, 2]
            else:
                place[k, m] = np.nan
            size[k, m] = sums[k, 1]
        _propagate(image, windows, place[:, m], box, covered, weight, gain, sums, covariance[m])


@njit()
def _lay(image: NDArray[np.uint8], windows: Any, middle: Array, box: Any) -> bool:
    """Lay the window around all of a number's layers; whether it fits, and is in the image."""
    x0, x1, y0, y1 = np.inf, -np.inf, np.inf, -np.inf
    for k in range(middle.shape[0]):
        if math.isfinite(middle[k, 0]):
            around = windows.reach[k] + windows.margin
            x0, x1 = min(x0, middle[k, 0] - around), max(x1, middle[k, 0] + around)
            y0, y1 = min(y0, middle[k, 1] - around), max(y1, middle[k, 1] + around)
    if not (x0 >= 0.0 and y0 >= 0.0 and x1 < image.shape[1] - 1 and y1 < image.shape[0] - 1):
        return False
    box[0], box[1] = int(x0), int(y0)
    box[2], box[3] = int(x1) + 2 - box[0], int(y1) + 2 - box[1]
    return box[2] <= windows.side and box[3] <= windows.side


@njit()
def _look(
    image: NDArray[np.uint8],
    windows: Any,
    middle: Array,
    cover: Array,
    box: Any,
    light: Any,
    plain: Any,
    gain: Any,
    covered: Any,
) -> None:
    """Coverage by both layers of every pixel in a window, against the ground in it."""
    left, top, wide, high = box
    linear = windows.linear
    levels = image[top : top + high, left : left + wide]
    ground = windows.ground[top : top + high, left : left + wide]
    for i in range(high):
        for j in range(wide):
            light[0, i, j] = linear[levels[i, j, 0]] * ground[i, j, 0]
            light[1, i, j] = linear[levels[i, j, 1]] * ground[i, j, 1]
            light[2, i, j] = linear[levels[i, j, 2]] * ground[i, j, 2]
    number = 0
    for i in range(high):
        # Every other pixel tells enough.
        for j in range(i % 2, wide, 2):
            outside = True
            for k in range(middle.shape[0]):
                dx, dy = left + j - middle[k, 0], top + i - middle[k, 1]
                outside &= not dx * dx + dy * dy < windows.reach[k] ** 2
            if outside:
                for ch in range(3):
                    plain[number, ch] = light[ch, i, j]
                number += 1
    _ground(plain[:number], windows.bright, gain)
    r, g, b = np.float32(1.0) / gain[0]
    u, crossing = windows.unmixing, windows.crossing
    zero, one = np.float32(0.0), np.float32(1.0)
    # In markers whose contrast is lost, all of this is less.
    whole0, whole1 = np.float32(cover[0]), np.float32(cover[-1])
    odds = np.float32(_togetherness(windows, middle))
    for i in range(high):
        for j in range(wide):
            dr, dg, db = (
                one - r * light[0, i, j],
                one - g * light[1, i, j],
                one - b * light[2, i, j],
            )
            less = u[0, 0, 0] * dr + u[0, 0, 1] * dg + u[0, 0, 2] * db
            more = u[0, 1, 0] * dr + u[0, 1, 1] * dg + u[0, 1, 2] * db
            first = u[1, 0, 0] * dr + u[1, 0, 1] * dg + u[1, 0, 2] * db
            second = u[1, 1, 0] * dr + u[1, 1, 1] * dg + u[1, 1, 2] * db
            c0 = less if less < more else first
            c1 = more if less < more else second
            p0, p1 = min(max(c0 / whole0, zero), one), min(max(c1 / whole1, zero), one)
            excess = whole0 * (min(p0, p1) - covered_by_both(p0, p1, odds))
            covered[0, i, j] = c0 - excess * (crossing[0, 0] if c0 < c1 else crossing[1, 0])
            covered[1, i, j] = c1 - excess * (crossing[0, 1] if c0 < c1 else crossing[1, 1])


@njit()
def _togetherness(windows: Any, middle: Array) -> float:
    """How much the edges of two layers go together where they cross."""
    if middle.shape[0] < 2 or not math.isfinite(middle[0, 0] + middle[1, 0]):
        return SIDE_BY_SIDE
    outlines = np.zeros((2, 3, 2))
    for k in range(2):
        outlines[k, 0] = middle[k]
        outlines[k, 1, 0] = outlines[k, 2, 1] = windows.radius[k]
    return togetherness(outlines[0], outlines[1])


@njit()
def _ground(around: Any, bright: bool, gain: Any) -> None:
    """Mean light of those pixels that are the ground's, per channel, and its variance."""
    limit = np.full(3, np.inf if bright else -np.inf, dtype=np.float32)
    for _ in range(ROUNDS):
        total, squares, number = np.zeros(3), np.zeros(3), 0
        for n in range(around.shape[0]):
            r, g, b = around[n]
            if bright:
                ground = r <= limit[0] and g <= limit[1] and b <= limit[2]
            else:
                ground = r >= limit[0] and g >= limit[1] and b >= limit[2]
            if ground:
                number += 1
                for ch in range(3):
                    total[ch] += around[n, ch]
                    squares[ch] += around[n, ch] ** 2
        for ch in range(3):
            mean = total[ch] / number
            gain[0, ch] = mean
            gain[1, ch] = max(squares[ch] / number - mean * mean, 0.0) / number
            limit[ch] = mean * (1.0 + PLAIN if bright else 1.0 - PLAIN)


@njit()
def _exclude(windows: Any, k: int, m: int, expected: Array, box: Any, covered: Any) -> None:
    """Clear what is nearer to a neighbour than to the marker itself, where one reaches in."""
    x, y = expected[k, m]
    for other in windows.near[m]:
        dx, dy = expected[k, other, 0] - x, expected[k, other, 1] - y
        apart = math.sqrt(dx * dx + dy * dy)
        if 0.0 < apart < 2.0 * windows.reach[k]:
            for i in range(box[3]):
                for j in range(box[2]):
                    if (box[0] + j - x) * dx + (box[1] + i - y) * dy > 0.5 * apart * apart:
                        covered[i, j] = 0.0


@njit()
def _weigh(
    windows: Any, k: int, box: Any, covered: Any, gain: Any, middle: Array, weight: Any, sums: Array
) -> float:
    """Weights and sums of one marker; moves its middle and returns how far, NaN for nowhere."""
    left, top, wide, high = box
    x, y = middle
    core, total, squares, number = windows.core[k], 0.0, 0.0, 0
    for i in range(int(y - core) + 1 - top, int(y + core) + 1 - top):
        for j in range(int(x - core) + 1 - left, int(x + core) + 1 - left):
            total += covered[i, j]
            squares += covered[i, j] ** 2
            number += 1
    cover = total / number
    used = sums[2] if cover < FADED * sums[2] else cover
    slope = 1.0 / (used * (1.0 - 2.0 * SOFT))
    zero, one = np.float32(0.0), np.float32(1.0)
    steep, start = np.float32(slope), np.float32(SOFT * used * slope)
    reach = np.float32(windows.reach[k] ** 2)
    from_x, from_y = np.float32(left - x), np.float32(top - y)
    columns, moments = np.zeros(wide, dtype=np.float32), np.zeros(wide, dtype=np.float32)
    for i in range(high):
        dy = from_y + np.float32(i)
        for j in range(wide):
            dx = from_x + np.float32(j)
            w = min(max(steep * covered[i, j] - start, zero), one)
            w = w if dx * dx + dy * dy < reach else zero
            weight[i, j] = w
            columns[j] += w
            moments[j] += w * dy
    area = sum_x = sum_y = 0.0
    for j in range(wide):
        area += columns[j]
        sum_x += columns[j] * (from_x + j)
        sum_y += moments[j]
    if not area > 0.0:
        return np.nan
    sum_x /= area
    sum_y /= area
    middle[0] = x + sum_x
    middle[1] = y + sum_y
    sums[0], sums[1], sums[2] = slope, area, cover
    core_variance = max(squares / number - cover * cover, 0.0) / number
    sums[3] = core_variance
    moved = math.sqrt(sum_x * sum_x + sum_y * sum_y)
    return moved if used == cover else max(moved, 2.0 * MOVED)


@njit()
def _propagate(
    image: NDArray[np.uint8],
    windows: Any,
    place: Array,
    box: Any,
    covered: Any,
    weight: Any,
    gain: Any,
    sums: Array,
    covariance: Array,
) -> None:
    """Covariance of one number's layers by the noise of pixels on the slopes, ground and middle."""
    layers = place.shape[0]
    covariance[:] = 0.0
    # Of the noise of two layers' weights: sums of 1, x, y, x², xy, y², from the window's corner.
    moments = np.zeros((layers, layers, 6))
    rate, slopes = np.zeros(layers), sums[:, 0] / sums[:, 1]
    # Derivatives of ln √area by the gains and by the covers of the middles.
    by_gain, by_cover = np.zeros((layers, 3)), np.zeros(layers)
    variances, light = np.empty(3), np.empty(3)
    left, top, wide, high = box
    levels = image[top : top + high, left : left + wide]
    ground = windows.ground[top : top + high, left : left + wide]
    for i in range(high):
        # Every other pixel tells enough, and counts twice.
        for j in range(i % 2, wide, 2):
            touched = False
            for k in range(layers):
                rate[k] = slopes[k] if 0.0 < weight[k, i, j] < 1.0 else 0.0
                touched |= rate[k] > 0.0
            if not touched:
                continue
            case = 0 if covered[0, i, j] < covered[1, i, j] else 1
            for ch in range(3):
                level = levels[i, j, ch]
                by_light = ground[i, j, ch] / gain[0, ch]
                variances[ch] = windows.noise[level] * by_light * by_light
                light[ch] = windows.linear[level] * by_light / gain[0, ch]
            for k in range(layers):
                if rate[k] == 0.0:
                    continue
                by_cover[k] -= rate[k] * covered[k, i, j] / sums[k, 2]
                for ch in range(3):
                    by_gain[k, ch] += rate[k] * windows.unmixing[case, k, ch] * light[ch]
                for n in range(k, layers):
                    v = 0.0
                    for ch in range(3):
                        v += (
                            variances[ch]
                            * windows.unmixing[case, k, ch]
                            * windows.unmixing[case, n, ch]
                        )
                    v *= 2.0 * rate[k] * rate[n]
                    moments[k, n, 0] += v
                    moments[k, n, 1] += v * j
                    moments[k, n, 2] += v * i
                    moments[k, n, 3] += v * j * j
                    moments[k, n, 4] += v * i * j
                    moments[k, n, 5] += v * i * i
    for k in range(layers):
        xk, yk = place[k, 0] - left, place[k, 1] - top
        for n in range(k, layers):
            xn, yn = place[n, 0] - left, place[n, 1] - top
            one, x, y, xx, xy, yy = moments[k, n]
            block = covariance[3 * k : 3 * k + 3, 3 * n : 3 * n + 3]
            block[0, 0] = xx - (xk + xn) * x + xk * xn * one
            block[0, 1] = xy - xk * y - yn * x + xk * yn * one
            block[1, 0] = xy - yk * x - xn * y + yk * xn * one
            block[1, 1] = yy - (yk + yn) * y + yk * yn * one
            # ln √area changes by half of what ln area does.
            block[0, 2], block[2, 0] = 0.5 * (x - xk * one), 0.5 * (x - xn * one)
            block[1, 2], block[2, 1] = 0.5 * (y - yk * one), 0.5 * (y - yn * one)
            block[2, 2] = 0.25 * one
            for ch in range(3):
                block[2, 2] += by_gain[k, ch] * by_gain[n, ch] * gain[1, ch]
        covariance[3 * k + 2, 3 * k + 2] += by_cover[k] ** 2 * sums[k, 3]
    for a in range(3 * layers):
        for b in range(a):
            covariance[a, b] = covariance[b, a]
        if not math.isfinite(place[a // 3, 0]):
            covariance[a] = np.nan
            covariance[:, a] = np.nan
