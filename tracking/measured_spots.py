"""Measurement of the markers whose spots were found: centroid, area, shape and hue."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .palette import Palette
from .spots import Spots, surroundings, weigh
from .unmixing import dye_coverages

Array = NDArray[np.float64]
Single = NDArray[np.float32]
#: sRGB levels: of one picture, or the mean of many.
Levels = NDArray[np.uint8] | Array


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


def measured(spots: list[Spots], levels: Levels, ratio: Single, palette: Palette) -> list[Markers]:
    """Measure the markers of each layer's spots; `ratio` is linear light over the ground's."""
    # Dyes have the strength of this picture, or the nominal one in a layer without markers.
    strength = [layer.density if len(layer.area) else 1.0 for layer in spots]
    dyes = palette.transmittance ** np.array(strength)[:, None]
    markers = []
    for layer, coverage in zip(spots, dye_coverages(ratio, dyes), strict=True):
        count = len(layer.area)
        pixels, number = surroundings(layer)
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
