"""Detection of lossy compression from a picture's pixels, and of its effect on positions.

Compression removes fine noise where the picture is flat, and leaves errors at the markers' edges.
Camera noise is the same at both. So residuals of the fit are compared with the fine colour noise in
flat regions. This does not need the noise level that the tracker was given.

The errors of a coded block are common to many pixels, to neighbouring markers and to many frames,
and they hardly change where the picture stands still. The error of a marker that moved since rest,
above all of one whose layers came apart, is several times what noise of its pixels would cause.
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

#: Side of an examined block [px].
_SIDE = 4
#: Share of the smallest differences that is used; the others are edges.
_KEPT = 0.9
#: Remaining variance of a normal distribution after this truncation, over the full variance.
_LEFT = 0.623


class FinePart(NamedTuple):
    """Noise in flat regions of a picture, as standard deviations of one channel [grey levels].

    Attributes
    ----------
    brightness: noise of brightness from pixel to pixel
    colour: noise of colour from pixel to pixel
    coarse_colour: noise of colour between neighbouring squares of two by two pixels
    """

    brightness: float
    colour: float
    coarse_colour: float


def flat_blocks(
    rest: list[Frame], settings: CompressionSettings = CompressionSettings()
) -> NDArray[np.intp]:
    """Indices of the pixels in the B flattest blocks of the rest frames, shape (4, 4, B)."""
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
    """Measure the noise of a picture at `flat_blocks`."""
    brightness, colour, coarse = flat_noise(np.ascontiguousarray(image), blocks, _KEPT)
    # White noise: each is a channel's deviation times the root of the sum of squared factors.
    return FinePart(
        brightness=brightness / math.sqrt(_LEFT * 4 * 6.0),
        colour=colour / math.sqrt(_LEFT * 4 * 2.0),
        coarse_colour=coarse / math.sqrt(_LEFT * 16 * 2.0),
    )


def compression(
    residual: float, noise: FinePart, settings: CompressionSettings = CompressionSettings()
) -> float:
    """Actual over stated standard deviation of moved inner markers; exactly 1 without compression.

    Parameters
    ----------
    residual: RMS residual of the fit to the markers [grey levels]
    noise: noise in flat regions
    settings: tuned parameters
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
    """Factors on the standard deviations of (x, y, log size) of both layers, shape (M, 6).

    Parameters
    ----------
    factor: result of `compression`
    moved: motion of each pair since rest [px], shape (M,)
    settings: tuned parameters
    """
    share = moved**2 / (moved**2 + settings.moved**2)
    return np.sqrt(1.0 + share[:, None] * (factor * np.array(settings.shares)) ** 2)
