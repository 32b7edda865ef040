"""Spots of a dye in one picture: the pixels of each marker, and its centroid."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Indices = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True)
class SpotSettings:
    """Tuned parameters for finding the spots of a dye; areas are relative to the typical area.

    Attributes
    ----------
    faintest: smallest density of a spot; below it there is noise or dirt
    edges: thresholds of spots to try, as shares of the density inside; a larger one separates spots
        that touch
    inside: percentile of the dyed pixels' densities that is taken as the density inside
    smallest: smallest area of a marker, which may be tilted or cut by the rim
    largest: largest area, as the rim of a fisheye image is stretched
    longest: largest length of a marker over its width
    longest_cut: largest length along which the edge of the field cuts a marker, over the root of
        its area
    fewest_pixels: smallest area [px²]
    kinds: largest ratio of areas to the typical area, and of that to areas, of markers of further
        kinds
    compact: largest length of such a marker over its width
    further: smallest share of such markers, at least three
    reach: distance from a spot at which its blurred edge ends [px]
    soft: coverage up to which a pixel has weight 0; from 1 − soft on it has weight 1. So noise of
        plain ground and plain dye has no influence
    """

    faintest: float = 0.15
    edges: tuple[float, ...] = (0.5, 0.65, 0.8)
    inside: float = 80.0
    smallest: float = 0.35
    largest: float = 3.0
    longest: float = 2.5
    longest_cut: float = 0.6
    fewest_pixels: int = 6
    kinds: float = 25.0
    compact: float = 1.4
    further: float = 0.03
    reach: float = 3.0
    soft: float = 0.1


class Spots(NamedTuple):
    """n spots of one dye with the size and the shape of markers."""

    labels: NDArray[np.int32]  # (H, W) spot of each pixel, 1 to n; 0 for none
    area: Array  # (n,) areas of the spots [px²]
    density: float  # density of the dye inside the spots


def find_spots(
    density: Single,
    field: NDArray[np.bool_],
    parted: bool,
    seen: NDArray[np.bool_] | None = None,
    sizes: tuple[float, float] | None = None,
    settings: SpotSettings = SpotSettings(),
) -> Spots:
    """Find connected dyed pixels with the size and shape of markers.

    Parameters
    ----------
    density: density of the dye, shape (H, W)
    field: mask of the pixels that show the sensor, shape (H, W)
    parted: whether to separate spots that touch, with all thresholds of `settings.edges`
    seen: mask of the pixels of spots that repeat like markers, of any size, shape (H, W)
    sizes: areas of the smallest and the largest markers [px²]; by default they are typical
    settings: tuned parameters
    """
    # The median removes specks of noise.
    clean: Any = cv2.medianBlur(density * field, 3)
    dyed = clean[clean > settings.faintest]
    inside = float(np.percentile(dyed, settings.inside)) if len(dyed) else 0.0
    spots = [
        _plausible(clean, field, max(edge * inside, settings.faintest), seen, sizes, settings)
        for edge in (settings.edges if parted else settings.edges[:1])
    ]
    # The lowest of the thresholds that give the most spots.
    best = max(spots, key=lambda labels_areas: len(labels_areas[1]))
    return Spots(*best, density=inside)


def typical_area(areas: Array) -> float:
    """Median area of spots, weighted by area: small specks have little influence."""
    if len(areas) == 0:
        return 0.0
    order = np.sort(areas)
    total = np.cumsum(order)
    return float(order[np.searchsorted(total, 0.5 * total[-1])])


def _plausible(
    density: Single,
    field: NDArray[np.bool_],
    least: float,
    seen: NDArray[np.bool_] | None,
    sizes: tuple[float, float] | None,
    settings: SpotSettings,
) -> tuple[NDArray[np.int32], Array]:
    """Labels (H, W) and areas (n,) of the spots above density `least` that may be markers."""
    mask = (density > least).astype(np.uint8)
    labels: Any
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
    areas = stats[:, cv2.CC_STAT_AREA].astype(float)
    plausible = areas >= settings.fewest_pixels
    plausible[0] = False  # the background
    # The centroid of a spot that the edge of the field cuts is not the marker's.
    inner = cv2.erode(field.astype(np.uint8), np.ones((3, 3)), borderValue=0)
    cut = np.bincount(labels[inner == 0], minlength=count)
    plausible &= cut < settings.longest_cut * np.sqrt(areas)
    typical = typical_area(areas[plausible])
    low, high = (typical, typical) if sizes is None else sizes
    y, x = np.nonzero(mask)
    long = _length_to_width(labels[y, x], x, y, count)
    others = plausible & (cut == 0) & (long < settings.compact)
    plausible &= (areas > settings.smallest * low) & (areas < settings.largest * high)
    plausible &= long < settings.longest
    if seen is not None:
        others &= ~plausible & (np.bincount(labels[seen], minlength=count) > 0.5 * areas)
        others &= (areas * settings.kinds > typical) & (areas < settings.kinds * typical)
        if others.sum() >= max(3.0, settings.further * plausible.sum()):
            plausible |= others
    number = (np.cumsum(plausible) * plausible).astype(np.int32)
    return number[labels], areas[plausible]


def _length_to_width(
    label: NDArray[np.int32], x: NDArray[np.intp], y: NDArray[np.intp], count: int
) -> Array:
    """Axis ratio of the ellipse with each label's moments of inertia, shape (count,)."""

    def mean(value: Array) -> Array:
        return np.bincount(label, value, count) / np.maximum(np.bincount(label, None, count), 1)

    middle_x, middle_y = mean(x.astype(float)), mean(y.astype(float))
    dx, dy = x - middle_x[label], y - middle_y[label]
    # The inertia of a pixel itself, a square, is 1/12.
    xx, yy, xy = mean(dx * dx) + 1.0 / 12.0, mean(dy * dy) + 1.0 / 12.0, mean(dx * dy)
    half, apart = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    return np.sqrt((half + apart) / np.maximum(half - apart, 1e-9))


