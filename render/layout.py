"""Where the markers sit on the dome."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

#: Angle of the apex marker from the apex [rad].
_APEX = 1e-3
GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))


def unit_vectors(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vectors (x, y, z) of directions (θ from the apex, φ from the load), shape (M, 3)."""
    theta, phi = directions.T
    return np.column_stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    )


def _spiral(count: int, coverage: float) -> NDArray[np.float64]:
    index = np.arange(count)
    height = 1.0 - (1.0 - np.cos(coverage)) * (index + 0.5) / count
    return np.column_stack([np.arccos(height), np.mod(index * GOLDEN_ANGLE, 2 * np.pi)])


@lru_cache(maxsize=16)
def marker_directions(count: int, coverage: float, pitch: float) -> NDArray[np.float64]:
    """Markers in a golden-angle spiral, with a row of their own on the chain's meridian.

    The spiral is even in area and has no symmetry that could hide an error; its points that come
    near the meridian's row are left out.

    Parameters
    ----------
    count: markers in all
    coverage: largest angle from the apex [rad]
    pitch: angle between markers on the meridian [rad]

    Returns
    -------
    Directions (θ, φ) [rad], shape (count, 2), read-only.
    """
    arc = pitch * np.arange(1, int(coverage / pitch) + 1)
    # The marker at the apex sits just off it: spherical coordinates are singular there.
    row = np.concatenate(
        [[[_APEX, 0.0]]] + [np.column_stack([arc, np.full_like(arc, phi)]) for phi in (0.0, np.pi)]
    )
    if len(row) >= count:
        raise ValueError(f"{count} markers are too few for a meridian row of {len(row)}")
    row_vectors = unit_vectors(row)
    for total in range(count - len(row), 4 * count):
        spiral = _spiral(total, coverage)
        nearest = (unit_vectors(spiral) @ row_vectors.T).max(axis=1)
        kept = spiral[np.arccos(np.clip(nearest, -1.0, 1.0)) > 0.95 * pitch]
        if len(kept) + len(row) >= count:
            layout = np.concatenate([row, kept[: count - len(row)]])
            layout.setflags(write=False)
            return layout
    raise ValueError(f"no room for {count} markers beside a meridian row of {len(row)}")
