"""Compiled bordered system of one step: filled, swept from both rims, and solved backwards.

Unknowns are the increments δ of the nodes in a step, block-tridiagonal; the rigid part (z) borders
them here, the object (x) only where it may touch (`implicit_kernels.py`). Cost O(N).
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit
from .springs import spring

Array = NDArray[np.float64]


class Scratch(NamedTuple):
    """Memory of a step, so that none is allocated in the loop. Blocks are (xx, xz, zx, zz)."""

    diagonal: Array  # (N, 4) of each node, without contact
    into: Array  # (N − 1, 4) row i + 1, column i
    out_of: Array  # (N − 1, 4) row i, column i + 1
    rhs: Array  # (N, 2)
    column: Array  # (N, 2) of the rigid part
    row: Array  # (N, 2) of the rigid part
    corner: Array  # (2,) the rigid part's own equation: right-hand side, diagonal
    inverse: Array  # (N, 4) of each block once those before it are eliminated
    solved: Array  # (N, 6) its right-hand side and columns of rigid part and object, as then
    border: Array  # (2,) increments of rigid part and object
    delta: Array  # (N, 2) increments of the nodes
    force: Array  # (N,) friction at the end of the step
    slip: Array  # (N,) tangential motion in the step
    gap: Array  # (N,) at the start of the step
    gap_after: Array  # (N,) at its end
    mu: Array  # (N,) of the object under each node


def scratch(nodes: int) -> Scratch:
    """Memory for chains of that many nodes."""
    n = nodes
    blocks = ((n, 4), (n - 1, 4), (n - 1, 4))
    shapes = (*blocks, (n, 2), (n, 2), (n, 2), (2,), (n, 4), (n, 6), (2,), (n, 2))
    return Scratch(*(np.zeros(shape) for shape in (*shapes, (n,), (n,), (n,), (n,), (n,))))


@njit()
def linearise(
    ch: Any, w: Any, u: Array, pose: Array, rate: Array, pace: float, carry: float, turning: float
) -> None:
    """Fill the bordered system without contact, springs linearised at u + δ.

    The rate at the end of the step is pace·δ − carry·(rate before).
    """
    n = ch.rest.shape[0]
    rest, delta, law = ch.rest, w.delta, ch.law
    diagonal, rhs, column, row = w.diagonal, w.rhs, w.column, w.row
    rigid, d_rigid = pose[0] + w.border[0], w.border[0]
    total, stiff = ch.damping_rigid * carry * rate[n, 0], ch.damping_rigid * pace
    # The membrane spring before the node: a force that is constant in δ, and its stiffness.
    p_x = p_z = p_xx = p_xz = p_zx = p_zz = 0.0
    for i in range(n - 1):
        here_x, here_z = delta[i, 0], (delta[i, 1] if i >= 1 else d_rigid)
        next_x, next_z = delta[i + 1, 0], (delta[i + 1, 1] if i < n - 2 else d_rigid)
        e_x, e_z = next_x - here_x, next_z - here_z
        dx, dz = u[i + 1, 0] - u[i, 0] + e_x, u[i + 1, 1] - u[i, 1] + e_z
        f_x, f_z, xx, xz, zx, zz = spring(
            law, rest[i + 1, 0] - rest[i, 0] + dx, rest[i + 1, 1] - rest[i, 1] + dz,
            dx, dz, ch.membrane[i], ch.cross_membrane[i], turning, 0.0,
        )  # fmt: skip
        m_x, m_z = f_x - xx * e_x - xz * e_z, f_z - zx * e_x - zz * e_z
        w.into[i, 0], w.into[i, 1], w.into[i, 2], w.into[i, 3] = -xx, -xz, -zx, -zz
        w.out_of[i, 0], w.out_of[i, 1], w.out_of[i, 2], w.out_of[i, 3] = -xx, -xz, -zx, -zz
        if i < 1:  # the outer nodes move with the rigid part
            total += m_z
            stiff += zz
        else:
            dx, dz = u[i, 0] + here_x, u[i, 1] + here_z - rigid
            f_x, f_z, t_xx, t_xz, t_zx, t_zz = spring(
                law, rest[i, 0] + dx, rest[i, 1] + dz, dx, dz, ch.tissue[i], ch.cross_tissue[i],
                turning, 0.0,
            )  # fmt: skip
            e_x, e_z = here_x, here_z - d_rigid
            g_x, g_z = f_x - t_xx * e_x - t_xz * e_z, f_z - t_zx * e_x - t_zz * e_z
            damp = ch.damping[i] * pace
            c_x, c_z = ch.damping[i] * carry * rate[i, 0], ch.damping[i] * carry * rate[i, 1]
            diagonal[i, 0], diagonal[i, 1] = t_xx + p_xx + xx + damp, t_xz + p_xz + xz
            diagonal[i, 2], diagonal[i, 3] = t_zx + p_zx + zx, t_zz + p_zz + zz + damp
            rhs[i, 0], rhs[i, 1] = m_x - p_x - g_x + c_x, m_z - p_z - g_z + c_z
            held_xz = held_zz = held_zx = 0.0
            if i == 1:
                held_xz, held_zz, held_zx = p_xz, p_zz, p_zx
            if i == n - 2:
                held_xz, held_zz, held_zx = held_xz + xz, held_zz + zz, held_zx + zx
                total -= m_z
                stiff += zz
            column[i, 0], column[i, 1] = -t_xz - held_xz, -t_zz - held_zz
            row[i, 0], row[i, 1] = -t_zx - held_zx, -t_zz - held_zz
            total += g_z
            stiff += t_zz
        p_x, p_z, p_xx, p_xz, p_zx, p_zz = m_x, m_z, xx, xz, zx, zz
    w.corner[0], w.corner[1] = total, stiff


@njit()
def sweep(w: Any, start: int, stop: int, to: int) -> None:
    """Eliminate the nodes from `start` on, in the direction `to` (±1), into node `stop`."""
    if start == stop:
        return
    diagonal, rhs, column, row = w.diagonal, w.rhs, w.column, w.row
    inverse, solved = w.inverse, w.solved
    ahead, back = (w.into, w.out_of) if to > 0 else (w.out_of, w.into)
    d0, d1, d2, d3 = diagonal[start, 0], diagonal[start, 1], diagonal[start, 2], diagonal[start, 3]
    b0, b1 = rhs[start, 0], rhs[start, 1]
    c0, c1 = column[start, 0], column[start, 1]
    r0, r1 = row[start, 0], row[start, 1]
    total, stiff = w.corner[0], w.corner[1]
    i = start
    while i != stop:
        j = i + to
        k = min(i, j)
        scale = 1.0 / (d0 * d3 - d1 * d2)
        v0, v1, v2, v3 = d3 * scale, -d1 * scale, -d2 * scale, d0 * scale
        inverse[i, 0], inverse[i, 1], inverse[i, 2], inverse[i, 3] = v0, v1, v2, v3
        solved[i, 0], solved[i, 1], solved[i, 2], solved[i, 3] = b0, b1, c0, c1
        solved[i, 4] = solved[i, 5] = 0.0
        m0, m1, m2, m3 = ahead[k, 0], ahead[k, 1], ahead[k, 2], ahead[k, 3]
        o0, o1, o2, o3 = back[k, 0], back[k, 1], back[k, 2], back[k, 3]
        f0, f1 = m0 * v0 + m1 * v2, m0 * v1 + m1 * v3
        f2, f3 = m2 * v0 + m3 * v2, m2 * v1 + m3 * v3
        q0, q1 = r0 * v0 + r1 * v2, r0 * v1 + r1 * v3
        total -= q0 * b0 + q1 * b1
        stiff -= q0 * c0 + q1 * c1
        d0, d1 = diagonal[j, 0] - f0 * o0 - f1 * o2, diagonal[j, 1] - f0 * o1 - f1 * o3
        d2, d3 = diagonal[j, 2] - f2 * o0 - f3 * o2, diagonal[j, 3] - f2 * o1 - f3 * o3
        b0, b1 = rhs[j, 0] - f0 * b0 - f1 * b1, rhs[j, 1] - f2 * b0 - f3 * b1
        c0, c1 = column[j, 0] - f0 * c0 - f1 * c1, column[j, 1] - f2 * c0 - f3 * c1
        r0, r1 = row[j, 0] - q0 * o0 - q1 * o2, row[j, 1] - q0 * o1 - q1 * o3
        i = j
    diagonal[i, 0], diagonal[i, 1], diagonal[i, 2], diagonal[i, 3] = d0, d1, d2, d3
    rhs[i, 0], rhs[i, 1] = b0, b1
    column[i, 0], column[i, 1] = c0, c1
    row[i, 0], row[i, 1] = r0, r1
    w.corner[0], w.corner[1] = total, stiff


@njit()
def back(w: Any, start: int, stop: int, to: int) -> None:
    """Increments of the nodes from `start` on, in the direction `to` (±1), one from the other.

    Node `stop` is not done; the first follows from its neighbour behind.
    """
    s, v, delta = w.solved, w.inverse, w.delta
    coupling = w.out_of if to < 0 else w.into
    d_rigid, d_object = w.border[0], w.border[1]
    i = start
    while i != stop:
        j = i - to
        k = min(i, j)
        x, z = delta[j, 0], delta[j, 1]
        b0 = s[i, 0] - s[i, 2] * d_rigid - s[i, 4] * d_object
        b1 = s[i, 1] - s[i, 3] * d_rigid - s[i, 5] * d_object
        b0 -= coupling[k, 0] * x + coupling[k, 1] * z
        b1 -= coupling[k, 2] * x + coupling[k, 3] * z
        delta[i, 0] = v[i, 0] * b0 + v[i, 1] * b1
        delta[i, 1] = v[i, 2] * b0 + v[i, 3] * b1
        i += to
