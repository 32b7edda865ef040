"""Compiled lookup of dye densities, and their centroids. `density_images.py` documents the use."""

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


@njit()
def weigh_windows(
    density: NDArray[np.uint8], ground: float, start: Any, radius: Any, out: Any
) -> None:
    """Write centroids and sums of a density (H, W) in round windows around them to `out`, (M, 3).

    Windows of radii (M,) move from `start`, (M, 2), to the centroid of the density above that of
    the ground, until they rest. NaN where there is nothing.
    """
    moves, settled = 8, 0.01  # of a window at most, and motion at which it rests [px]
    height, width = density.shape
    for m in range(out.shape[0]):
        x, y, reach = start[m, 0], start[m, 1], radius[m] + 0.5
        for _ in range(moves):
            if not (0.0 <= x < width and 0.0 <= y < height):
                break
            total = along_x = along_y = 0.0
            for row in range(max(0, int(y - reach)), min(height, int(y + reach) + 2)):
                for col in range(max(0, int(x - reach)), min(width, int(x + reach) + 2)):
                    dx, dy = col - x, row - y
                    share = min(1.0, reach - np.sqrt(dx * dx + dy * dy))
                    if share > 0.0:
                        weight = share * (density[row, col] - ground)
                        total += weight
                        along_x += weight * dx
                        along_y += weight * dy
            if total <= 0.0:
                break
            x, y = x + along_x / total, y + along_y / total
            out[m, 0], out[m, 1], out[m, 2] = x, y, total
            if max(abs(along_x), abs(along_y)) < settled * total:
                break
