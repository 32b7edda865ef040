"""The motion of an object that takes the least work from friction."""

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit

Array = NDArray[np.float64]


@njit()
def least_work(moves: Array, normal: Array, mu: float, load: Array, rounds: int) -> float:
    """Least µ·Σ Fn·|v| over the motions m with load·m = 1, by reweighted least squares.

    Every round lowers it.

    Parameters
    ----------
    moves: velocity of each node for three unit motions, (N, 3, 3) by motion and component
    normal: normal force on each node [N], (N,)
    load: work of friction in each unit motion, (3,)
    rounds: most of them
    """
    count = len(normal)
    motion = load / (load @ load)
    speed, form = np.empty(count), np.empty((3, 3))
    least = np.inf
    for _ in range(rounds):
        work, fastest = 0.0, 0.0
        for i in range(count):
            size = 0.0
            for k in range(3):
                v = 0.0
                for j in range(3):
                    v += moves[i, j, k] * motion[j]
                size += v * v
            speed[i] = np.sqrt(size)
            work += mu * normal[i] * speed[i]
            fastest = max(fastest, speed[i])
        if np.isfinite(least) and least - work < 1e-9 * work:
            break
        least = min(least, work)
        form[:] = 0.0
        for i in range(count):
            weight = normal[i] / max(speed[i], 1e-9 * fastest)
            for j in range(3):
                for m in range(3):
                    for k in range(3):
                        form[j, m] += weight * moves[i, j, k] * moves[i, m, k]
        slack = 1e-12 * (form[0, 0] + form[1, 1] + form[2, 2])
        for j in range(3):
            form[j, j] += slack
        answer = np.linalg.solve(form, load)
        motion = answer / (load @ answer)
    return least
