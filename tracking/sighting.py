"""Detection of the marker pattern in a picture of any sensor, by properties that all markers share.

Markers are round spots with one sign of contrast and the size of their neighbours, on smoother
ground and at regular distances. Their colours and sizes and the sensor's position in the picture
need not be known. Surroundings, a frame, lamps or a label do not repeat like that.
"""

import itertools
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from ..errors import UserError
from .round_regions import RegionSettings, contrasts, round_regions

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]
_REGIONS = RegionSettings()


@dataclass(frozen=True, kw_only=True)
class SightSettings:
    """Tuned parameters of `sight`.

    Attributes
    ----------
    longest_side: longer side to which larger pictures are reduced [px]
    smallest_side: smallest allowed shorter side of a picture [px]
    regions: those of round regions
    faintest: smallest contrast of a spot [grey levels]
    as_large, as_strong: largest ratios of the areas and of the contrasts of neighbours
    kinds_large, kinds_furthest: the same ratio and distance where markers are of several kinds
    furthest: largest distance of neighbours [radii of the larger]
    neighbours: number of neighbours that are compared
    fewest: smallest number of markers of a pattern
    clear: smallest median of contrast over standard deviation of the light inside and around a spot
    uneven: largest standard deviation of the distance to the nearest neighbour over its mean;
        random points have 0.52
    uneven_dense: the same where spots are packed
    packed: largest distance of packed spots [radii], whose areas differ by `packed_size` at most
    unlike: largest standard deviation of the logarithm of the areas; random radii within a factor
        of two have 0.4
    row: smallest standard deviation of positions along the pattern's short axis [pitches]
    margin: distance between the outermost markers and the edge of the field [pitches], where the
        ground does not go on
    ground_reach: width over which ground further out is compared with that in the field [pitches]
    ground_alike: largest difference of ground further out, as a share of its level
    ground_rounding: what is added to it [grey levels]
    ground_least: smallest share of the field's ground in the mean that it is compared with
    """

    longest_side: int = 1280
    smallest_side: int = 16
    regions: RegionSettings = _REGIONS
    faintest: float = 8.0
    as_large: float = 4.5
    as_strong: float = 2.5
    kinds_large: float = 25.0
    kinds_furthest: float = 10.0
    furthest: float = 8.0
    neighbours: int = 8
    fewest: int = 11
    clear: float = 4.0
    uneven: float = 0.3
    uneven_dense: float = 0.12
    packed: float = 3.0
    packed_size: float = 1.5
    unlike: float = 0.65
    row: float = 0.6
    margin: float = 0.75
    ground_reach: float = 0.75
    ground_alike: float = 0.12
    ground_rounding: float = 4.0
    ground_least: float = 1e-3


class Spots(NamedTuple):
    """n spots of one channel that repeat like markers.

    Attributes
    ----------
    bright: whether they are brighter than the ground
    position: centres [px], shape (n, 2)
    area: areas [px²], shape (n,)
    clear: median contrast over the standard deviation of the light inside and around them
    pitch: typical distance to the nearest other spot [px]
    dense: whether there is hardly more ground than spots, so that more regular ones are wanted
    """

    bright: bool
    position: Array
    area: Array
    clear: float
    pitch: float
    dense: bool


@dataclass(frozen=True, kw_only=True)
class Sighting:
    """Location of a sensor and its marker pattern in a picture.

    Attributes
    ----------
    field: mask of pixels that show the sensor's markers and the ground around them, shape (H, W)
    bright: whether the markers are brighter than the ground
    spots: mask of pixels of the spots that were found, shape (H, W)
    position: centres of the n spots in the clearest channel [px], shape (n, 2)
    radius: radius of a typical spot [px]
    pitch: typical distance to the nearest other spot [px]
    """

    field: Mask
    spots: Mask
    bright: bool
    position: Array
    radius: float
    pitch: float


