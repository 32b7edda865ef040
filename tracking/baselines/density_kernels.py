"""Compiled lookup of dye densities. `density_images.py` documents the use."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit

#: Level of density 0; smaller levels keep negative noise.
ZERO = 64
#: Number of levels per unit of density; levels above `ZERO` + `UNIT` keep noise above 1.
UNIT = 128


@njit()
def write_densities(image: NDArray[np.uint8], ground: Any, dye: Any, out: Any) -> None:
    """Write density levels to `out`, shape (L, H, W); `ZERO` where the ground is NaN."""
    for k in range(out.shape[0]):
        for row in range(out.shape[1]):
            for col in range(out.shape[2]):
                density = ground[row, col, k]
                for ch in range(3):
                    density += dye[k, ch, image[row, col, ch]]
                level = ZERO + 0.5
                if density == density:
                    level += min(max(UNIT * density, -ZERO), 254.0 - ZERO)
                out[k, row, col] = np.uint8(level)
