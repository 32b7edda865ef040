"""Lossy compression of a picture, as far as its pixels show it.

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
from .settings import CompressionSettings

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Side of a block of pixels that is looked at.
_SIDE = 4
#: Share of the differences that are counted, the smallest: the others are edges.
_KEPT = 0.9
#: Variance of a normal distribution that is left of them.
_LEFT = 0.623


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


def flat_blocks(
    rest: list[Frame], settings: CompressionSettings = CompressionSettings()
) -> NDArray[np.intp]:
    """Numbers of the pixels in the flattest blocks of the rest frames, shape (4, 4, B)."""
    mean = np.mean([frame.image for frame in rest], axis=0)
    height, width = (_SIDE * (side // _SIDE) for side in mean.shape[:2])
    shape = (height // _SIDE, _SIDE, width // _SIDE, _SIDE, 3)
    blocks = mean[:height, :width].reshape(shape)
    low, high = blocks.min(axis=(1, 3)), blocks.max(axis=(1, 3))
    clipped = (low < settings.darkest) | (high > settings.brightest)
    spread = np.where(clipped, np.inf, high - low).max(axis=2)
    flattest = np.argsort(spread, axis=None, kind="stable")[: settings.blocks]
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


def compression(
    residual: float, noise: FinePart, settings: CompressionSettings = CompressionSettings()
) -> float:
    """Error of moved inner markers over their stated deviation; exactly 1 without compression.

    Parameters
    ----------
    residual: of the fit to the markers, RMS [grey levels]
    noise: of the flat places
    """
    if noise.colour > max(settings.present, settings.white * noise.coarse_colour):
        return 1.0
    if not settings.different * math.hypot(noise.colour, settings.rounding) < residual < math.inf:
        return 1.0
    lost = 1.0 - min(noise.brightness / (settings.most_noise * residual), 1.0)
    coarse = max(residual / settings.coarse, 1.0) ** 2
    return float(settings.least * (1.0 + settings.smoothed * lost) * coarse)


def deviations(
    factor: float, moved: Array, settings: CompressionSettings = CompressionSettings()
) -> Array:
    """Factors of the deviations of (x, y, log size) of both layers, shape (M, 6).

    Parameters
    ----------
    factor: see `compression`
    moved: motion of each pair since rest [px], shape (M,)
    """
    share = moved**2 / (moved**2 + settings.moved**2)
    return np.sqrt(1.0 + share[:, None] * (factor * np.array(settings.shares)) ** 2)
