"""Noise of a camera, estimated from its pictures."""

import itertools

import cv2
import numpy as np
from numpy.typing import NDArray

from ..render import Frame

Array = NDArray[np.float64]

#: Second difference along rows and columns, which is zero on any slope.
_MASK = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]])
#: Its gain of noise: the root of the sum of its squared factors.
_MASK_GAIN = 6.0
#: Gain of noise of a difference of two frames.
_DIFFERENCE_GAIN = np.sqrt(2.0)
#: Values further out than this are clipped [standard deviations].
_CLIP = 3.0
#: Standard deviation of a normal distribution after clipping, over that before.
_KEPT = 0.98658
#: Rounding to whole levels adds this variance.
_ROUNDING = 1.0 / 12.0
#: Lowest level that the camera does not clip [grey levels].
_DARKEST = 4
#: Highest such level [grey levels].
_LIGHTEST = 251
#: Noise of any camera, at least [grey levels]. A smooth fill, or light between two levels, shows
#: less than there is.
_LEAST = 0.3
#: Noise of compressed pictures, at least [grey levels]. Compression hides the noise and leaves
#: errors at the edges of markers, the same in every frame: this much at good qualities, two or
#: three times as much at usual ones.
_COMPRESSED = 4.0
#: One more than the largest value of the mask.
_MOST = 8 * 255 + 1


def noise_level(still: list[Frame], lossy: bool) -> tuple[float, str]:
    """Noise of the camera [grey levels] without that of rounding, and its source in words.

    Parameters
    ----------
    still: frames of one motionless scene; a single one is compared with itself, pixel by
        neighbouring pixel, and fine texture then counts as noise
    lossy: whether they were compressed with losses
    """
    images = [frame.image.astype(np.int16) for frame in still]
    if any((a != b).any() for a, b in itertools.pairwise(images)):
        values = [(b - a)[_unclipped(a) & _unclipped(b)] for a, b in itertools.pairwise(images)]
        gain, source = _DIFFERENCE_GAIN, f"differences of {len(still)} rest frames"
    else:
        curved = np.asarray(cv2.filter2D(images[0], -1, _MASK), dtype=np.int16)
        values = [curved[_unclipped(images[0])]]
        gain, source = _MASK_GAIN, "neighbouring pixels of one picture"
    # All are integers, so that their counts are a complete description.
    counts: Array = np.sum([np.bincount(abs(v), minlength=_MOST) for v in values], axis=0)
    variance = (_clipped_deviation(counts) / gain) ** 2 - _ROUNDING
    noise = float(np.sqrt(max(variance, 0.0)))
    if lossy and noise < _COMPRESSED:
        return _COMPRESSED, "that of compression"
    if noise < _LEAST:
        return _LEAST, f"no less is believed of {source}"
    return noise, source


def _unclipped(image: NDArray[np.int16]) -> NDArray[np.bool_]:
    return (image >= _DARKEST) & (image <= _LIGHTEST)


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
    for _ in range(20):
        bulk = int(_CLIP * max(deviation, 1.0)) + 1
        deviation = float(np.sqrt((counts * squares)[:bulk].sum() / total[:bulk][-1])) / _KEPT
    return deviation
