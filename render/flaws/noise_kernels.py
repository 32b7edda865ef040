"""Compiled noise: a field of offsets, and runs of it that are added. `noise.py` documents them."""

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit

Field = NDArray[np.int8] | NDArray[np.int16]


@njit()
def mixed(bits: np.uint64) -> np.uint64:
    """64 bits that depend on each of these: the mixer of splitmix64, which is one to one."""
    z = bits + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@njit()
def fill_field(levels: Field, field: Field) -> None:
    """Fill a field, whose length is a multiple of 4, with levels drawn from 2¹⁶ alike."""
    low = np.uint64(0xFFFF)
    for i in range(field.shape[0] // 4):
        bits = mixed(np.uint64(i))
        field[4 * i] = levels[bits & low]
        field[4 * i + 1] = levels[(bits >> np.uint64(16)) & low]
        field[4 * i + 2] = levels[(bits >> np.uint64(32)) & low]
        field[4 * i + 3] = levels[bits >> np.uint64(48)]


@njit()
def add_runs(
    image: NDArray[np.uint8],
    field: Field,
    places: int,
    seed: np.uint64,
    index: np.uint64,
    out: NDArray[np.uint8],
) -> None:
    """Add to each run of bytes a run of the field, from a place and with a sign of its own.

    Parameters
    ----------
    image: bytes, shape (K,)
    field: whole levels in one byte or in two, as many as there are places and a run's more
    places: that a run may begin at, a power of two
    seed, index: of the image
    out: result, shape (K,); may be `image`
    """
    run, key = field.shape[0] - places, mixed(mixed(seed) ^ index)
    sums = np.empty(run, dtype=np.uint8)  # a loop that may read what it writes does not vectorise
    for number in range((image.shape[0] + run - 1) // run):
        bits = mixed(key + np.uint64(number))
        start = np.int64(bits & np.uint64(places - 1))
        first, last = number * run, min((number + 1) * run, image.shape[0])
        now, new, offsets = image[first:last], out[first:last], field[start : start + last - first]
        if bits >> np.uint64(63):
            _subtract(now, offsets, sums)
        else:
            _add(now, offsets, sums)
        for i in range(new.shape[0]):
            new[i] = sums[i]


# All is cut to 16 bits, in which it fits: in Numba's 64 fewer would fit into a vector.
@njit()
def _add(now: NDArray[np.uint8], offsets: Field, out: NDArray[np.uint8]) -> None:
    for i in range(now.shape[0]):
        out[i] = _level(np.int16(np.int16(now[i]) + np.int16(offsets[i])))


@njit()
def _subtract(now: NDArray[np.uint8], offsets: Field, out: NDArray[np.uint8]) -> None:
    for i in range(now.shape[0]):
        out[i] = _level(np.int16(np.int16(now[i]) - np.int16(offsets[i])))


@njit(inline="always")
def _level(value: np.int16) -> np.uint8:
    """Level from black to white."""
    least, most = np.int16(0), np.int16(255)
    value = value if value > least else least
    return np.uint8(value if value < most else most)
