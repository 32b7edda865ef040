"""Rest frames that are unlike most others: black, torn, blurred, half covered or moved ones."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..stored_pictures import Image

Single = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class RestSettings:
    """How unlike the others a rest frame may be.

    Attributes
    ----------
    side: longer side to which pictures are reduced, by a whole factor [px]
    blocks: number of blocks along it; none is smaller than `least_block` [px]
    most: largest number of frames that the others are compared with
    above_noise: energy of a block over that of its noise, from which it is compared
    residual: energy of the difference of two blocks over the larger energy, above which they
        differ; dots that have moved by 1.4 px have about as much
    share, least: share of the blocks that differ in a frame that is left out, and their number
    """

    side: int = 640
    blocks: int = 16
    least_block: int = 12
    most: int = 31
    above_noise: float = 40.0
    residual: float = 0.4
    share: float = 0.05
    least: int = 2


def unlike(
    images: list[Image], field: Mask | None = None, settings: RestSettings = RestSettings()
) -> dict[int, str]:
    """Say of each frame that is unlike most others what is wrong with it, by its number.

    All are compared with the one that most are like, block by block, in a band of scales that shows
    the edges of markers, and neither slow shades nor single pixels.

    Parameters
    ----------
    images: frames of a sensor at rest, of one size, shape (H, W, 3) each
    field: pixels that are compared, shape (H, W); by default all
    settings: see `RestSettings`
    """
    height, width = images[0].shape[:2]
    factor = math.ceil(max(height, width) / settings.side)
    size = (width // factor, height // factor)
    if len(images) < 2 or min(size) < settings.least_block:
        return {}
    small = [np.asarray(cv2.resize(i, size, interpolation=cv2.INTER_AREA)) for i in images]
    side = max(settings.least_block, max(size) // settings.blocks)
    some = [*range(0, len(small), math.ceil(len(small) / settings.most))]
    models = np.stack([_blocks(_band(small[k]), side) for k in some], axis=1)
    # Energies of the B blocks of n frames, (B, n), and of what r of them have in common, (B, n, r).
    energies, commons = [], []
    for image in small:
        blocks = _blocks(_band(image), side)
        energies.append((blocks**2).sum(axis=1))
        commons.append((models @ blocks[..., None])[..., 0])
    energy, common = np.stack(energies, axis=1), np.stack(commons, axis=1)
    noise = float(np.median([_noise(image) for image in small]))
    of_noise = _BAND_GAIN * noise**2 * models.shape[2]
    shown = energy > settings.above_noise * of_noise
    if field is not None:
        inside = cv2.resize(field.astype(np.float32), size)[..., None]
        shown &= _blocks(inside, side).mean(axis=1)[:, None] > 0.5
    compared = shown[:, :, None] | shown[:, None, some]
    one, other = energy[:, :, None], energy[:, None, some]
    apart, larger = one + other - 2.0 * common - 2.0 * of_noise, np.maximum(one, other)
    differs = compared & (apart > settings.residual * larger)
    share = differs.sum(axis=0) / np.maximum(compared.sum(axis=0), 1)
    alike = (share <= settings.share) | (differs.sum(axis=0) < settings.least)
    # Of equals the one that shows more; what looks for markers refuses frames that show nothing.
    votes = np.where(shown[:, some].any(axis=0), alike.sum(axis=0), -1)
    best = max(range(len(some)), key=lambda k: (votes[k], energy[:, some[k]].sum()))
    return {
        int(k): f"unlike the others in {share[k, best]:.0%} of it"
        for k in np.flatnonzero(~alike[:, best])
    }


#: Variance of white noise in the band over that before.
_BAND_GAIN = 0.08


def _band(image: Image) -> Single:
    """Details of a picture between single pixels and slow shades."""
    fine, coarse, factor = 1.0, 1.5, 4  # standard deviations [px], the second in a reduced picture
    light, size = image.astype(np.float32), image.shape[1::-1]
    small = cv2.resize(light, tuple(side // factor for side in size), interpolation=cv2.INTER_AREA)
    shade = cv2.resize(cv2.GaussianBlur(small, (0, 0), coarse), size)
    return np.asarray(cv2.GaussianBlur(light, (0, 0), fine) - shade, np.float32)


def _blocks(values: Single, side: int) -> Single:
    """Values of each block of an array (H, W, C), shape (B, side²·C)."""
    rows, columns, channels = values.shape[0] // side, values.shape[1] // side, values.shape[2]
    parts = values[: rows * side, : columns * side].reshape(rows, side, columns, side, channels)
    return np.swapaxes(parts, 1, 2).reshape(rows * columns, side * side * channels)


def _noise(image: Image) -> float:
    """Noise of a frame by its second differences, and at least that of rounding [grey levels]."""
    mask = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]]) / 6.0
    curved = cv2.filter2D(image, cv2.CV_32F, mask)[::3, ::3]  # as many as are needed
    return max(0.3, float(np.median(abs(curved))) / 0.6745)