def sight(
    image: Image, within: Mask | None = None, settings: SightSettings = SightSettings()
) -> Sighting:
    """Find the markers of any sensor in a picture.

    Parameters
    ----------
    image: sRGB picture, shape (H, W, 3)
    within: mask of pixels to search; None: everywhere, shape (H, W)
    settings: tuned parameters

    Raises
    ------
    UserError
        When the picture shows no marker pattern.
    """
    if min(image.shape[:2]) < settings.smallest_side:
        raise UserError(
            f"the picture has {image.shape[1]}×{image.shape[0]} pixels; wanted: "
            f"{settings.smallest_side} or more a side"
        )
    scale = max(1.0, max(image.shape[:2]) / settings.longest_side)
    size = tuple(round(side / scale) for side in image.shape[1::-1])
    small = image
    if scale > 1.0:
        reduced = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        small = np.asarray(reduced, dtype=np.uint8)
    channels = _channels(small, settings.faintest)
    found = [spots for channel in channels for spots in _patterns(small, channel, settings)]
    if within is not None:
        found = [_inside(spots, within, scale) for spots in found]
    found = [s for s in found if _is_pattern(s, settings)]
    if not found:
        raise UserError("no regular marker pattern found in the picture")
    best = max(found, key=lambda s: len(s.area) * s.clear)
    best = next((s for s in found if _between(best, s)), best)
    alike = [s for s in found if s.bright == best.bright]
    middle, half = (scale - 1.0) / 2.0, settings.margin * best.pitch * scale
    places = np.concatenate([s.position * scale + middle for s in alike])
    radius = scale * np.sqrt(np.concatenate([s.area for s in alike]) / np.pi)
    field, spots = _around(places, half, image.shape[:2]), _discs(places, radius, image.shape[:2])
    field = _with_ground(image, field, spots, scale * best.pitch, settings)
    return Sighting(
        field=field if within is None else field & within,
        spots=spots,
        bright=best.bright,
        position=best.position * scale + middle,
        radius=scale * float(np.sqrt(np.median(best.area) / np.pi)),
        pitch=scale * best.pitch,
    )


def _channels(image: Image, faintest: float) -> list[int]:
    """Channels to search: all three, or one in a grey picture."""
    spread = np.percentile(np.ptp(image[::2, ::2].astype(np.int16), axis=2), 99.5)
    return [1] if spread < faintest else [0, 1, 2]


def _patterns(image: Image, channel: int, settings: SightSettings) -> list[Spots]:
    """Find the largest group of similar spots of each sign of contrast in a channel."""
    light = np.ascontiguousarray(image[..., channel])
    position, area = round_regions(light, settings.regions)
    packed = _packed(position, area, settings)
    found = []
    for dense, there in ((False, np.ones_like(packed)), (True, packed)):
        at, size = position[there], area[there]
        contrast, rough = contrasts(light, at, size, dense)
        for bright, kinds in itertools.product((False, True), (False,) if dense else (False, True)):
            some = contrast > settings.faintest if bright else contrast < -settings.faintest
            some[some] = _alike(at[some], size[some], abs(contrast[some]), kinds, settings)
            if kinds and some.any():
                some[some] = _of_a_kind(size[some])
            if some.sum() < settings.fewest:
                continue
            clear = float(np.median(abs(contrast[some]) / rough[some]))
            found.append(Spots(bright, at[some], size[some], clear, 0.0, dense))
    return [spots._replace(pitch=_pitch(spots.position)) for spots in found]


def _of_a_kind(areas: Array) -> Mask:
    """Mask (n,) of the spots between the smallest and the largest common size, if any is common."""
    kind = _kinds(areas)
    common = areas[kind >= 0] if kind.max() > 0 else np.zeros(1)
    return np.asarray((areas >= common.min()) & (areas <= common.max()))


