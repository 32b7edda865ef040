"""Compiled kernels of the node chain: implicit step and contact forces. `plant.py` documents them.

Unknowns of a step: the inner nodes (x, z), the rigid part (z) and the object (x). The nodes form a
block-tridiagonal system; rigid part and object border it, so a solve costs O(N).
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .friction import dahl_step

Array = NDArray[np.float64]


class Coefficients(NamedTuple):
    """Numbers of one plant, already scaled to its node spacing (SI)."""

    rest: Array  # (N, 2) node positions
    sign: Array  # (N,) Poisson sign −1, 0, +1
    tissue: float
    membrane: float
    poisson_tissue: float
    poisson_membrane: float
    damping_node: float
    damping_rigid: float
    drag: float
    contact: float
    curvature: float
    apex: float  # z of the object's surface at x = 0
    mu: float
    bristle: float
    exponent: float


@njit(cache=True)
def contact_frame(
    x: float, z: float, apex: float, curvature: float, object_x: float
) -> tuple[float, float, float]:
    """Gap to the object and the object's outward normal (n_x, n_z) at the foot of a point."""
    if curvature == 0.0:
        return apex - z, 0.0, -1.0
    radius = 1.0 / curvature
    dx = x - object_x
    dz = z - (apex + radius)
    distance = np.sqrt(dx * dx + dz * dz)
    return distance - radius, dx / distance, dz / distance


@njit(cache=True)
def contact_frames(c: Any, points: Array, object_x: float) -> tuple[Array, Array]:
    """Gap (N,) and object normal (N, 2) of points (N, 2) in the ground frame."""
    gap = np.empty(points.shape[0])
    normal = np.empty(points.shape)
    for i in range(points.shape[0]):
        gap[i], normal[i, 0], normal[i, 1] = contact_frame(
            points[i, 0], points[i, 1], c.apex, c.curvature, object_x
        )
    return gap, normal


@njit(cache=True)
def spring_directions(rest: Array, u: Array, rigid: float, tissue: Array, membrane: Array) -> None:
    """|sin|, |cos| of each tissue spring (N, 2) and membrane spring (N−1, 2) as deformed."""
    n = rest.shape[0]
    for i in range(n):
        dx = abs(rest[i, 0] + u[i, 0])
        dz = abs(rest[i, 1] + u[i, 1] - rigid)
        length = np.sqrt(dx * dx + dz * dz)
        tissue[i, 0] = dx / length
        tissue[i, 1] = dz / length
    for i in range(n - 1):
        dx = abs(rest[i + 1, 0] + u[i + 1, 0] - rest[i, 0] - u[i, 0])
        dz = abs(rest[i + 1, 1] + u[i + 1, 1] - rest[i, 1] - u[i, 1])
        length = np.sqrt(dx * dx + dz * dz)
        membrane[i, 0] = dx / length
        membrane[i, 1] = dz / length


@njit(cache=True)
def spring_block(
    direction: Array, stiffness: float, poisson: float, sign: float, out: Array
) -> None:
    """2×2 stiffness of one spring, rows and columns (x, z) (thesis Eq. 3 with erratum E6)."""
    out[0, 0] = stiffness * direction[0]
    out[0, 1] = stiffness * poisson * sign * direction[1]
    out[1, 0] = -stiffness * poisson * sign * direction[0]
    out[1, 1] = stiffness * direction[1]


@njit(cache=True)
def spring_blocks(c: Any, u: Array, rigid: float, tissue: Array, membrane: Array) -> None:
    """Stiffness blocks of all tissue springs (N, 2, 2) and membrane springs (N−1, 2, 2)."""
    n = c.rest.shape[0]
    tissue_dir = np.empty((n, 2))
    membrane_dir = np.empty((n - 1, 2))
    spring_directions(c.rest, u, rigid, tissue_dir, membrane_dir)
    for i in range(n):
        spring_block(tissue_dir[i], c.tissue, c.poisson_tissue, c.sign[i], tissue[i])
    for i in range(n - 1):
        sign = membrane_sign(c.sign, i)
        spring_block(membrane_dir[i], c.membrane, c.poisson_membrane, sign, membrane[i])


