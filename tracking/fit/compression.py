"""What lossy compression did to a picture, as far as its pixels show it.

Compression removes fine noise where the picture is flat, and leaves errors at the markers' edges.
Noise of a camera is the same at both. What is compared are the residuals of the fit with the fine
noise of the colours in flat places. Neither needs the noise that the tracker was told.

The errors are those of coded blocks. They lie on many pixels, on neighbouring markers and in many
frames alike, and they hardly change where the picture stands still. A marker that moved since rest,
and above all one whose layers came apart, is off by several times what its pixels' noise allows.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...render import Frame
from .kernels.compression_kernels import flat_noise

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Side of a block of pixels that is looked at.
_SIDE = 4
#: Blocks that are looked at: the flattest ones at rest.
_BLOCKS = 256
#: Levels that the camera does not clip, from … to.
_UNCLIPPED = (8.0, 247.0)
#: Share of the differences that are counted, the smallest: the others are edges.
_KEPT = 0.9
#: Variance of a normal distribution that is left of them.
_LEFT = 0.623
#: Rounding, and steps of a smooth shade, count as so much noise [grey levels].
_ROUNDING = 0.5
#: Residuals at the markers over the fine noise beside them: compressed above this. Noise alone
#: gives 1.2, the smallest loss that matters 4.
_DIFFERENT = 2.5
#: Colour noise whose fine part is at least this share of the coarser one was not compressed.
_WHITE = 0.8
#: Fine noise below this says nothing about its kind [grey levels].
_PRESENT = 0.4
#: Error of the inner layer over the stated deviation, where most of the noise was kept.
_LEAST = 2.9
#: Share that is added where all of the brightness' noise was taken away.
_SMOOTHED = 1.1
#: Fine noise of brightness over the residuals where most of it was kept.
_MOST_NOISE = 0.26
#: Residuals above this stand for coarse quantisation [grey levels].
_COARSE = 6.3
#: Motion at which half of the error's variance is reached [px].
_MOVED = 0.5
#: Errors of (x, y, log size) of each layer over those of the inner layer's place.
_SHARES = np.array([[0.55, 0.55, 0.45], [1.0, 1.0, 0.75]])


class FinePart(NamedTuple):
    """Noise of a picture's flat places, as that of one channel [grey levels].

    Attributes
    ----------
    brightness: from pixel to pixel
    colour: from pixel to pixel
    coarse_colour: from two by two pixels to the next ones
    """

    brightness: float
    colour: float
    coarse_colour: float


def flat_blocks(rest: list[Frame]) -> NDArray[np.intp]:
    """Numbers of the pixels in the flattest blocks of the rest frames, shape (4, 4, B)."""
    mean = np.mean([frame.image for frame in rest], axis=0)
    height, width = (_SIDE * (side // _SIDE) for side in mean.shape[:2])
    shape = (height // _SIDE, _SIDE, width // _SIDE, _SIDE, 3)
    blocks = mean[:height, :width].reshape(shape)
    low, high = blocks.min(axis=(1, 3)), blocks.max(axis=(1, 3))
    clipped = (low < _UNCLIPPED[0]) | (high > _UNCLIPPED[1])
    spread = np.where(clipped, np.inf, high - low).max(axis=2)
    flattest = np.argsort(spread, axis=None, kind="stable")[:_BLOCKS]
    row, column = np.unravel_index(flattest, spread.shape)
    inside = np.arange(_SIDE)
    rows, columns = _SIDE * row + inside[:, None, None], _SIDE * column + inside[:, None]
    return np.asarray(rows * mean.shape[1] + columns)


def fine_part(image: Image, blocks: NDArray[np.intp]) -> FinePart:
    """Noise of a picture at `flat_blocks`."""
    brightness, colour, coarse = flat_noise(np.ascontiguousarray(image), blocks, _KEPT)
    # Of white noise, a channel's deviation times the root of the sum of the squared factors.
    return FinePart(
        brightness=brightness / math.sqrt(_LEFT * 4 * 6.0),
        colour=colour / math.sqrt(_LEFT * 4 * 2.0),
        coarse_colour=coarse / math.sqrt(_LEFT * 16 * 2.0),
    )


def compression(residual: float, noise: FinePart) -> float:
    """Error of moved inner markers over their stated deviation; exactly 1 without compression.

    Parameters
    ----------
    residual: of the fit to the markers, RMS [grey levels]
    noise: of the flat places
    """
    if noise.colour > max(_PRESENT, _WHITE * noise.coarse_colour):
        return 1.0
    if not _DIFFERENT * math.hypot(noise.colour, _ROUNDING) < residual < math.inf:
        return 1.0
    lost = 1.0 - min(noise.brightness / (_MOST_NOISE * residual), 1.0)
    coarse = max(residual / _COARSE, 1.0) ** 2
    return float(_LEAST * (1.0 + _SMOOTHED * lost) * coarse)


def deviations(factor: float, moved: Array) -> Array:
    """Factors of the deviations of (x, y, log size) of both layers, shape (M, 6).

    Parameters
    ----------
    factor: see `compression`
    moved: motion of each pair since rest [px], shape (M,)
    """
    share = moved**2 / (moved**2 + _MOVED**2)
    return np.sqrt(1.0 + share[:, None] * (factor * _SHARES.ravel()) ** 2)
