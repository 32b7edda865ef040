"""Round regions of a picture that look like spots, of any size and contrast."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class RegionSettings:
    """Tuned parameters of `round_regions`.

    Attributes
    ----------
    calm: blur before regions are searched, so that noise does not split them [px]
    stable: number of grey levels over which a region must be stable
    smallest_pixels: smallest area of a marker [px²]
    largest_share: largest share of the picture that a marker covers
    filled: smallest area of a region over that of its ellipse of inertia
    longest: largest ratio of the axes of that ellipse
    same_centre: distance below which regions are one spot at several thresholds [radii]
    same_area: factor between the areas of such regions
    """

    calm: float = 0.7
    stable: int = 6
    smallest_pixels: int = 9
    largest_share: float = 1.0 / 25.0
    filled: float = 0.87
    longest: float = 2.5
    same_centre: float = 0.6
    same_area: float = 2.5


def round_regions(light: Image, settings: RegionSettings) -> tuple[Array, Array]:
    """Centres (n, 2) and areas (n,) of n round regions that are stable over thresholds (MSER)."""
    least = 3  # pixels in a row or column that MSER takes
    if min(light.shape) < least:
        return np.empty((0, 2)), np.empty(0)
    calm = np.asarray(cv2.GaussianBlur(light, (0, 0), settings.calm))
    largest = int(settings.largest_share * light.size)
    # OpenCV 4 ignores the least diversity of nested regions, 5 does not: `_unnested` thins them.
    mser = cv2.MSER.create(settings.stable, settings.smallest_pixels, largest, 0.5, 0.0)
    regions: Any = mser.detectRegions(calm)[0]
    if len(regions) == 0:
        return np.empty((0, 2)), np.empty(0)
    area = np.array([len(region) for region in regions], dtype=float)
    # Some regions at once: nested ones have many times the picture's pixels.
    starts = np.flatnonzero(np.diff(np.cumsum(area) // 1e6, prepend=-1.0))
    bounds = itertools.pairwise([*starts, len(area)])
    ways = [_ellipses(regions[i:j]) for i, j in bounds]
    centre, (long, short) = np.concatenate([w[0] for w in ways]), np.hstack([w[1] for w in ways])
    filled = area > settings.filled * 4.0 * np.pi * np.sqrt(long * short)
    round_ = filled & (long < settings.longest**2 * short)
    centre, area = centre[round_], area[round_]
    kept = _unnested(centre, area, settings)
    return centre[kept], area[kept]


def _ellipses(regions: Any) -> tuple[Array, Array]:
    """Centres (n, 2) of regions, and inertia along both axes of their ellipses (2, n)."""
    area = np.array([len(region) for region in regions])
    first = np.cumsum(area) - area
    x, y = np.concatenate(regions).T.astype(np.int64)
    # Sums of whole numbers are exact.
    mean_x, mean_y, xx, yy, xy = (
        np.add.reduceat(v, first) / area for v in (x, y, x * x, y * y, x * y)
    )
    # The inertia of a pixel itself, a square, is 1/12.
    xx, yy, xy = xx - mean_x**2 + 1.0 / 12.0, yy - mean_y**2 + 1.0 / 12.0, xy - mean_x * mean_y
    middle, apart = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    centre = np.stack([mean_x, mean_y], axis=-1)
    return centre, np.stack([middle + apart, np.maximum(middle - apart, 1e-9)])


def _unnested(centre: Array, area: Array, settings: RegionSettings) -> list[int]:
    """Indices of one region per spot: of nested regions the one of median area."""
    if len(area) == 0:
        return []
    tree, radius = scipy.spatial.KDTree(centre), np.sqrt(area / np.pi)
    around = tree.query_ball_point(centre, settings.same_centre * radius)
    used, kept = np.zeros(len(area), dtype=bool), []
    for i in np.argsort([-len(near) for near in around], kind="stable"):
        if used[i]:
            continue
        near = np.array([j for j in around[i] if not used[j]])
        same = near[abs(np.log(area[near] / area[i])) < np.log(settings.same_area)]
        used[near] = True
        kept.append(int(same[np.argsort(area[same], kind="stable")[len(same) // 2]]))
    return kept


def contrasts(light: Image, position: Array, area: Array, dense: bool) -> tuple[Array, Array]:
    """Mean level inside spots minus that around them, and its deviation, (n,) [grey levels].

    What is around `dense` ones is mostly others; then what differs most is the ground.
    """
    contrast, rough, radius = np.zeros(len(area)), np.ones(len(area)), np.sqrt(area / np.pi)
    reach = (1.8 * radius + 3.0).astype(int)
    around, outside = int(reach.max(initial=0)), 256  # level of what is not in the picture
    padded = np.pad(light.astype(np.int16), around, constant_values=outside)
    for spots in _parts(reach):
        own, side = radius[spots, None], np.arange(-reach[spots[0]], reach[spots[0]] + 1)
        middle = position[spots].astype(int)
        (cols, rows), (x, y) = middle.T[..., None] + side, position[spots].T[..., None]
        level = padded[rows[..., None] + around, cols[:, None] + around].reshape(len(spots), -1)
        apart = np.hypot((cols - x)[:, None], (rows - y)[..., None]).reshape(level.shape)
        inside = (apart < 0.7 * own + 0.5) & (level < outside)
        near = own + 0.5 if dense else 1.35 * own + 1.0
        beside = (apart > near) & (apart < 1.8 * own + 2.0) & (level < outside)
        count = beside.sum(axis=1)
        order, each = np.sort(np.where(beside, level, outside), axis=1), np.arange(len(spots))
        mean, spread = _moments(level, inside)
        if dense:
            low, high = order[each, count // 10], order[each, count - 1 - count // 10]
            ground = np.where(high - mean > mean - low, high, low).astype(float)
            beside &= 4.0 * abs(level - ground[:, None]) < abs(mean - ground)[:, None]
        else:
            ground = 0.5 * (order[each, np.maximum(count - 1, 0) // 2] + order[each, count // 2])
        ground_spread = _moments(level, beside)[1]
        contrast[spots] = np.where(count > 0, mean - ground, 0.0)
        # Rounding is noise too.
        noisy = np.sqrt(0.5 * (spread + ground_spread) + 1.0)
        rough[spots] = np.where(count > 0, noisy, 1.0)
    return contrast, rough


def _parts(reach: NDArray[np.intp]) -> Iterator[NDArray[np.intp]]:
    """Indices of spots with windows of one size, as many as are read at once."""
    for one in np.unique(reach):
        alike = np.flatnonzero(reach == one)
        yield from np.array_split(alike, 1 + len(alike) * (2 * one + 1) ** 2 // 1_000_000)


def _moments(level: NDArray[np.int16], some: Mask) -> tuple[Array, Array]:
    """Mean and variance of some of the levels in each of n windows, (n,)."""
    count, value = np.maximum(some.sum(axis=1), 1), np.where(some, level, 0).astype(float)
    mean = value.sum(axis=1) / count
    return mean, (value**2).sum(axis=1) / count - mean**2
