"""Signed distance of a closed triangle mesh on a grid, as coefficients of a cubic B-spline.

Distances and signs are libigl's. They are exact where the surface is near: every point of a coarse
grid is asked, and of each finer grid only those that may be near. What is far is interpolated.
"""

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

Array = NDArray[np.float64]


def spline_grid(igl: Any, vertices: Array, faces: NDArray[np.int64], cells: int) -> Array:
    """Coefficients of the signed distance around a mesh whose box is centred.

    Parameters
    ----------
    igl: the module
    vertices: (V, 3) in cells
    faces: (F, 3)
    cells: along the longest side of the box

    Returns
    -------
    (I, J, K) coefficients in cells, one a cell; the middle one is at the origin.
    """
    sides = np.ptp(vertices, axis=0)
    margin = 4  # cells between the mesh's box and the grid's edge
    steps = (4, 2, 1)  # steps of the grids, from coarse to fine [cells]
    blocks = np.ceil((np.minimum(sides, cells) + 2 * margin) / steps[0]).astype(int)
    blocks += blocks % 2  # so that the middle is a point
    middle = blocks * steps[0] // 2
    near = np.ones(blocks + 1, bool)
    distance = np.zeros(blocks + 1)
    band = 3.0  # up to this distance every value is exact [cells]
    for step in steps:
        if step != steps[0]:
            distance, near = _between(distance), _between(near) > 0.0
            # What lies between coarse points is at most half their diagonal away from one of them.
            reach = band + (np.sqrt(3.0) / 2.0 * step if step > 1 else 0.0)
            near &= np.abs(distance) <= reach + np.sqrt(3.0) * step
        places = np.argwhere(near)
        points = np.ascontiguousarray(places * step - middle, dtype=float)
        kind = igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
        distance[near] = igl.signed_distance(points, vertices, faces, sign_type=kind)[0]
    coefficients: Array = scipy.ndimage.spline_filter(distance, order=3, mode="mirror")
    return coefficients


def _between(values: NDArray[Any]) -> Array:
    """Values on a grid twice as fine, straight between those of a grid."""
    fine = values.astype(float)
    for axis in range(3):
        fine = np.moveaxis(fine, axis, 0)
        wide = np.empty((2 * fine.shape[0] - 1, *fine.shape[1:]))
        wide[::2] = fine
        wide[1::2] = (fine[:-1] + fine[1:]) / 2
        fine = np.moveaxis(wide, 0, axis)
    return np.ascontiguousarray(fine)
