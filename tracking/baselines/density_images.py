"""Density images of each dye: 8-bit frames through tables, relative to the ground at rest."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ...render import decoding_table
from ..detection import RestFrame
from ..palette import Palette
from ..unmixing import unmixing_matrix
from .density_kernels import UNIT, write_densities

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Smallest linear light of a level, so that its logarithm is finite; as in `dye_densities`.
_DARKEST = 1e-4


class DensityTables(NamedTuple):
    """Tables for L dyes: a density is `ground` of the pixel plus `dye` of each channel's level.

    Attributes
    ----------
    ground: contribution of the skin's light at rest, NaN outside the lit field, float32, shape
        (H, W, L)
    dye: contribution of each sRGB level in each channel, float32, shape (L, 3, 256)
    """

    ground: NDArray[np.float32]
    dye: NDArray[np.float32]


def density_tables(rest: RestFrame, palette: Palette) -> DensityTables:
    """Make the tables from a rest frame."""
    matrix = unmixing_matrix(palette.transmittance)
    log_levels = np.log(np.maximum(decoding_table(), _DARKEST))
    ground = np.log(np.maximum(rest.ground, _DARKEST)) @ matrix.T
    light = rest.ground.max(axis=2)
    # The sensor's field is brighter than this share of its brightest ground.
    ground[light < 0.2 * np.percentile(light, 95)] = np.nan
    return DensityTables(
        ground=ground.astype(np.float32),
        dye=(-matrix[:, :, None] * log_levels).astype(np.float32),
    )


def density_images(image: Image, tables: DensityTables) -> Image:
    """Density of each of L dyes as a level `ZERO` + `UNIT`·density, uint8, shape (L, H, W)."""
    height, width, layers = tables.ground.shape
    out = np.empty((layers, height, width), dtype=np.uint8)
    write_densities(image, tables.ground, tables.dye, out)
    return out


def markers_there(density: Image, position: Array, radius: Array) -> NDArray[np.bool_]:
    """Whether a density image (H, W) is denser at positions (M, 2) than at radii (M,) from them."""
    angles = np.arange(8) * (np.pi / 4)
    circle = radius[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    inside = _sample(density, position[:, None] + 0.4 * circle).mean(axis=1)
    # A neighbour may cover a part of the ring.
    around = np.quantile(_sample(density, position[:, None] + 1.7 * circle), 0.25, axis=1)
    return inside - around > 0.25 * UNIT


def _sample(image: Image, at: Array) -> Array:
    """Interpolate an image bilinearly at places (M, n, 2); NaN for a NaN place."""
    places = np.nan_to_num(at).astype(np.float32)
    x, y = (np.ascontiguousarray(places[..., i]) for i in range(2))
    # Outside the image its edge is repeated.
    values = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.where(np.isfinite(at).all(axis=-1), values, np.nan)
