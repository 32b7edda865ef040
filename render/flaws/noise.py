"""Camera noise: seeded by run and frame, so that the same seed gives the same bytes.

A field of normal offsets is drawn once. Each run of an image's bytes takes its own part of it, with
its own sign. Given the field, runs of one or of several frames are independent; within a run
offsets are as independent as those of the field are.
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .noise_kernels import Field, add_runs, fill_field

#: Bytes that take a part of the field together: about a row of 640 pixels.
_RUN = 2048
#: Places that a run may begin at. Correlations within the field are of 1/√places.
_PLACES = 1 << 21


@lru_cache(maxsize=4)
def _field(sigma: float) -> Field:
    """Field of offsets; it ends as it begins, so that a run may begin anywhere."""
    levels = offset_levels(sigma)
    if levels[-1] <= 127:  # half of the bytes to read
        levels = levels.astype(np.int8)
    field = np.empty(_PLACES + _RUN, dtype=levels.dtype)
    fill_field(levels, field[:_PLACES])
    field[_PLACES:] = field[:_RUN]
    return field


def offset_levels(sigma: float) -> NDArray[np.int16]:
    """Whole-level offsets whose histogram is the normal distribution, by equal probability.

    Parameters
    ----------
    sigma: standard deviation, before rounding to whole levels [grey levels]

    Returns
    -------
    Shape (2¹⁶,), increasing.
    """
    most = math.ceil(5.0 * sigma)
    levels = np.arange(-most, most + 1)
    ends = [math.erf((level + 0.5) / (math.sqrt(2.0) * sigma)) for level in levels[:-1]]
    shares = 1 << 16  # offsets of equal probability that the field is drawn from
    share = np.rint(0.5 * shares * (1.0 + np.array([*ends, 1.0]))).astype(np.int64)
    return np.repeat(levels, np.diff(share, prepend=0)).astype(np.int16)


def add_noise(
    image: NDArray[np.uint8],
    sigma: float,
    seed: int,
    index: int,
    out: NDArray[np.uint8] | None = None,
) -> None:
    """Add white noise to an image, in place or into another one.

    Parameters
    ----------
    image: sRGB, uint8, contiguous, shape (H, W, 3)
    sigma: standard deviation [grey levels]; 0 leaves the image as it is
    seed, index: run and frame, from 0 to 2⁶⁴ − 1; each pair gives its own, reproducible noise
    out: result, of the same shape; None is `image` itself
    """
    out = image if out is None else out
    if not out.flags.c_contiguous:
        raise ValueError("noise is added to contiguous images")
    if sigma == 0.0:
        if out is not image:
            out[...] = image
        return
    key = np.uint64(seed), np.uint64(index)
    add_runs(image.reshape(-1), _field(float(sigma)), _PLACES, *key, out.reshape(-1))
