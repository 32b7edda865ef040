"""Compiled bookkeeping of slip. `metrics.py` documents it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit
from .contact import contact_frame

Array = NDArray[np.float64]


@njit()
def slip_step(
    origin: Array, now: Array, nodes: Any, place: float, rates: Any, touching: Any, dt: float
) -> None:
    """Follow slip over a step, in place.

    Parameters
    ----------
    origin: of each node, see `SlipRecord`, shape (N,)
    now: current, lateral_displacement, rigid_slip and slid of a SlipRecord, shape (4,)
    nodes: displacements at the end of the step [m], shape (N, 2)
    place: of the object [m]
    rates: tangential speeds of the object relative to each node [m/s], shape (N,)
    touching: nodes in contact, shape (N,)
    dt: step [s]
    """
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
