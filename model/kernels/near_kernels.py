"""Nodes of a dome that an object may touch in a step."""

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit
from .touch_kernels import Pose, Touched, gap_at

Array = NDArray[np.float64]


@njit()
def find_near(
    thing: Touched,
    pose: Pose,
    margin: float,
    points: Array,
    displacement: Array,
    linear: Array,
    memory: Array,
    flags: NDArray[np.bool_],
) -> int:
    """Flag nodes that are within a margin of the object or carry a force; returns their number.

    Parameters
    ----------
    margin: distance [m]
    points, displacement: of the nodes [m], shape (N, 3)
    linear, memory: forces of the step before and those that viscosity remembers [N], (N, 3)
    flags: shape (N,) (output)
    """
    normal = np.empty(3)
    count = 0
    for i in range(points.shape[0]):
        near = False
        for a in range(3):
            near = near or linear[i, a] != 0.0 or memory[i, a] != 0.0
        if not near:
            x = points[i, 0] + displacement[i, 0]
            y = points[i, 1] + displacement[i, 1]
            z = points[i, 2] + displacement[i, 2]
            near = gap_at(thing, pose, x, y, z, normal) < margin
        flags[i] = near
        count += near
    return count
