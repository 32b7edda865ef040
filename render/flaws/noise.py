"""Camera noise: seeded by run and frame, so that the same seed gives the same bytes."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from ...compiled import njit

#: The table of offsets has 2 to this power entries; five fit into a draw of 64 bits.
_TABLE_BITS = 12
#: Draws of which offsets are looked up before any is added: the buffers stay in the cache.
_DRAWS = 640


@lru_cache(maxsize=8)
def _levels(sigma: float) -> NDArray[np.int16]:
    """Whole-level offsets whose histogram is the normal distribution, by equal probability."""
    share = (np.arange(1 << _TABLE_BITS) + 0.5) / (1 << _TABLE_BITS)
    return np.rint(sigma * ndtri(share)).astype(np.int16)


@njit()
def _add(image: NDArray[np.uint8], levels: NDArray[np.int16], seed: np.uint64) -> None:
    """Draw for a run of bytes, look offsets up, then add them: loops that vectorise apart.

    splitmix64 is a counter through a mixer; 60 of its 64 bits serve five bytes.
    """
    flat = image.reshape(-1)
    mask = np.uint64(levels.shape[0] - 1)
    offsets, draws = np.empty(5 * _DRAWS, dtype=np.int16), np.empty(_DRAWS, dtype=np.uint64)
    step, state = np.uint64(0x9E3779B97F4A7C15), seed
    for start in range(0, flat.shape[0], 5 * _DRAWS):
        for j in range(_DRAWS):
            z = state + np.uint64(j + 1) * step
            z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            draws[j] = z ^ (z >> np.uint64(31))
        state += np.uint64(_DRAWS) * step
        for j in range(_DRAWS):
            bits = draws[j]
            offsets[5 * j] = levels[bits & mask]
            offsets[5 * j + 1] = levels[(bits >> np.uint64(12)) & mask]
            offsets[5 * j + 2] = levels[(bits >> np.uint64(24)) & mask]
            offsets[5 * j + 3] = levels[(bits >> np.uint64(36)) & mask]
            offsets[5 * j + 4] = levels[(bits >> np.uint64(48)) & mask]
        part = flat[start : start + 5 * _DRAWS]
        for i in range(part.shape[0]):
            value = np.int16(part[i]) + offsets[i]
            part[i] = np.uint8(min(max(value, np.int16(0)), np.int16(255)))


def add_noise(image: NDArray[np.uint8], sigma: float, seed: int, index: int) -> None:
    """Add white noise to an image in place.

    Parameters
    ----------
    image: sRGB, uint8, shape (H, W, 3)
    sigma: standard deviation [grey levels]; 0 leaves the image alone
    seed, index: run and frame; each pair gives its own, reproducible noise
    """
    if sigma == 0.0:
        return
    start = np.random.SeedSequence([seed, index]).generate_state(1, np.uint64)[0]
    _add(image, _levels(sigma), start)
