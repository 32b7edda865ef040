"""Compiled bookkeeping of slip. `metrics.py` documents it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit
from .contact import contact_frame

Array = NDArray[np.float64]


@njit()
def slip_steps(
    origin: Array, now: Array, nodes: Any, place: Any, rates: Any, touching: Any, dt: float
) -> None:
    """Follow slip over the steps of a run.

    Parameters
    ----------
    origin: of each node, see `SlipRecord`, shape (S + 1, N); the first row is given
    now: current, lateral_displacement, rigid_slip and slid of a SlipRecord, shape (S + 1, 4)
    nodes: displacements at each instant [m], shape (S + 1, N, 2)
    place: of the object [m], shape (S + 1,)
    rates: tangential speeds of the object relative to each node [m/s], shape (S + 1, N)
    touching: nodes in contact, shape (S + 1, N)
    dt: step [s]
    """
    for k in range(1, len(origin)):
        origin[k], now[k] = origin[k - 1], now[k - 1]
        _slip_step(origin[k], now[k], nodes[k], place[k], rates[k], touching[k], dt)


@njit()
def _slip_step(
    origin: Array, now: Array, nodes: Any, place: float, rates: Any, touching: Any, dt: float
) -> None:
    """Follow slip over a step, in place; one row of each of the arrays above."""
    slowest, speed, any_touch = np.inf, 0.0, False
    for i in range(origin.size):
        if touching[i]:
            any_touch = True
            if abs(rates[i]) < slowest:
                slowest, speed = abs(rates[i]), rates[i]
    if not any_touch:
        origin[:] = np.nan
        now[0], now[3] = 0.0, 0.0
        return
    now[2] += abs(speed * dt)
    now[3] += speed * dt
    current = np.inf
    for i in range(origin.size):
        if not touching[i]:
            origin[i] = np.nan
            continue
        offset = place - nodes[i, 0]
        if np.isnan(origin[i]):
            origin[i] = offset - now[3]
        current = min(current, abs(offset - origin[i]))
    now[0] = current
    now[1] = max(now[1], current)


@njit()
def touch(
    rest: Array, share: Array, ct: Any, nodes: Any, place: Any, threshold: float
) -> NDArray[np.bool_]:
    """Nodes whose normal force is above a threshold, at R instants, shape (R, N).

    Parameters
    ----------
    rest, share: of the chain, shapes (N, 2) and (N,)
    ct: Contact
    nodes, place: displacements of the nodes (R, N, 2) and of the object (R,) [m]
    threshold: of a node with a share of 1 [N]
    """
    found = np.zeros((nodes.shape[0], share.size), dtype=np.bool_)
    knots, pieces, curvature = ct.knots, ct.pieces, ct.curvature
    for k in range(nodes.shape[0]):
        for i in range(share.size):
            x = rest[i, 0] + nodes[k, i, 0] - ct.travel * place[k]
            z = rest[i, 1] + nodes[k, i, 1] - ct.lift
            gap, _, _ = contact_frame(knots, pieces, curvature, x, z)
            # As the forces are compared, in this order, so that both say the same of every node.
            found[k, i] = ct.stiffness * share[i] * max(0.0, -gap) > threshold * share[i]
    return found


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