def surroundings(spots: Spots) -> tuple[Indices, Indices]:
    """Pixels of spots and their blurred edges, and the nearest spot to each.

    Returns
    -------
    Indices of K pixels in the flattened image, and indices of their spots 0…n−1, both (K,).
    """
    mask = spots.labels > 0
    distance, labels = cv2.distanceTransformWithLabels(
        (~mask).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    nearest = np.asarray(labels)
    number = np.zeros(int(mask.sum()) + 1, dtype=np.intp)
    number[nearest[mask]] = spots.labels[mask] - 1
    pixels: Indices = np.flatnonzero(np.asarray(distance) <= SpotSettings.reach)
    return pixels, number[nearest.ravel()[pixels]]


def weigh(
    coverage: Single,
    pixels: Indices,
    number: Indices,
    count: int,
    settings: SpotSettings = SpotSettings(),
) -> tuple[Array, Array, Array]:
    """Compute centroids (n, 2) [px], areas (n,) [px²] and shapes of markers from their coverage.

    A shape is the symmetric matrix that maps the unit circle to the ellipse with the marker's area
    and ratios of moments of inertia, (n, 2, 2) [px].

    Parameters
    ----------
    coverage: share of each pixel that is covered, 0…1 plus noise, shape (H, W)
    pixels, number: results of `surroundings`
    count: number n of markers
    settings: tuned parameters
    """
    y, x = (v.astype(float) for v in np.divmod(pixels, coverage.shape[1]))
    share = coverage.ravel()[pixels].astype(float)
    # The sum of the weights must never be zero.
    weight = np.clip((share - settings.soft) / (1.0 - 2.0 * settings.soft), 1e-9, 1.0)
    total = np.bincount(number, weight, count)

    def mean(values: Array) -> Array:
        return np.bincount(number, weight * values, count) / total

    at = np.stack([mean(x), mean(y)], axis=-1)
    area = np.asarray(np.bincount(number, share, count), dtype=float)
    x, y = x - at[number, 0], y - at[number, 1]
    xx, yy, xy = mean(x * x), mean(y * y), mean(x * y)
    # The root of a symmetric matrix C is (C + r·1)/√(tr C + 2 r), with r the root of det C.
    root = np.sqrt(np.maximum(xx * yy - xy * xy, 1e-12))
    shape = np.stack([xx + root, xy, xy, yy + root], axis=-1).reshape(-1, 2, 2)
    size = np.sqrt(np.maximum(area, 0.0) / np.pi / np.maximum(np.linalg.det(shape), 1e-12))
    return at, area, shape * size[:, None, None]
