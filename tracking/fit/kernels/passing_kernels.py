"""Compiled share of light that passes all markers, by pixel. `skin_light.py` documents the use."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit
from ....render.drawing import togetherness
from .gather_kernels import ROWS, gather
from .pixel_kernels import (
    BY,
    CHANGE,
    F0,
    MODEL,
    READ,
    TERMS,
    TINY,
    Array,
    Array32,
    X,
    Y,
    extents_of,
    model_pixels,
    outline,
    row_at,
)
from .shade_kernels import shade


@njit()
def passing(
    image: NDArray[np.uint8],
    optics: Any,
    present: NDArray[np.bool_],
    fits: Array,
    share: Array32,
    edge: Array32,
    buffer: Array32,
) -> None:
    """Compute the share of the ground's light that passes the markers, and its change at edges.

    Parameters
    ----------
    image: sRGB image, shape (H, W, 3)
    optics: constants of the pixel model
    present: whether each layer's marker exists, shape (M, 2)
    fits: (x, y, e, p, q) of each layer, shape (M, 2, 5)
    share: result: share of the light, shape (H, W, 3); pixels far from markers keep their value
    edge: result: largest change of this share as an edge moves [1/px], shape (H, W, 3)
    buffer: working memory, shape (BUFFER,)
    """
    shapes, inverses, outlines = np.empty((2, 2, 2)), np.empty((2, 2, 2)), np.empty((2, 3, 2))
    extents, box = extents_of(optics, fits), np.empty(4)
    runs = np.empty((ROWS, 3), dtype=np.int64)
    lights, rhs = np.zeros((3, 3)), np.zeros(3)
    even, slopes = np.ones(3), np.zeros(TERMS)
    for m in range(fits.shape[0]):
        if not (present[m, 0] or present[m, 1]):
            continue
        outline(optics, fits, m, shapes, inverses, outlines)
        count, padded = gather(
            image, optics, present[m], fits[m], even, slopes, shapes, inverses, 1, box, runs, buffer
        )
        if count == 0:
            continue
        shade(optics, present, fits, extents, m, True, box, padded, buffer)
        together = togetherness(outlines[0], outlines[1]) if present[m].all() else 1.0
        model_pixels(
            optics, present[m], fits[m], inverses, together, 2, padded, lights, rhs, buffer
        )
        for i in range(np.uint64(padded)):
            if not buffer[row_at(READ) + i] > F0:
                continue
            row, col = int(buffer[row_at(Y) + i]), int(buffer[row_at(X) + i])
            for c in range(3):
                ground = optics.ground[row, col, c]
                share[row, col, c] = buffer[row_at(MODEL + c) + i] / ground
                b = optics.absorbed[2, c]
                for k in range(2):
                    by = b * buffer[row_at(BY + k) + i] - optics.absorbed[k, c]
                    nx = buffer[row_at(CHANGE + 5 * k) + i]
                    ny = buffer[row_at(CHANGE + 5 * k + 1) + i]
                    change = abs(by) * np.sqrt(nx * nx + ny * ny + TINY)
                    edge[row, col, c] = max(edge[row, col, c], change)
