"""Compiled slip of an object over a dome; `dome.slip` documents it."""

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@njit()
def add_slip(
    path: Array,
    touching: Index,
    points: Array,
    then: Array,
    now: Array,
    normals: Array,
    before: tuple[Array, Array],
    after: tuple[Array, Array],
    around: float,
    out: Array,
) -> tuple[float, float]:
    """Add the slip of a step to the paths of the nodes that touch.

    Parameters
    ----------
    path: slip of each node so far [m], shape (N, 3); NaN out of contact
    touching: numbers of the n nodes that touch
    points: nodes at rest [m], shape (N, 3)
    then, now: displacements before and after the step [m], shape (N, 3)
    normals: of the object after the step, shape (N, 3)
    before, after: rotation and place of the object
    around: largest distance of a point of the contact from the nearest node [m]
    out: slip of each node that touches (output) [m], shape (N, 3)

    Returns
    -------
    smallest slip in the contact so far, and in the step [m]
    """
    n = len(touching)
    steps, old = np.empty((n, 3)), np.empty((n, 3))
    places, upright = np.empty((n, 3)), np.empty((n, 3))
    turn, known, least, first = after[0] @ before[0].T, 0, np.inf, np.zeros(3)
    for k in range(n):
        i = touching[k]
        along, size = 0.0, 0.0
        for a in range(3):
            carried = after[1][a]
            for b in range(3):
                carried += turn[a, b] * (points[i, b] + then[i, b] - before[1][b])
            places[k, a], upright[k, a] = points[i, a] + now[i, a], normals[i, a]
            steps[k, a] = carried - places[k, a]
            along += steps[k, a] * normals[i, a]
            old[k, a] = path[i, a]
            size += path[i, a] ** 2
        for a in range(3):
            steps[k, a] -= along * normals[i, a]
        if size < least:  # false for a node that joins the contact
            least, first = size, old[k].copy()
        known += not np.isnan(size)
    slid, own, m = np.empty((n, 3)), np.empty(n, np.bool_), 0
    moved, where, up = np.empty((known, 3)), np.empty((known, 3)), np.empty((known, 3))
    for k in range(n):
        own[k] = not np.isnan(old[k, 0])
        slid[k] = old[k] + steps[k] if own[k] else first
        out[touching[k]] = slid[k]
        if own[k]:
            moved[m], where[m], up[m] = steps[k], places[k], upright[k]
            m += 1
    return _least(slid, places, upright, around), _least(moved, where, up, around)


@njit()
def _least(paths: Array, places: Array, normals: Array, around: float) -> float:
    """Smallest path length in a contact, also at points between the places of known paths [m]."""
    n = len(paths)
    if n == 0:
        return 0.0
    middle, mean, shortest = np.zeros(3), np.zeros(3), np.inf
    for k in range(n):
        size = 0.0
        for a in range(3):
            middle[a] += places[k, a] / n
            mean[a] += paths[k, a] / n
            size += paths[k, a] ** 2
        shortest = min(shortest, size)
    turns, arms = 0.0, 0.0
    for k in range(n):
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            arm = normals[k, b] * (places[k, c] - middle[c])
            arm -= normals[k, c] * (places[k, b] - middle[b])
            arms += arm * arm
            turns += arm * (paths[k, a] - mean[a])
    turn = abs(turns) / arms if arms > 0.0 else 0.0
    return max(0.0, np.sqrt(shortest) - turn * around)
