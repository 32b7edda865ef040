"""What today's light and camera do to the colours of the palette: levels of black, faded dyes."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...render.colour import decode_srgb

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

#: How well the colours are known beforehand: standard deviation of what a dye absorbs.
_KNOWN = 0.03
#: What an image says of the colours counts so much less than noise alone would have it: the model's
#: own errors are common to all pixels.
_OWN_ERRORS = 1.0 / 300.0


@lru_cache(maxsize=64)
def level_tables(black: tuple[float, ...], noise: float) -> tuple[Array32, Array32]:
    """Linear light of each level, and 1 over its variance, of each channel, shape (3, 256).

    A camera of lower contrast, fog, or faded dyes lift the dark levels; taking the level of black
    away from sRGB levels gives the light back but for its gain, which is fitted anyway.

    Parameters
    ----------
    black: level that stands for no light in each channel
    noise: standard deviation of the camera noise [grey levels]; rounding is added to it
    """
    lowest = np.array(black)[:, None]
    levels = (np.arange(256.0) - lowest) * (255.0 / (255.0 - lowest))
    # Below black the curve goes on as a line.
    linear = np.where(levels > 0.0, decode_srgb(np.maximum(levels, 0.0)), levels / 255.0 / 12.92)
    weight = 1.0 / (np.gradient(linear, axis=1) ** 2 * (noise**2 + 1.0 / 12.0))
    return linear.astype(np.float32), weight.astype(np.float32)


def fit_colours(sums: Array, known: Array) -> tuple[Array, Array, Array]:
    """Colours that explain the pairs best near what is known, each pair having gains of its own.

    Parameters
    ----------
    sums: of `light_sums`, of n pairs, shape (n, 3, 5, 5)
    known: absorbed by both dyes, and left over by both, of each channel, shape (3, 3)

    Returns
    -------
    absorbed: shape (3, 3)
    gain: of each pair and channel, shape (n, 3)
    doubt: squared residuals, and how far the colours are from what is known, of each channel, (3,)
    """
    model, product = _explained(sums, known)
    gain = product / model
    # What is left of a mean over the pair tells of colours.
    mean = sums[:, :, 0, 1:4] / sums[:, :, :1, 0]
    inner = sums[:, :, 1:4, 1:4] - sums[:, :, :1, 1:4] * mean[..., None]
    pull = (sums[:, :, 1:4, 4] - mean * sums[:, :, :1, 4]) / gain[..., None]
    weight = _OWN_ERRORS * gain**2
    matrix = np.einsum("nc,ncij->cij", weight, inner) + np.eye(3) / _KNOWN**2
    right = np.einsum("nc,nci->ci", weight, pull) + (_SIGNS[:, None] * known).T / _KNOWN**2
    absorbed = _SIGNS[:, None] * np.linalg.solve(matrix, right[..., None])[..., 0].T
    model, product = _explained(sums, absorbed)
    residual = (sums[:, :, 4, 4] - product**2 / model).sum(axis=0)
    doubt = _OWN_ERRORS * residual + ((absorbed - known) ** 2).sum(axis=0) / _KNOWN**2
    return absorbed, product / model, doubt


#: Light over the ground's is 1 − a₀·C₀ − a₁·C₁ + b·C₀₁.
_SIGNS = np.array([-1.0, -1.0, 1.0])


def _explained(sums: Array, absorbed: Array) -> tuple[Array, Array]:
    """Squares of the model, and its products with what is seen, of each pair and channel (n, 3)."""
    tone = np.concatenate([np.ones((1, 3)), _SIGNS[:, None] * absorbed])
    model = np.einsum("ac,ncab,bc->nc", tone, sums[..., :4, :4], tone)
    return model, np.einsum("ac,nca->nc", tone, sums[..., :4, 4])