def _kinds(areas: Array, gap: float = 1.4, few: float = 0.05) -> NDArray[np.intp]:
    """Kind 0, 1, … of the size of each of n spots, (n,); −1 for a size that hardly any other has.

    Parameters
    ----------
    gap: factor between areas between which there is no third, where a kind ends
    few: smallest share of the spots that are a kind, at least three
    """
    order = np.argsort(areas, kind="stable")
    kind = np.zeros(len(areas), dtype=np.intp)
    kind[order[1:]] = np.cumsum(np.diff(np.log(areas[order])) > np.log(gap))
    common = np.bincount(kind, minlength=1) >= max(3.0, few * len(areas))
    return np.where(common, np.cumsum(common) - 1, -1)[kind]


def _pitch(position: Array) -> float:
    """Median distance to the nearest other point [px]."""
    return float(np.median(_nearest(position)))


def _nearest(position: Array) -> Array:
    """Distance to the nearest other point (n,) of points (n, 2)."""
    return np.asarray(scipy.spatial.KDTree(position).query(position, k=2)[0])[:, 1]


def _near(position: Array, settings: SightSettings) -> tuple[Array, NDArray[np.intp]]:
    """Distances to the nearest other spots of n spots (n, 2), and their indices, both (n, K)."""
    near = min(settings.neighbours + 1, len(position))
    apart, other = scipy.spatial.KDTree(position).query(position, k=near)
    return np.asarray(apart)[:, 1:], np.asarray(other)[:, 1:]


def _packed(position: Array, area: Array, settings: SightSettings) -> Mask:
    """Mask (n,) of spots whose nearest one of their size is hardly further than their width."""
    if len(area) < 3:
        return np.zeros(len(area), dtype=bool)
    apart, other = _near(position, settings)
    close = apart < settings.packed * np.sqrt(area / np.pi)[:, None]
    close &= abs(np.log(area[:, None] / area[other])) < np.log(settings.packed_size)
    return np.asarray(close.any(axis=1))


def _between(spots: Spots, other: Spots) -> bool:
    """Whether spots are but what is seen of the ground between larger ones."""
    if spots.bright == other.bright or np.median(spots.area) >= np.median(other.area):
        return False
    apart = np.asarray(scipy.spatial.KDTree(other.position).query(spots.position)[0])
    return bool(np.median(apart) < 1.1 * np.sqrt(0.5) * other.pitch)


def _is_pattern(spots: Spots, settings: SightSettings) -> bool:
    """Whether spots have clear contrast, regular distances and similar sizes, and cover an area."""
    if len(spots.area) < settings.fewest or spots.clear < settings.clear:
        return False
    apart = _nearest(spots.position)
    # Markers cover a surface; letters stand in a row.
    narrow = np.sqrt(np.linalg.eigvalsh(np.cov(spots.position.T))[0])
    even = apart.std() < (settings.uneven_dense if spots.dense else settings.uneven) * apart.mean()
    kind, size = _kinds(spots.area), np.log(spots.area)
    means = [size[kind == k].mean() for k in range(kind.max() + 1)]
    even = even and (size - np.append(means, size.mean())[kind]).std() < settings.unlike
    return bool(even and narrow > settings.row * spots.pitch)


def _inside(spots: Spots, within: Mask, scale: float) -> Spots:
    """Keep the spots within a mask of the full-size picture."""
    x, y = np.rint(spots.position * scale).astype(int).T
    some = within[np.clip(y, 0, len(within) - 1), np.clip(x, 0, within.shape[1] - 1)]
    if some.sum() < 2:
        return spots._replace(position=np.empty((0, 2)), area=np.empty(0))
    position = spots.position[some]
    return spots._replace(position=position, area=spots.area[some], pitch=_pitch(position))


