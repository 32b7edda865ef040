"""Spots of a dye in one picture: which pixels are a marker's, and where its middle is."""

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Indices = NDArray[np.intp]

#: Fainter dye is noise or dirt.
_FAINTEST = 0.15
#: Spots end at this share of the dye inside them; where they touch, at a larger one.
_EDGES = (0.5, 0.65, 0.8)
#: Of the dyed pixels, that percentile is well inside.
_INSIDE = 80.0
#: Markers' areas over the typical one: tilted, cut by the rim; stretched by a fisheye's rim.
_SMALLEST, _LARGEST = 0.35, 3.0
#: Markers are not longer than that many times their width.
_LONGEST = 2.5
#: The field's edge cuts off no more of one than a chord so long, in sides of a square as large.
_LONGEST_CUT = 0.6
#: Fewer pixels are no marker.
_FEWEST_PIXELS = 6
#: The blurred edge ends that far from a spot [px].
_REACH = 3.0
#: Weight of a pixel is 0 up to this coverage, 1 from as far below all of it: no noise of plain
#: ground or dye tells of the place.
_SOFT = 0.1


class Spots(NamedTuple):
    """Spots of one dye that are as markers are, n of them."""

    labels: NDArray[np.int32]  # (H, W) number of each pixel's spot from 1 on, 0 for none
    area: Array  # (n,) [px]
    density: float  # inside of them


def find_spots(density: Single, field: NDArray[np.bool_], parted: bool) -> Spots:
    """Connected dyed pixels of plausible size and shape.

    Parameters
    ----------
    density: of the dye, shape (H, W)
    field: where the sensor is, shape (H, W)
    parted: whether to look closer for spots that touch
    """
    # Specks of noise are no dye.
    clean: Any = cv2.medianBlur(density * field, 3)
    dyed = clean[clean > _FAINTEST]
    inside = float(np.percentile(dyed, _INSIDE)) if len(dyed) else 0.0
    found = [
        _plausible(clean, field, max(edge * inside, _FAINTEST))
        for edge in (_EDGES if parted else _EDGES[:1])
    ]
    # The lowest edge of those that find the most.
    best = max(found, key=lambda spots: len(spots[1]))
    return Spots(*best, density=inside)


def typical_area(areas: Array) -> float:
    """Area that half of all marked pixels lie in smaller spots than: blind to many specks."""
    if len(areas) == 0:
        return 0.0
    order = np.sort(areas)
    total = np.cumsum(order)
    return float(order[np.searchsorted(total, 0.5 * total[-1])])


def _plausible(
    density: Single, field: NDArray[np.bool_], least: float
) -> tuple[NDArray[np.int32], Array]:
    """Numbers of the pixels and areas of spots above a density that may be markers."""
    mask = (density > least).astype(np.uint8)
    labels: Any
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
    areas = stats[:, cv2.CC_STAT_AREA].astype(float)
    whole = areas >= _FEWEST_PIXELS
    whole[0] = False  # the background
    # What the edge of the field cuts has its middle elsewhere.
    inner = cv2.erode(field.astype(np.uint8), np.ones((3, 3)), borderValue=0)
    cut = np.bincount(labels[inner == 0], minlength=count)
    whole &= cut < _LONGEST_CUT * np.sqrt(areas)
    typical = typical_area(areas[whole])
    whole &= (areas > _SMALLEST * typical) & (areas < _LARGEST * typical)
    y, x = np.nonzero(mask)
    whole &= _length_to_width(labels[y, x], x, y, count) < _LONGEST
    number = (np.cumsum(whole) * whole).astype(np.int32)
    return number[labels], areas[whole]


def _length_to_width(
    label: NDArray[np.int32], x: NDArray[np.intp], y: NDArray[np.intp], count: int
) -> Array:
    """Ratio of the axes of each label's ellipse of inertia, shape (count,)."""

    def mean(value: Array) -> Array:
        return np.bincount(label, value, count) / np.maximum(np.bincount(label, None, count), 1)

    middle_x, middle_y = mean(x.astype(float)), mean(y.astype(float))
    dx, dy = x - middle_x[label], y - middle_y[label]
    # A pixel is itself a square.
    xx, yy, xy = mean(dx * dx) + 1.0 / 12.0, mean(dy * dy) + 1.0 / 12.0, mean(dx * dy)
    half, apart = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    return np.sqrt((half + apart) / np.maximum(half - apart, 1e-9))


def surroundings(spots: Spots) -> tuple[Indices, Indices]:
    """Pixels of spots and of their blurred edges, and the number of the nearest spot to each.

    Returns
    -------
    Indices into the raveled image, and numbers 0…n−1, both of shape (K,).
    """
    mask = spots.labels > 0
    distance, found = cv2.distanceTransformWithLabels(
        (~mask).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    nearest = np.asarray(found)
    number = np.zeros(int(mask.sum()) + 1, dtype=np.intp)
    number[nearest[mask]] = spots.labels[mask] - 1
    pixels: Indices = np.flatnonzero(np.asarray(distance) <= _REACH)
    return pixels, number[nearest.ravel()[pixels]]


def weigh(coverage: Single, pixels: Indices, number: Indices, count: int) -> tuple[Array, Array]:
    """Centroids (n, 2) [px] and areas (n,) [px²] of what markers cover of each pixel.

    Parameters
    ----------
    coverage: 0…1 but for noise, shape (H, W)
    pixels, number: of `surroundings`
    count: of markers, n
    """
    y, x = np.divmod(pixels, coverage.shape[1])
    share = coverage.ravel()[pixels].astype(float)
    # Never all zero, whatever the colours.
    weight = np.clip((share - _SOFT) / (1.0 - 2.0 * _SOFT), 1e-9, 1.0)
    total = np.bincount(number, weight, count)
    at = [np.bincount(number, weight * v, count) / total for v in (x, y)]
    area = np.asarray(np.bincount(number, share, count), dtype=float)
    return np.stack(at, axis=-1), area
