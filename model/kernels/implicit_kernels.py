"""Compiled steps of chain, rigid part and object together, implicit and lagged. See `plant.py`.

BDF2 or backward Euler in the increments δ of one step, solved by Newton. The part of the chain that
cannot touch is eliminated first, from both rims inwards; only the window that may touch takes part
in every iteration on contact and friction. Rigid part (z) and object (x) border the system. Cost
O(N).
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit
from .bordered_kernels import back, linearise, sweep
from .contact import contact_frame, friction_at
from .friction import dahl_path, dahl_tangent

Array = NDArray[np.float64]

#: Below this change the springs are linearised well enough, and only the contact is iterated [m].
SETTLED = 1e-7
#: How a step ended: done, not solved, through a round object, or out of contact under a load.
SOLVED, UNSOLVED, PIERCED, LOST = 0, 1, 2, 3
#: A round object is pierced where a node is this share of its radius deep.
DEEPEST = 0.6
#: After so many iterations Newton hops over the jump in a spring's derivative at an axis; from then
#: on only half of what its turning adds is taken.
HOPPING = 6
#: No unknown moves by more than this share of the fingertip's half width in an iteration.
LEAP = 0.5
#: Nodes whose gap is below this at the start of a step are in its window at once [m].
REACH = 50e-6


class Rule(NamedTuple):
    """How the equations of a step are solved."""

    tolerance: float  # largest change of an unknown in the last iteration [m]
    max_iterations: int  # on contact and friction
    turning: float  # 1 follows the springs' angles within the step, 0 keeps those at its start
    second_order: bool  # BDF2 rather than backward Euler
    lagged: bool  # solve once, everything linearised at the start of the step


@njit()
def _contact_terms(
    gap: float, gap_before: float, n_x: float, n_z: float, e_x: float, e_z: float, stiff: float,
    mu: float, bristle: float, exponent: float, before: float, slip: float, slip_before: float,
    lagged: bool, travel: float, d_object: float,
) -> tuple[float, float, float, float, float, float, float, float, float]:  # fmt: skip
    """Friction, forces at δ = 0 of the linearised contact, and its stiffness.

    e is the node's increment relative to the object. The forces are those on the node and, reversed
    and along x, on the object. The stiffness is A (xx, xz, zz) with ∂F/∂u = −A, and C (xx, xz) with
    ∂F/∂(object) = C: a surface that stays takes no part in the object's motion but by friction.
    """
    normal = -stiff * gap
    if lagged:
        force = before
        secant = dahl_tangent(before, slip_before, normal, mu, bristle, exponent)
    else:
        force, secant = dahl_path(before, slip, -stiff * gap_before, normal, mu, bristle, exponent)
    t_x, t_z = -n_z, n_x
    a_xx = stiff * n_x * n_x + secant * t_x * t_x
    a_xz = stiff * n_x * n_z + secant * t_x * t_z
    a_zz = stiff * n_z * n_z + secant * t_z * t_z
    moving = travel * stiff
    c_xx = moving * n_x * n_x + secant * t_x * t_x
    c_xz = moving * n_x * n_z + secant * t_x * t_z
    # In e the object's motion counts as a change of the gap.
    f_x = n_x * normal + t_x * force + a_xx * e_x + a_xz * e_z + (a_xx - c_xx) * d_object
    f_z = n_z * normal + t_z * force + a_xz * e_x + a_zz * e_z + (a_xz - c_xz) * d_object
    f_object = travel * n_x * normal + t_x * force + c_xx * e_x + c_xz * e_z
    return force, f_x, f_z, f_object, a_xx, a_xz, a_zz, c_xx, c_xz


@njit()
def _iterate(
    ch: Any, ct: Any, w: Any, u: Array, friction: Array, slip_before: Array, object_x: float,
    a: int, b: int, drag: float, drag_before: float, held: Any, target: Any, lagged: bool,
) -> tuple[float, float]:  # fmt: skip
    """One Newton iteration on the window's contact.

    Returns the largest change of an unknown, and the largest but for the object's [m].
    """
    rest, share, delta = ch.rest, ch.share, w.delta
    diagonal, rhs, column, row = w.diagonal, w.rhs, w.column, w.row
    inverse, solved, into, out_of = w.inverse, w.solved, w.into, w.out_of
    now, moved, gap_before = w.force, w.slip, w.gap
    stiffness, mu, bristle, exponent = ct.stiffness, w.mu, ct.bristle, ct.exponent
    travel = ct.travel
    knots, pieces, curvature, lift = ct.knots, ct.pieces, ct.curvature, ct.lift
    d_object = w.border[1]
    # Border: s_b the right-hand sides, s_rr … s_oo the stiffness of rigid part and object.
    s_rb, s_rr, s_ro = w.corner[0] + target[0], w.corner[1], 0.0
    s_ob, s_or, s_oo = target[1] + drag_before, 0.0, drag
    # What eliminating the node before has left on this one.
    p0 = p1 = p2 = p3 = pb0 = pb1 = pc0 = pc1 = po0 = po1 = pr0 = pr1 = pq0 = pq1 = 0.0
    for i in range(a, b + 1):
        d_x, d_z = delta[i, 0], delta[i, 1]
        x, z = rest[i, 0] + u[i, 0] + d_x, rest[i, 1] + u[i, 1] + d_z
        gap, n_x, n_z = contact_frame(
            knots, pieces, curvature, x - travel * (object_x + d_object), z - lift
        )
        e_x, e_z = d_x - d_object, d_z
        slip = n_z * e_x - n_x * e_z
        moved[i] = slip
        force = f_x = f_z = a_xx = a_xz = a_zz = c_xx = c_xz = 0.0
        if gap < 0.0:
            force, f_x, f_z, f_object, a_xx, a_xz, a_zz, c_xx, c_xz = _contact_terms(
                gap, gap_before[i], n_x, n_z, e_x, e_z, stiffness * share[i], mu[i],
                bristle * share[i], exponent, friction[i], slip, slip_before[i], lagged, travel,
                d_object,
            )  # fmt: skip
            s_ob -= f_object
            s_oo += c_xx
        now[i] = force
        d0, d1 = diagonal[i, 0] + a_xx - p0, diagonal[i, 1] + a_xz - p1
        d2, d3 = diagonal[i, 2] + a_xz - p2, diagonal[i, 3] + a_zz - p3
        b0, b1 = rhs[i, 0] + f_x - pb0, rhs[i, 1] + f_z - pb1
        c0, c1 = column[i, 0] - pc0, column[i, 1] - pc1
        o0, o1 = -c_xx - po0, -c_xz - po1
        r0, r1 = row[i, 0] - pr0, row[i, 1] - pr1
        q0, q1 = -c_xx - pq0, -c_xz - pq1
        scale = 1.0 / (d0 * d3 - d1 * d2)
        v0, v1, v2, v3 = d3 * scale, -d1 * scale, -d2 * scale, d0 * scale
        inverse[i, 0], inverse[i, 1], inverse[i, 2], inverse[i, 3] = v0, v1, v2, v3
        solved[i, 0], solved[i, 1], solved[i, 2], solved[i, 3] = b0, b1, c0, c1
        solved[i, 4], solved[i, 5] = o0, o1
        g0, g1 = r0 * v0 + r1 * v2, r0 * v1 + r1 * v3
        h0, h1 = q0 * v0 + q1 * v2, q0 * v1 + q1 * v3
        s_rb -= g0 * b0 + g1 * b1
        s_rr -= g0 * c0 + g1 * c1
        s_ro -= g0 * o0 + g1 * o1
        s_ob -= h0 * b0 + h1 * b1
        s_or -= h0 * c0 + h1 * c1
        s_oo -= h0 * o0 + h1 * o1
        if i == b:
            break
        m0, m1, m2, m3 = into[i, 0], into[i, 1], into[i, 2], into[i, 3]
        k0, k1, k2, k3 = out_of[i, 0], out_of[i, 1], out_of[i, 2], out_of[i, 3]
        f0, f1 = m0 * v0 + m1 * v2, m0 * v1 + m1 * v3
        f2, f3 = m2 * v0 + m3 * v2, m2 * v1 + m3 * v3
        p0, p1, p2, p3 = f0 * k0 + f1 * k2, f0 * k1 + f1 * k3, f2 * k0 + f3 * k2, f2 * k1 + f3 * k3
        pb0, pb1 = f0 * b0 + f1 * b1, f2 * b0 + f3 * b1
        pc0, pc1 = f0 * c0 + f1 * c1, f2 * c0 + f3 * c1
        po0, po1 = f0 * o0 + f1 * o1, f2 * o0 + f3 * o1
        pr0, pr1 = g0 * k0 + g1 * k2, g0 * k1 + g1 * k3
        pq0, pq1 = h0 * k0 + h1 * k2, h0 * k1 + h1 * k3
    if held[0]:
        s_rb, s_rr, s_ro = target[0], 1.0, 0.0
    if held[1]:
        s_ob, s_or, s_oo = target[1], 0.0, 1.0
    scale = 1.0 / (s_rr * s_oo - s_ro * s_or)
    new_rigid, new_object = (s_rb * s_oo - s_ro * s_ob) * scale, (s_rr * s_ob - s_or * s_rb) * scale
    change = abs(new_rigid - w.border[0])
    w.border[0], w.border[1] = new_rigid, new_object
    x = z = 0.0
    for i in range(b, a - 1, -1):
        b0 = solved[i, 0] - solved[i, 2] * new_rigid - solved[i, 4] * new_object
        b1 = solved[i, 1] - solved[i, 3] * new_rigid - solved[i, 5] * new_object
        if i < b:
            b0 -= out_of[i, 0] * x + out_of[i, 1] * z
            b1 -= out_of[i, 2] * x + out_of[i, 3] * z
        x, z = inverse[i, 0] * b0 + inverse[i, 1] * b1, inverse[i, 2] * b0 + inverse[i, 3] * b1
        change = max(change, abs(delta[i, 0] - x), abs(delta[i, 1] - z))
        delta[i, 0], delta[i, 1] = x, z
    return max(change, abs(new_object - d_object)), change


@njit()
def _frictions(ch: Any, ct: Any, w: Any, u: Array, object_x: float, a: int, b: int) -> None:
    """µ under each node of a window, where it now is on the object."""
    for i in range(a, b + 1):
        x = ch.rest[i, 0] + u[i, 0] + w.delta[i, 0]
        w.mu[i] = friction_at(ct, x - (object_x + w.border[1]))


@njit()
def _scan(
    ch: Any, ct: Any, w: Any, u: Array, object_x: float, a: int, b: int
) -> tuple[int, int, int, int, float]:
    """Windows (first, last node) of what touches beyond a…b, and of what soon may; smallest gap."""
    n = ch.rest.shape[0]
    left, right, low, high = a, b, n, -1
    smallest = np.inf
    knots, pieces, curvature, lift = ct.knots, ct.pieces, ct.curvature, ct.lift
    surface = ct.travel * (object_x + w.border[1])
    for i in range(1, n - 1):
        # Summed as the next step will: a run that is cut here goes on bit for bit.
        x = ch.rest[i, 0] + (u[i, 0] + w.delta[i, 0])
        z = ch.rest[i, 1] + (u[i, 1] + w.delta[i, 1])
        gap, _, _ = contact_frame(knots, pieces, curvature, x - surface, z - lift)
        w.gap_after[i] = gap
        smallest = min(smallest, gap)
        if gap < REACH:
            low, high = min(low, i), i
            if gap < 0.0:
                left, right = min(left, i), max(right, i)
    if high < 0:
        low = high = (n + 1) // 2 - 1
    return left, right, low, high, smallest


@njit()
def _step(
    ch: Any, ct: Any, w: Any, u: Array, friction: Array, slip: Array, pose: Array, rate: Array,
    dt: float, before: float, held: Any, target: Any, rule: Any, window: Any,
) -> tuple[int, int, int]:  # fmt: skip
    """One step: how it ended (unless SOLVED, the state is untouched), and the next one's window."""
    n = ch.rest.shape[0]
    first, last = 1, n - 2
    a, b = window
    # Variable-step BDF2 from the rates of the step before; backward Euler where there was none.
    ratio = min(dt / before, 1.0) if rule.second_order and before > 0.0 else 0.0
    pace, carry = (1.0 + 2.0 * ratio) / ((1.0 + ratio) * dt), ratio / (1.0 + ratio)
    # What moved goes on moving: a guess that saves iterations. Outer nodes stay at 0 here.
    guess = dt if ratio > 0.0 else 0.0
    for i in range(first, n - 1):
        w.delta[i, 0], w.delta[i, 1] = guess * rate[i, 0], guess * rate[i, 1]
    w.delta[n - 1, :] = 0.0
    w.delta[0, :] = 0.0
    w.border[0], w.border[1] = guess * rate[n, 0], guess * rate[n, 1]
    drag, drag_before = ct.drag * pace, ct.drag * carry * rate[n, 1]
    farthest = LEAP * abs(ch.rest[n - 1, 0])
    varies = ct.places.size > 0
    fresh, ended = True, UNSOLVED
    gap = 0.0
    for k in range(rule.max_iterations):
        if fresh:
            turning = rule.turning if k < HOPPING else 0.5 * rule.turning
            linearise(ch, w, u, pose, rate, pace, carry, turning)
            sweep(w, first, a, 1)
            sweep(w, last, b, -1)
        if varies:
            _frictions(ch, ct, w, u, pose[1], a, b)
        change, leap = _iterate(
            ch, ct, w, u, friction, slip, pose[1], a, b, drag, drag_before, held, target,
            rule.lagged,
        )  # fmt: skip
        # A jump so far leads through the object, and its other side is free; or it is NaN.
        if not leap < farthest:
            break
        solved = rule.lagged or change < rule.tolerance
        fresh = rule.turning > 0.0 and change > SETTLED
        if not (solved or fresh):
            continue
        back(w, a - 1, first - 1, -1)
        back(w, b + 1, last + 1, 1)
        if not solved:
            continue
        left, right, low, high, gap = _scan(ch, ct, w, u, pose[1], a, b)
        if rule.lagged or (left == a and right == b):
            ended = SOLVED
            break
        a, b, fresh = left, right, True
    if ended != SOLVED:
        return UNSOLVED, a, b
    if varies:  # at the end of the step
        _frictions(ch, ct, w, u, pose[1], a, b)
    if rule.lagged:
        _return_map(ch, ct, w, u, friction, pose[1], a, b)
    if not np.isfinite(w.delta).all():
        return UNSOLVED, a, b
    if ct.curvature > 0.0 and gap < -DEEPEST / ct.curvature:
        return PIERCED, a, b
    if gap >= 0.0 and not held[1] and target[1] != 0.0:
        return LOST, a, b
    w.delta[0, 1] = w.border[0]
    w.delta[n - 1, 1] = w.border[0]
    for i in range(n):
        for k in range(2):
            u[i, k] += w.delta[i, k]
            rate[i, k] = w.delta[i, k] / dt
        w.gap[i] = w.gap_after[i]
        inside = a <= i <= b
        # The last iteration moved the node a little after its friction was found.
        limit = w.mu[i] * ct.stiffness * ch.share[i] * max(0.0, -w.gap[i])
        friction[i] = min(max(w.force[i], -limit), limit) if inside else 0.0
        slip[i] = w.slip[i] / dt if inside else 0.0
    for k in range(2):
        pose[k] += w.border[k]
        rate[n, k] = w.border[k] / dt
    return SOLVED, max(low - 1, first), min(high + 1, last)


