"""Nodes of a dome that an object may touch in a step."""

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit
from .touch_kernels import Pose, Touched, gap_at

Array = NDArray[np.float64]


#: Neighbouring nodes that are looked at together.
GROUP = 8
#: Slope of a distance at most; that of a mesh, which is interpolated, is not quite 1.
STEEPEST = 1.5


def node_groups(points: Array) -> Array:
    """Middle of each group of neighbouring nodes, and a radius that holds them, (N / GROUP, 4)."""
    parts = [points[k : k + GROUP] for k in range(0, len(points), GROUP)]
    middles = np.array([part.mean(axis=0) for part in parts])
    radii = [
        np.linalg.norm(part - middle, axis=1).max()
        for part, middle in zip(parts, middles, strict=True)
    ]
    return np.column_stack([middles, radii])


@njit()
def find_near(
    thing: Touched,
    pose: Pose,
    margin: float,
    points: Array,
    displacement: Array,
    linear: Array,
    memory: Array,
    before: NDArray[np.int64],
    groups: Array,
    flags: NDArray[np.bool_],
) -> int:
    """Flag nodes that are within a margin of the object or carry a force; returns their number.

    Parameters
    ----------
    margin: distance [m]
    points, displacement: of the nodes [m], shape (N, 3)
    linear, memory: forces of the step before and those that viscosity remembers [N], (N, 3)
    before: nodes that may carry a force, (n,)
    groups: of `node_groups`
    flags: shape (N,) (output)
    """
    normal = np.empty(3)
    moved, count = 0.0, 0
    for i in range(points.shape[0]):
        x, y, z = displacement[i]
        moved = max(moved, x * x + y * y + z * z)
    beyond = margin + STEEPEST * np.sqrt(moved)
    flags[:] = False
    for i in before:
        for a in range(3):
            flags[i] = flags[i] or linear[i, a] != 0.0 or memory[i, a] != 0.0
        count += flags[i]
    for k in range(groups.shape[0]):
        x, y, z, radius = groups[k]
        if gap_at(thing, pose, x, y, z, normal) > beyond + STEEPEST * radius:
            continue
        for i in range(GROUP * k, min(GROUP * (k + 1), points.shape[0])):
            if flags[i]:
                continue
            x = points[i, 0] + displacement[i, 0]
            y = points[i, 1] + displacement[i, 1]
            z = points[i, 2] + displacement[i, 2]
            flags[i] = gap_at(thing, pose, x, y, z, normal) < margin
            count += flags[i]
    return count
