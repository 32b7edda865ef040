"""Measurement of the markers whose spots were found: centroid, area, shape and hue."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .palette import Palette
from .spots import Spots, SpotSettings, surroundings, weigh
from .unmixing import DARKEST, dye_coverages, linear_light

Array = NDArray[np.float64]
Single = NDArray[np.float32]
#: sRGB levels: of one picture, or the mean of many.
Levels = NDArray[np.uint8] | Array
_SPOTS = SpotSettings()


@dataclass(frozen=True, kw_only=True)
class Markers:
    """n markers of one layer in one picture.

    Attributes
    ----------
    position: centroids of the covered areas [px], shape (n, 2)
    area: covered areas [px²], shape (n,)
    shape: matrices that map the unit circle to each marker's ellipse [px], shape (n, 2, 2)
    hue: hues of the mean colours inside [°], −180…180; NaN for grey, shape (n,)
    """

    position: Array
    area: Array
    shape: Array
    hue: Array


def over_ground(linear: Single, ground: Single, field: NDArray[np.bool_]) -> Single:
    """Linear light over that of the ground, 1 off the skin."""
    return np.where(field[..., None], linear / np.maximum(ground, 1e-4), np.float32(1.0))


def measured_in_strips(
    image: NDArray[np.uint8],
    spots: list[Spots],
    ground: Single,
    field: NDArray[np.bool_],
    palette: Palette,
) -> list[Markers]:
    """Markers of spots that were found in a reduced picture, measured in a larger one."""
    times, height, rows, around = len(image) // len(field), len(field), 96, 8
    # The edge of a spot is known to half a pixel of the reduced picture.
    settings = SpotSettings(reach=SpotSettings.reach + 0.5 * times)
    ends = [_rows_of(layer) for layer in spots]
    tall = max(int((last - first).max(initial=0)) for first, last in ends)
    found: list[list[tuple[Array, ...]]] = [[] for _ in spots]
    # Strips with all of the spots that begin in them, so that little memory is used.
    for top in range(0, height, rows):
        part = slice(max(0, top - around), min(height, top + rows + tall + around))
        here = image[times * part.start : times * part.stop]
        size = here.shape[1::-1]
        own_ground: Any = cv2.resize(ground[part], size, interpolation=cv2.INTER_LINEAR)
        light = linear_light(here) + np.float32(DARKEST if palette.bright else 0.0)
        ratio = over_ground(light, own_ground, _magnified(field[part], times))
        parts = [_part_of(layer, _magnified(layer.labels[part], times)) for layer in spots]
        found_here = measured([one for one, _ in parts], here, ratio, palette, settings)
        offset = np.array([0.0, times * part.start])
        for own, (_, number), (first, _), each in zip(found, parts, ends, found_here, strict=True):
            begun = (first[number] >= top) & (first[number] < top + rows)
            values = (each.position + offset, each.area, each.shape, each.hue)
            own.append(tuple(value[begun] for value in values))
    whole = [tuple(map(np.concatenate, zip(*own, strict=True))) for own in found]
    return [
        Markers(position=position, area=area, shape=shape, hue=hue)
        for position, area, shape, hue in whole
    ]


def _magnified(image: NDArray[Any], times: int) -> NDArray[Any]:
    """Image with each pixel repeated along both sides."""
    return np.repeat(np.repeat(image, times, axis=0), times, axis=1)


def _rows_of(spots: Spots) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First and last row of each spot."""
    y, x = np.nonzero(spots.labels)
    first, last = np.zeros((2, len(spots.area)), dtype=np.intp)
    label = spots.labels[y, x] - 1
    first[label[::-1]], last[label] = y[::-1], y
    return first, last


def _part_of(spots: Spots, labels: NDArray[np.int32]) -> tuple[Spots, NDArray[np.intp]]:
    """Spots of a part of the picture, numbered anew, and their numbers in the whole."""
    area = np.bincount(labels.ravel(), minlength=len(spots.area) + 1)[1:]
    number = np.flatnonzero(area)
    anew = np.zeros(len(area) + 1, dtype=np.int32)
    anew[number + 1] = np.arange(1, len(number) + 1)
    return Spots(anew[labels], area[number].astype(float), spots.density), number


def measured(
    spots: list[Spots],
    levels: Levels,
    ratio: Single,
    palette: Palette,
    settings: SpotSettings = _SPOTS,
) -> list[Markers]:
    """Measure the markers of each layer's spots; `ratio` is linear light over the ground's."""
    # Dyes have the strength of this picture, or the nominal one in a layer without markers.
    strength = [layer.density if len(layer.area) else 1.0 for layer in spots]
    dyes = palette.transmittance ** np.array(strength)[:, None]
    markers = []
    for layer, coverage in zip(spots, dye_coverages(ratio, dyes), strict=True):
        count = len(layer.area)
        pixels, number = surroundings(layer, settings)
        position, area, shape = weigh(coverage, pixels, number, count)
        inside = layer.labels > 0
        label = layer.labels[inside]
        colour = [np.bincount(label, c, count + 1)[1:] / layer.area for c in levels[inside].T]
        markers.append(
            Markers(position=position, area=area, shape=shape, hue=_hue(np.stack(colour)))
        )
    return markers


def _hue(colour: Array) -> Array:
    """Hue [°] of colours (3, n), −180…180; NaN for a grey."""
    red, green, blue = colour
    hue = np.degrees(np.arctan2(np.sqrt(3.0) * (green - blue), 2.0 * red - green - blue))
    return np.where(np.ptp(colour, axis=0) > 3.0, hue, np.nan)
