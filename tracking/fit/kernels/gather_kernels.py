"""Compiled gathering of the pixels that a pair's markers reach. `pair_fit.py` documents the use.

Pixels of a row of the image are gathered in whole blocks of BLOCK, one row after another. Pixels of
a block that the markers do not reach, or that show no skin, are marked as not read.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit
from .lanes import LANES
from .pixel_kernels import (
    F0,
    F1,
    GROUND,
    OBSERVED,
    READ,
    ROOM,
    UNIT,
    Array,
    Array32,
    X,
    Y,
    middle_of,
    row_at,
)

#: Number of pixels of a block.
BLOCK = 8
#: Largest number of image rows that a pair reaches; larger markers are thinned out before.
ROWS = 160
#: Share of the buffer that the read pixels of a pair may take; the rest is for padding of blocks.
_FULL = 0.75


@njit()
def gather(
    image: NDArray[np.uint8],
    optics: Any,
    present: NDArray[np.bool_],
    fit: Array,
    gain: Array,
    slope: Array,
    shapes: Array,
    inverses: Array,
    stride: int,
    box: Array,
    runs: NDArray[np.int64],
    buffer: Array32,
) -> tuple[int, int]:
    """Gather the pixels that a pair's markers reach into rows of the buffer.

    The ground is multiplied by the light of this frame. `box` receives (left, right, top, bottom)
    of the pixels; `runs` receives (row, first column, blocks) of each image row, ended by a run
    without blocks. Other parameters are as in `fit_step`.

    Returns
    -------
    Number of pixels that are read, and number of all pixels, a multiple of LANES.
    """
    height, breadth = image.shape[0], image.shape[1]
    reach = optics.reach * optics.width
    top, bottom = 1e9, -1e9
    wide = np.empty(2)
    pixels = 0.0
    for k in range(2):
        s = shapes[k]
        radius = math.sqrt(abs(s[0, 0] * s[1, 1] - s[0, 1] * s[1, 0]))
        wide[k] = 1.0 + reach / radius
        if present[k]:
            half = wide[k] * math.sqrt(s[1, 0] ** 2 + s[1, 1] ** 2)
            top, bottom = min(top, fit[k, 1] - half), max(bottom, fit[k, 1] + half)
            pixels += math.pi * (radius + reach) ** 2
    while pixels > _FULL * ROOM * stride or bottom - top > (ROWS - 2) * stride:
        stride += 1
    runs[0, 2] = 0
    box[0], box[1], box[2], box[3] = breadth, 0.0, top, bottom
    if not (bottom > top and bottom > 0.0 and top < height):
        return 0, 0
    g0, g1, g2 = np.float32(gain[0]), np.float32(gain[1]), np.float32(gain[2])
    along_x, along_y = np.float32(slope[0]), np.float32(slope[1])
    xx, xy, yy = np.float32(slope[2]), np.float32(slope[3]), np.float32(slope[4])
    middle_x, middle_y = middle_of(fit)
    ground = optics.ground
    first = int(max(top, 0.0)) + 1
    count = size = run = 0
    for row in range(first - first % stride, min(int(bottom), height - 1) + 1, stride):
        left, right = 1e9, -1e9
        for k in range(2):
            if not present[k]:
                continue
            # Intersections of the row with the widened ellipse |S⁻¹·d| = wide.
            a, b = inverses[k, 0], inverses[k, 1]
            dy = row - fit[k, 1]
            square = a[0] * a[0] + b[0] * b[0]
            mixed = (a[0] * a[1] + b[0] * b[1]) * dy
            root = mixed**2 - square * ((a[1] * a[1] + b[1] * b[1]) * dy * dy - wide[k] ** 2)
            if root > 0.0:
                half = math.sqrt(root) / square
                left = min(left, fit[k, 0] - mixed / square - half)
                right = max(right, fit[k, 0] - mixed / square + half)
        box[0], box[1] = min(box[0], left), max(box[1], right)
        begin, end = int(max(left, 0.0)) + 1, int(min(right, breadth - 1.0))
        blocks = min((end - begin + BLOCK) // BLOCK, breadth // BLOCK)
        if end < begin or size + blocks * BLOCK > ROOM - LANES:
            continue
        start = min(begin, breadth - blocks * BLOCK)
        runs[run, 0], runs[run, 1], runs[run, 2] = row, start, blocks
        run += 1
        y = np.float32(row)
        dy32 = y - middle_y
        for j in range(np.uint64(blocks * BLOCK)):
            at, col = np.uint64(size) + j, np.uint64(start) + j
            x = np.float32(start) + np.float32(j)
            dx32 = x - middle_x
            light = F1 + dx32 * (along_x + UNIT * (xx * dx32 + xy * dy32))
            light += dy32 * (along_y + UNIT * yy * dy32)
            buffer[row_at(X) + at] = x
            buffer[row_at(Y) + at] = y
            inside = begin <= start + int(j) <= end and ground[row, col, 0] > F0
            read = F1 if inside else F0
            count += 1 if inside else 0
            light *= read
            buffer[row_at(READ) + at] = read
            buffer[row_at(OBSERVED) + at] = np.float32(image[row, col, 0])
            buffer[row_at(OBSERVED + 1) + at] = np.float32(image[row, col, 1])
            buffer[row_at(OBSERVED + 2) + at] = np.float32(image[row, col, 2])
            buffer[row_at(GROUND) + at] = g0 * light * ground[row, col, 0]
            buffer[row_at(GROUND + 1) + at] = g1 * light * ground[row, col, 1]
            buffer[row_at(GROUND + 2) + at] = g2 * light * ground[row, col, 2]
        size += blocks * BLOCK
    runs[run, 2] = 0
    return count, _pad(size, buffer)


@njit()
def _pad(count: int, buffer: Array32) -> int:
    """Append pixels that are not read, up to a multiple of LANES; return the new number."""
    if count == 0:  # there is no last pixel to repeat
        return 0
    end = (count + LANES - 1) // LANES * LANES
    for row in range(GROUND + 4):
        first = row_at(row if row < GROUND + 3 else READ)
        same = buffer[first + np.uint64(count - 1)] if row < OBSERVED else F0
        for i in range(np.uint64(count), np.uint64(end)):
            buffer[first + i] = same
    return end
