"""Compiled noise of flat regions of a picture. `compression.py` documents the use."""

import math

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit

#: Upper bound of the differences of levels.
_MOST = 8192


@njit()
def flat_noise(
    image: NDArray[np.uint8], blocks: NDArray[np.intp], kept: float
) -> tuple[float, float, float]:
    """RMS differences of brightness, of colours, and of colours averaged over two by two pixels.

    Mixed second differences over two by two values are used, which a gradient does not change. The
    largest ones are left out.

    Parameters
    ----------
    image: sRGB picture, shape (H, W, 3)
    blocks: indices of the pixels of B blocks, shape (4, 4, B)
    kept: share of the differences that is used
    """
    pixels, count = image.reshape(-1, 3), blocks.shape[2]
    brightness, colours, coarse = (
        np.zeros(_MOST, dtype=np.int64),
        np.zeros(_MOST, dtype=np.int64),
        np.zeros(_MOST, dtype=np.int64),
    )
    bright, colour = np.empty((4, 4), dtype=np.int64), np.empty((2, 4, 4), dtype=np.int64)
    halved = np.empty((2, 2), dtype=np.int64)
    for b in range(count):
        for i in range(4):
            for j in range(4):
                pixel = pixels[blocks[i, j, b]]
                red, green, blue = np.int64(pixel[0]), np.int64(pixel[1]), np.int64(pixel[2])
                bright[i, j] = red + 2 * green + blue
                colour[0, i, j], colour[1, i, j] = red - green, blue - green
        for i in range(0, 4, 2):
            for j in range(0, 4, 2):
                brightness[abs(_twist(bright, i, j))] += 1
                for k in range(2):
                    colours[abs(_twist(colour[k], i, j))] += 1
        for k in range(2):
            one = colour[k]
            for i in range(2):
                for j in range(2):
                    r, c = 2 * i, 2 * j
                    halved[i, j] = one[r, c] + one[r, c + 1] + one[r + 1, c] + one[r + 1, c + 1]
            coarse[abs(_twist(halved, 0, 0))] += 1
    return (
        _smallest(brightness, int(kept * (4 * count))),
        _smallest(colours, int(kept * (8 * count))),
        _smallest(coarse, int(kept * (2 * count))),
    )


@njit()
def _twist(values: NDArray[np.int64], i: int, j: int) -> int:
    """Mixed second difference of the two by two values at (i, j)."""
    return values[i, j] - values[i + 1, j] - values[i, j + 1] + values[i + 1, j + 1]


@njit()
def _smallest(histogram: NDArray[np.int64], kept: int) -> float:
    """Root mean square of the `kept` smallest magnitudes of a histogram."""
    left, total = kept, 0.0
    for size in range(len(histogram)):
        number = min(histogram[size], left)
        total += float(number) * size * size
        left -= number
        if left == 0:
            break
    return math.sqrt(total / kept)
