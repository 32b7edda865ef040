"""The noise of a camera, from its pictures alone."""

import itertools

import cv2
import numpy as np
from numpy.typing import NDArray

from ..render import Frame

Array = NDArray[np.float64]

#: Second difference along rows and columns: blind to any slope. It and a difference of two frames
#: gain noise by the root of the sum of their squared factors.
_MASK = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]])
_MASK_GAIN, _DIFFERENCE_GAIN = 6.0, np.sqrt(2.0)
#: Clipping at three standard deviations leaves that much of a normal distribution's.
_CLIP, _KEPT = 3.0, 0.98658
#: Rounding to whole levels adds this variance.
_ROUNDING = 1.0 / 12.0
#: Levels outside are clipped by the camera and have no noise [grey levels].
_DARKEST, _LIGHTEST = 4, 251
#: Compression hides the noise and leaves errors at markers' edges, the same in every frame: so
#: much in good qualities, two or three times that in usual ones [grey levels].
_COMPRESSED = 4.0
#: More than the largest value of the mask.
_MOST = 8 * 255 + 1


def noise_level(still: list[Frame], lossy: bool) -> tuple[float, str]:
    """Noise of the camera [grey levels] without that of rounding, and a word on where from.

    Parameters
    ----------
    still: frames of one motionless scene; from one alone the noise is what differs between
        neighbouring pixels, which fine texture adds to
    lossy: whether they were compressed with losses, which are then no less than `_COMPRESSED`
    """
    images = [frame.image.astype(np.int16) for frame in still]
    if any((a != b).any() for a, b in itertools.pairwise(images)):
        values = [(b - a)[_unclipped(a) & _unclipped(b)] for a, b in itertools.pairwise(images)]
        gain, source = _DIFFERENCE_GAIN, f"differences of {len(still)} rest frames"
    else:
        curved = np.asarray(cv2.filter2D(images[0], -1, _MASK), dtype=np.int16)
        values = [curved[_unclipped(images[0])]]
        gain, source = _MASK_GAIN, "neighbouring pixels of one picture"
    # Whole numbers all, so that their counts hold everything.
    counts: Array = np.sum([np.bincount(abs(v), minlength=_MOST) for v in values], axis=0)
    variance = (_clipped_deviation(counts) / gain) ** 2 - _ROUNDING
    noise = float(np.sqrt(max(variance, 0.0)))
    if lossy and noise < _COMPRESSED:
        return _COMPRESSED, "that of compression"
    return noise, source


def _unclipped(image: NDArray[np.int16]) -> NDArray[np.bool_]:
    return (image >= _DARKEST) & (image <= _LIGHTEST)


def _clipped_deviation(counts: Array) -> float:
    """Standard deviation of the bulk of values, without the edges of markers among them.

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