@njit(cache=True)
def blunt_sign(value: float, width: float) -> float:
    """Sign of a value, without the jump at zero where a width is given."""
    if width == 0.0:
        return np.sign(value)
    return value / np.sqrt(value * value + width * width)


@njit(cache=True)
def spring_tangent(
    reach_x: float,
    reach_z: float,
    dx: float,
    dz: float,
    stiffness: float,
    poisson: float,
    sign: float,
    blunt: float,
    force: Array,
    tangent: Array,
) -> None:
    """Force of one spring and its derivative, the turning of the spring included.

    Parameters
    ----------
    reach_x, reach_z: vector between the spring's ends as deformed [m]
    dx, dz: displacement of one end relative to the other [m]
    stiffness, poisson, sign: of the spring, as in `spring_block`
    blunt: slope below which the jump of the derivative at an axis is smoothed; 0 is exact
    force: result, shape (2,) [N]
    tangent: result, ∂force/∂(dx, dz), shape (2, 2) [N/m]
    """
    length = np.sqrt(reach_x * reach_x + reach_z * reach_z)
    sin, cos = abs(reach_x) / length, abs(reach_z) / length
    cubed = length**3
    sin_x = blunt_sign(reach_x, blunt * length) * reach_z * reach_z / cubed
    sin_z = -abs(reach_x) * reach_z / cubed
    cos_x = -abs(reach_z) * reach_x / cubed
    cos_z = blunt_sign(reach_z, blunt * length) * reach_x * reach_x / cubed
    cross = poisson * sign
    force[0] = stiffness * (sin * dx + cross * cos * dz)
    force[1] = stiffness * (cos * dz - cross * sin * dx)
    tangent[0, 0] = stiffness * (sin + sin_x * dx + cross * cos_x * dz)
    tangent[0, 1] = stiffness * (cross * cos + sin_z * dx + cross * cos_z * dz)
    tangent[1, 0] = stiffness * (cos_x * dz - cross * sin - cross * sin_x * dx)
    tangent[1, 1] = stiffness * (cos + cos_z * dz - cross * sin_z * dx)


@njit(cache=True)
def chain_tangent(
    c: Any,
    u: Array,
    blunt: float,
    forces: Array,
    lower: Array,
    diagonal: Array,
    upper: Array,
) -> None:
    """Nodal forces K(u)·u (N, 2) and the blocks of their derivative at the N − 2 inner nodes.

    Displacements are relative to the rigid part. Blocks as in `solve_block_tridiagonal`.
    """
    n = c.rest.shape[0]
    force, tangent = np.empty(2), np.empty((2, 2))
    forces[:] = 0.0
    diagonal[:] = 0.0
    for i in range(1, n - 1):
        spring_tangent(
            c.rest[i, 0] + u[i, 0],
            c.rest[i, 1] + u[i, 1],
            u[i, 0],
            u[i, 1],
            c.tissue,
            c.poisson_tissue,
            c.sign[i],
            blunt,
            force,
            tangent,
        )
        forces[i] += force
        diagonal[i - 1] += tangent
    for i in range(n - 1):
        dx, dz = u[i + 1, 0] - u[i, 0], u[i + 1, 1] - u[i, 1]
        spring_tangent(
            c.rest[i + 1, 0] - c.rest[i, 0] + dx,
            c.rest[i + 1, 1] - c.rest[i, 1] + dz,
            dx,
            dz,
            c.membrane,
            c.poisson_membrane,
            membrane_sign(c.sign, i),
            blunt,
            force,
            tangent,
        )
        forces[i] -= force
        forces[i + 1] += force
        if i > 0:
            diagonal[i - 1] += tangent
        if i < n - 2:
            diagonal[i] += tangent
        if 0 < i < n - 2:
            upper[i - 1] = -tangent
            lower[i] = -tangent


@njit(cache=True)
def membrane_sign(sign: Array, i: int) -> float:
    """Poisson sign of the membrane spring between nodes i and i + 1: that of its half."""
    return np.sign(sign[i] + sign[i + 1])


@njit(cache=True)
def inverse2(a: Array, out: Array) -> None:
    """Inverse of a 2×2 matrix."""
    det = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    out[0, 0] = a[1, 1] / det
    out[0, 1] = -a[0, 1] / det
    out[1, 0] = -a[1, 0] / det
    out[1, 1] = a[0, 0] / det