@njit()
def _return_map(
    ch: Any, ct: Any, w: Any, u: Array, friction: Array, object_x: float, a: int, b: int
) -> None:
    """Friction of a lagged step, after it: the map that cannot leave the cone."""
    knots, pieces, curvature, lift = ct.knots, ct.pieces, ct.curvature, ct.lift
    surface = ct.travel * (object_x + w.border[1])
    for i in range(a, b + 1):
        d_x, d_z = w.delta[i, 0], w.delta[i, 1]
        x, z = ch.rest[i, 0] + u[i, 0] + d_x, ch.rest[i, 1] + u[i, 1] + d_z
        gap, n_x, n_z = contact_frame(knots, pieces, curvature, x - surface, z - lift)
        w.slip[i] = n_z * (d_x - w.border[1]) - n_x * d_z
        normal = ct.stiffness * ch.share[i] * max(0.0, -gap)
        before = -ct.stiffness * ch.share[i] * w.gap[i]
        w.force[i], _ = dahl_path(
            friction[i], w.slip[i], before, normal, w.mu[i], ct.bristle * ch.share[i], ct.exponent
        )


class Record(NamedTuple):
    """Where a run is written to, a row for each recorded instant."""

    nodes: Array  # (R, N, 2)
    pose: Array  # (R, 2) rigid part, object
    friction: Array  # (R, N)
    slip: Array  # (R, N)
    rate: Array  # (R, N + 1, 2)