def _alike(
    position: Array, area: Array, contrast: Array, kinds: bool, settings: SightSettings
) -> Mask:
    """Mask (n,) of the largest group of spots that are linked by similarity to neighbours."""
    count = len(area)
    if count < settings.fewest:
        return np.zeros(count, dtype=bool)
    apart, other = _near(position, settings)
    radius = np.sqrt(area / np.pi)
    as_large = settings.kinds_large if kinds else settings.as_large
    furthest = settings.kinds_furthest if kinds else settings.furthest
    near = apart < furthest * np.maximum(radius[:, None], radius[other])
    for value, factor in ((area, as_large), (contrast, settings.as_strong)):
        near &= abs(np.log(value[:, None] / value[other])) < np.log(factor)
    one = np.broadcast_to(np.arange(count)[:, None], other.shape)
    links = scipy.sparse.csr_matrix(
        (np.ones(near.sum()), (one[near], other[near])), shape=(count, count)
    )
    _, group = scipy.sparse.csgraph.connected_components(links, directed=False)
    largest: Mask = group == np.bincount(group).argmax()
    return largest


def _discs(position: Array, radius: Array, shape: tuple[int, ...]) -> Mask:
    """Mask of pixels inside discs, shape (H, W)."""
    drawn = np.zeros((shape[0], shape[1]), dtype=np.uint8)
    for (x, y), r in zip(position, radius, strict=True):
        cv2.circle(drawn, (round(x), round(y)), max(1, round(1.4 * r)), 1, -1)
    return drawn > 0


def _with_ground(
    image: Image, field: Mask, spots: Mask, pitch: float, settings: SightSettings
) -> Mask:
    """Field and the ground around it that looks like its own, on which markers may move.

    A housing, a frame or a table looks otherwise, or lies behind something that does.
    """
    # The comparison is of smooth light: a coarse picture is enough.
    step = max(1, int(pitch / 8.0))
    size = (image.shape[1] // step, image.shape[0] // step)
    small = cv2.resize(cv2.blur(image, (3, 3)), size, interpolation=cv2.INTER_AREA)
    light = np.asarray(small, dtype=np.float32)
    inner, dark = (
        np.asarray(cv2.resize(one.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)) > 0
        for one in (field, spots)
    )
    plain = (inner & ~dark).astype(np.float32)
    reach = settings.ground_reach * pitch / step
    share: Any = cv2.GaussianBlur(plain, (0, 0), reach)
    ground: Any = cv2.GaussianBlur(light * plain[..., None], (0, 0), reach)
    ground /= np.maximum(share, 1e-6)[..., None]
    off = abs(light - ground).max(axis=2)
    alike = off < settings.ground_alike * ground.max(axis=2) + settings.ground_rounding
    alike &= share > settings.ground_least
    grown = (alike | inner).astype(np.uint8)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 3))
    opened = np.asarray(cv2.morphologyEx(grown, cv2.MORPH_OPEN, kernel)) > 0
    grown = (opened | inner).astype(np.uint8)
    _, part = cv2.connectedComponents(grown, connectivity=4)
    joined = np.isin(part, np.unique(np.asarray(part)[inner])) & (grown > 0)
    wide: Any = cv2.resize(joined.astype(np.uint8), image.shape[1::-1])
    return field | (wide > 0)


def _around(position: Array, reach: float, shape: tuple[int, ...]) -> Mask:
    """Mask of pixels within reach of points, with gaps between them closed, shape (H, W)."""
    away = np.ones((shape[0], shape[1]), dtype=np.uint8)
    x, y = np.rint(position).astype(int).T
    away[np.clip(y, 0, shape[0] - 1), np.clip(x, 0, shape[1] - 1)] = 0
    # Close gaps by growing and shrinking, on a padded picture.
    pad = int(2.0 * reach) + 2
    away = np.pad(away, pad, constant_values=1)
    near = np.asarray(cv2.distanceTransform(away, cv2.DIST_L2, 5)) < 2.0 * reach
    grown = np.asarray(cv2.distanceTransform(near.astype(np.uint8), cv2.DIST_L2, 5)) > reach
    return np.asarray(grown[pad:-pad, pad:-pad])