@njit(cache=True)
def solve_block_tridiagonal(lower: Array, diagonal: Array, upper: Array, rhs: Array) -> None:
    """Solve in place for several right-hand sides: blocks (n, 2, 2), rhs (n, 2, m)."""
    n, _, m = rhs.shape
    inv = np.empty((2, 2))
    factor = np.empty((2, 2))
    for i in range(n):
        if i > 0:
            for r in range(2):
                for col in range(2):
                    factor[r, col] = lower[i, r, 0] * inv[0, col] + lower[i, r, 1] * inv[1, col]
            for r in range(2):
                for col in range(2):
                    diagonal[i, r, col] -= (
                        factor[r, 0] * upper[i - 1, 0, col] + factor[r, 1] * upper[i - 1, 1, col]
                    )
                for k in range(m):
                    rhs[i, r, k] -= (
                        factor[r, 0] * rhs[i - 1, 0, k] + factor[r, 1] * rhs[i - 1, 1, k]
                    )
        inverse2(diagonal[i], inv)
        diagonal[i] = inv
    for i in range(n - 1, -1, -1):
        for k in range(m):
            b0, b1 = rhs[i, 0, k], rhs[i, 1, k]
            if i < n - 1:
                b0 -= upper[i, 0, 0] * rhs[i + 1, 0, k] + upper[i, 0, 1] * rhs[i + 1, 1, k]
                b1 -= upper[i, 1, 0] * rhs[i + 1, 0, k] + upper[i, 1, 1] * rhs[i + 1, 1, k]
            rhs[i, 0, k] = diagonal[i, 0, 0] * b0 + diagonal[i, 0, 1] * b1
            rhs[i, 1, k] = diagonal[i, 1, 0] * b0 + diagonal[i, 1, 1] * b1