def record(rows: int, nodes: int) -> Record:
    """Memory for a run of that many recorded instants."""
    shapes = ((rows, nodes, 2), (rows, 2), (rows, nodes), (rows, nodes), (rows, nodes + 1, 2))
    return Record(*(np.zeros(shape) for shape in shapes))


@njit()
def advance(
    ch: Any, ct: Any, w: Any, u: Array, friction: Array, slip: Array, pose: Array, rate: Array,
    dt: float, before: float, held: Any, drive: Array, rule: Any, out: Any, done: int, every: int,
) -> tuple[int, int]:  # fmt: skip
    """Advance the state in place, a step for each row of `drive` that is not done yet.

    Parameters
    ----------
    ch, ct, w: Chain, Contact and Scratch
    u, friction, slip, pose, rate: state: displacements (N, 2), Dahl forces (N,), tangential speeds
        (N,), (rigid part, object), and rates of the nodes and, last, of the pose (N + 1, 2)
    dt: step [s]
    before: the step that led to the rates [s]; 0 if there was none
    held: for rigid part and object, whether its position is given rather than its force
    drive: force [N] or position [m] of both at the end of each step, shape (steps, 2)
    rule: Rule
    out, every: Record, written after every so many steps
    done: steps done before

    Returns
    -------
    Steps done, and how the last one ended. Fewer than asked for: the state is that before the step
    that could not be done.
    """
    w.delta[:] = 0.0
    w.border[:] = 0.0
    w.mu[:] = ct.mu
    _, _, low, high, _ = _scan(ch, ct, w, u, pose[1], 0, 0)
    for i in range(w.gap.size):
        w.gap[i] = w.gap_after[i]
    window = (max(low - 1, 1), min(high + 1, ch.rest.shape[0] - 2))
    for k in range(done, drive.shape[0]):
        goal_rigid = drive[k, 0] - pose[0] if held[0] else drive[k, 0]
        goal_object = drive[k, 1] - pose[1] if held[1] else drive[k, 1]
        ended, low, high = _step(
            ch, ct, w, u, friction, slip, pose, rate, dt, before, held, (goal_rigid, goal_object),
            rule, window,
        )  # fmt: skip
        window = (low, high)
        if ended != SOLVED:
            return k, ended
        before = dt
        if (k + 1) % every == 0:
            row = (k + 1) // every
            out.nodes[row] = u
            out.pose[row] = pose
            out.friction[row] = friction
            out.slip[row] = slip
            out.rate[row] = rate
    return drive.shape[0], SOLVED
