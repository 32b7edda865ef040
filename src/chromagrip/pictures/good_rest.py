"""Rest frames that are unlike most others: black, torn, blurred, half covered or moved ones."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from ..stored_pictures import Image

Single = NDArray[np.float32]
Mask = NDArray[np.bool_]


def unlike(images: list[Image], field: Mask | None = None) -> dict[int, str]:
    """Say of each frame that is unlike most others what is wrong with it, by its number.

    All are compared with the one that most are like, block by block, in a band of scales that shows
    the edges of markers, and neither slow shades nor single pixels.

    Parameters
    ----------
    images: frames of a sensor at rest, of one size, shape (H, W, 3) each
    field: pixels that are compared, shape (H, W); by default all
    """
    # Longer side to which pictures are reduced [px], number of blocks along it, and their least
    # side [px].
    longest, along, least_side = 640, 16, 12
    # Largest number of frames that the others are compared with.
    most = 31
    # Energy of a block over that of its noise from which it is compared; energy of the difference
    # of two over the larger energy from which they differ: dots moved by 1.4 px have about as much.
    above_noise, residual = 40.0, 0.4
    # Share of the blocks that differ in a frame that is left out, and their number.
    least_share, least_count = 0.05, 2
    height, width = images[0].shape[:2]
    factor = math.ceil(max(height, width) / longest)
    size = (width // factor, height // factor)
    if len(images) < 2 or min(size) < least_side:
        return {}
    area = cv2.INTER_AREA
    small = [np.asarray(cv2.resize(i, size, interpolation=area), np.uint8) for i in images]
    side = max(least_side, max(size) // along)
    some = [*range(0, len(small), math.ceil(len(small) / most))]
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
    shown = energy > above_noise * of_noise
    if field is not None:
        inside = np.asarray(cv2.resize(field.astype(np.float32), size), np.float32)
        shown &= _blocks(inside[..., None], side).mean(axis=1)[:, None] > 0.5
    compared = shown[:, :, None] | shown[:, None, some]
    one, other = energy[:, :, None], energy[:, None, some]
    apart, larger = one + other - 2.0 * common - 2.0 * of_noise, np.maximum(one, other)
    differs = compared & (apart > residual * larger)
    share = differs.sum(axis=0) / np.maximum(compared.sum(axis=0), 1)
    alike = (share <= least_share) | (differs.sum(axis=0) < least_count)
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