@njit(cache=True)
def implicit_step(
    c: Any,
    u: Array,
    friction: Array,
    slip: Array,
    pose: Array,
    dt: float,
    grip: float,
    load: float,
    tolerance: float,
    max_iterations: int,
) -> int:
    """Advance (u, friction, pose) in place by one backward-Euler step; slip (N,) is returned in m.

    Angles are those at the start of the step. Newton on the normal forces, secant modulus on the
    friction. Returns the iterations used, or −1 without convergence (the state is then unusable).
    """
    n = c.rest.shape[0]
    m = n - 2
    tissue = np.empty((n, 2, 2))
    membrane = np.empty((n - 1, 2, 2))
    spring_blocks(c, u, pose[0], tissue, membrane)
    u_old = u.copy()
    rigid_old, object_old = pose[0], pose[1]
    force_new = np.zeros(n)
    lower = np.empty((m, 2, 2))
    upper = np.empty((m, 2, 2))
    diagonal = np.empty((m, 2, 2))
    rhs = np.empty((m, 2, 3))
    row_rigid = np.empty((m, 2))
    row_object = np.empty((m, 2))
    damp = c.damping_node / dt
    for iteration in range(max_iterations):
        rigid, obj = pose[0], pose[1]
        r_rigid = c.damping_rigid / dt * (rigid - rigid_old) - grip
        r_object = c.drag / dt * (obj - object_old) - load
        d_rigid = c.damping_rigid / dt
        d_object = c.drag / dt
        # The outer ends move with the rigid part: their membrane springs pull on it directly.
        for end, inner, spring in ((0, 1, 0), (n - 1, n - 2, n - 2)):
            dx = u[inner, 0] - u[end, 0]
            dz = u[inner, 1] - u[end, 1]
            r_rigid -= membrane[spring, 1, 0] * dx + membrane[spring, 1, 1] * dz
            d_rigid += membrane[spring, 1, 1]
        for j in range(m):
            i = j + 1
            dx = u[i, 0]
            dz = u[i, 1] - rigid
            f_x = tissue[i, 0, 0] * dx + tissue[i, 0, 1] * dz
            f_z = tissue[i, 1, 0] * dx + tissue[i, 1, 1] * dz
            r_rigid -= f_z
            d_rigid += tissue[i, 1, 1]
            f_x += damp * (u[i, 0] - u_old[i, 0])
            f_z += damp * (u[i, 1] - u_old[i, 1])
            for r in range(2):
                row_rigid[j, r] = -tissue[i, 1, r]
                rhs[j, r, 1] = -tissue[i, r, 1]
                for k in range(2):
                    before, after = membrane[i - 1, r, k], membrane[i, r, k]
                    diagonal[j, r, k] = tissue[i, r, k] + before + after
                    lower[j, r, k] = -before
                    upper[j, r, k] = -after
                    force = before * (u[i, k] - u[i - 1, k]) + after * (u[i, k] - u[i + 1, k])
                    if r == 0:
                        f_x += force
                    else:
                        f_z += force
                diagonal[j, r, r] += damp
                if j == 0:
                    row_rigid[j, r] -= membrane[0, 1, r]
                    rhs[j, r, 1] -= membrane[0, r, 1]
                if j == m - 1:
                    row_rigid[j, r] -= membrane[n - 2, 1, r]
                    rhs[j, r, 1] -= membrane[n - 2, r, 1]
            gap, nx, nz = contact_frame(
                c.rest[i, 0] + u[i, 0], c.rest[i, 1] + u[i, 1], c.apex, c.curvature, obj
            )
            tx, tz = -nz, nx
            slip[i] = tx * (obj - object_old - u[i, 0] + u_old[i, 0]) - tz * (u[i, 1] - u_old[i, 1])
            row_object[j, 0] = row_object[j, 1] = 0.0
            rhs[j, 0, 2] = rhs[j, 1, 2] = 0.0
            force_new[i] = 0.0
            if gap < 0.0:
                normal = -c.contact * gap
                force, secant = dahl_step(friction[i], slip[i], normal, c.mu, c.bristle, c.exponent)
                force_new[i] = force
                c_x = nx * normal + tx * force
                c_z = nz * normal + tz * force
                f_x -= c_x
                f_z -= c_z
                r_object += c_x
                # ∂Fc/∂u = −A and ∂Fc/∂q = A·e_x with A below.
                a_xx = c.contact * nx * nx + secant * tx * tx
                a_xz = c.contact * nx * nz + secant * tx * tz
                a_zz = c.contact * nz * nz + secant * tz * tz
                diagonal[j, 0, 0] += a_xx
                diagonal[j, 0, 1] += a_xz
                diagonal[j, 1, 0] += a_xz
                diagonal[j, 1, 1] += a_zz
                rhs[j, 0, 2] = -a_xx
                rhs[j, 1, 2] = -a_xz
                row_object[j, 0] = -a_xx
                row_object[j, 1] = -a_xz
                d_object += a_xx
            rhs[j, 0, 0] = -f_x
            rhs[j, 1, 0] = -f_z
        solve_block_tridiagonal(lower, diagonal, upper, rhs)
        # Schur complement of the two border unknowns.
        s00, s01, s10, s11 = d_rigid, 0.0, 0.0, d_object
        b0, b1 = -r_rigid, -r_object
        for j in range(m):
            for r in range(2):
                b0 -= row_rigid[j, r] * rhs[j, r, 0]
                b1 -= row_object[j, r] * rhs[j, r, 0]
                s00 -= row_rigid[j, r] * rhs[j, r, 1]
                s01 -= row_rigid[j, r] * rhs[j, r, 2]
                s10 -= row_object[j, r] * rhs[j, r, 1]
                s11 -= row_object[j, r] * rhs[j, r, 2]
        det = s00 * s11 - s01 * s10
        d_w = (s11 * b0 - s01 * b1) / det
        d_q = (s00 * b1 - s10 * b0) / det
        change = max(abs(d_w), abs(d_q))
        for j in range(m):
            for r in range(2):
                delta = rhs[j, r, 0] - rhs[j, r, 1] * d_w - rhs[j, r, 2] * d_q
                u[j + 1, r] += delta
                change = max(change, abs(delta))
        pose[0] += d_w
        pose[1] += d_q
        u[0, 1] = u[n - 1, 1] = pose[0]
        if not np.isfinite(change):
            return -1
        if change < tolerance:
            friction[:] = force_new
            return iteration + 1
    return -1
