"""Noise of a camera, estimated from its pictures."""

import itertools

import cv2
import numpy as np
from numpy.typing import NDArray

from ..render import Frame

Array = NDArray[np.float64]


def noise_level(still: list[Frame], lossy: bool) -> tuple[float, str]:
    """Noise of the camera [grey levels] without that of rounding, and its source in words.

    Parameters
    ----------
    still: frames of one motionless scene; a single one is compared with itself, pixel by
        neighbouring pixel, and fine texture then counts as noise
    lossy: whether they were compressed with losses
    """
    images = [frame.image.astype(np.int16) for frame in still]
    # Second difference along rows and columns, which is zero on any slope.
    mask = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]])
    mask_gain = 6.0  # its gain of noise: the root of the sum of its squared factors
    difference_gain = np.sqrt(2.0)  # gain of noise of a difference of two frames
    if any((a != b).any() for a, b in itertools.pairwise(images)):
        values = [(b - a)[_unclipped(a) & _unclipped(b)] for a, b in itertools.pairwise(images)]
        gain, source = difference_gain, f"differences of {len(still)} rest frames"
    else:
        curved = np.asarray(cv2.filter2D(images[0], -1, mask), dtype=np.int16)
        values = [curved[_unclipped(images[0])]]
        gain, source = mask_gain, "neighbouring pixels of one picture"
    most = 8 * 255 + 1  # one more than the largest value of the mask
    # All are integers, so that their counts are a complete description.
    counts: Array = np.sum([np.bincount(abs(v), minlength=most) for v in values], axis=0)
    rounding = 1.0 / 12.0  # rounding to whole levels adds this variance
    variance = (_clipped_deviation(counts) / gain) ** 2 - rounding
    noise = float(np.sqrt(max(variance, 0.0)))
    # Noise of compressed pictures, at least [grey levels]. Compression hides the noise and leaves
    # errors at the edges of markers, the same in every frame: this much at good qualities, two or
    # three times as much at usual ones.
    compressed_least = 4.0
    if lossy and noise < compressed_least:
        return compressed_least, "that of compression"
    # Noise of any camera, at least [grey levels]. A smooth fill, or light between two levels, shows
    # less than there is.
    least = 0.3
    if noise < least:
        return least, f"no less is believed of {source}"
    return noise, source


def _unclipped(image: NDArray[np.int16]) -> NDArray[np.bool_]:
    darkest = 4  # lowest level that the camera does not clip [grey levels]
    lightest = 251  # highest such level [grey levels]
    return (image >= darkest) & (image <= lightest)


def _clipped_deviation(counts: Array) -> float:
    """Standard deviation of the bulk of the values, without the edges of markers.

    Parameters
    ----------
    counts: how often the values 0, ±1, ±2 … occur
    """
    squares = np.arange(len(counts)) ** 2
    total = np.cumsum(counts)
    if total[-1] == 0:
        return 0.0
    deviation = float(np.searchsorted(total, 0.5 * total[-1])) / 0.6745
    clip = 3.0  # values further out than this are clipped [standard deviations]
    # Standard deviation of a normal distribution after clipping, over that before.
    kept_share = 0.98658
    for _ in range(20):
        bulk = int(clip * max(deviation, 1.0)) + 1
        deviation = float(np.sqrt((counts * squares)[:bulk].sum() / total[:bulk][-1])) / kept_share
    return deviation
