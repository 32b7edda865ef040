"""Conversion between sRGB and linear light, with tables for every renderer and tracker."""

import numpy as np
from numpy.typing import NDArray


def decode_srgb(level: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Convert sRGB levels 0…255 to linear light 0…1 (IEC 61966-2-1), in the shape of `level`.

    Parameters
    ----------
    level: sRGB level from 0 to 255, of any shape
    """
    v = np.asarray(level, dtype=float) / 255.0
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def encode_srgb(linear: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Convert linear light 0…1 to sRGB levels 0…255, not rounded, in the shape of `linear`.

    Parameters
    ----------
    linear: linear light from 0 to 1, of any shape
    """
    v = np.clip(np.asarray(linear, dtype=float), 0.0, 1.0)
    return 255.0 * np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055)


def decoding_table() -> NDArray[np.float64]:
    """Linear light of each 8-bit level, shape (256,)."""
    return decode_srgb(np.arange(256.0))


def encoding_table() -> NDArray[np.uint8]:
    """SRGB levels of linear light 0…1 in even steps, uint8, shape (ENCODE_STEPS,)."""
    # Steps of the encoding table over linear light 0…1; its coarsest step is 0.8 grey levels.
    steps = 4096
    return np.rint(encode_srgb(np.linspace(0.0, 1.0, steps))).astype(np.uint8)
