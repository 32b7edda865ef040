"""Force on one node of a dome that touches an object, and its tangent."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit
from .dahl_vector_kernels import dahl_vector
from .distance_kernels import GRID, PLANE, distance

Array = NDArray[np.float64]


class Touched(NamedTuple):
    """An object as the kernels take it: its shape in its own frame, and its material per area.

    Attributes
    ----------
    kind, numbers, grid, origin, cells: of its `Shape`
    stiffness: penalty stiffness [N/m³]
    friction: µ
    bristle: Dahl stiffness σ0 [N/m³]
    exponent: Dahl exponent n
    """

    kind: int
    numbers: Array
    grid: Array
    origin: Array
    cells: float
    stiffness: float
    friction: float
    bristle: float
    exponent: float


class Stiffening(NamedTuple):
    """Factor s = 1 + share·ε^power on the normal force, ε the indentation over the thickness."""

    share: float
    power: float
    thickness: float


class Pose(NamedTuple):
    """Place of the object before a step and after it; rotations take its own frame to the world."""

    old_rotation: Array
    old_place: Array
    rotation: Array
    place: Array


#: Distance over which the turn of an object's normal is measured [m].
_ASIDE = 1e-6
#: Share of the limit that an elastic step must reach to be tried first.
_TRIAL = 0.3
#: A node slides on in the direction of its friction above this cosine, and this share of the limit.
_ALIKE = 0.9


@njit()
def gap_at(thing: Touched, pose: Pose, x: float, y: float, z: float, normal: Array) -> float:
    """Signed distance [m] of a place in the world; its normal in the world goes into `normal`."""
    r, p = pose.rotation, pose.place
    a, b, c = x - p[0], y - p[1], z - p[2]
    gap, na, nb, nc = distance(
        thing.kind, thing.numbers, thing.grid, thing.origin, thing.cells,
        r[0, 0] * a + r[1, 0] * b + r[2, 0] * c,
        r[0, 1] * a + r[1, 1] * b + r[2, 1] * c,
        r[0, 2] * a + r[1, 2] * b + r[2, 2] * c,
    )  # fmt: skip
    for k in range(3):
        normal[k] = r[k, 0] * na + r[k, 1] * nb + r[k, 2] * nc
    return gap


@njit(forceinline=True)
def touch(
    thing: Touched,
    pose: Pose,
    stiff: Stiffening,
    area: float,
    before: Array,
    now: Array,
    indentation: float,
    radial: Array,
    old: Array,
    trial: bool,
    secant: bool,
    tangent: bool,
    normal: Array,
    work: Array,
    linear: Array,
    true: Array,
    slope: Array,
    stiffened: Array,
) -> bool:
    """Force of the object on a node, as the linear skin carries it and as it is.

    Parameters
    ----------
    before, now: place of the node before and after the step [m]
    indentation: of the node towards the core, along `radial` [m]
    old: friction before the step, turned with the object [N]
    trial: whether a node that was not sliding that way sticks elastically
    secant: see `dahl_vector`
    tangent: whether `slope` is wanted
    normal: the object's at the node (output)
    work: shape (11,)
    linear, true: forces [N], shape (3,) (outputs)
    slope: derivative of `linear` by `now` [N/m], shape (3, 3) (output)
    stiffened: s, and Fn·(ds/s) per indentation [N/m], shape (2,) (output)

    Returns
    -------
    Whether the node touches; otherwise forces and slopes are zero.
    """
    gap = gap_at(thing, pose, now[0], now[1], now[2], normal)
    if gap >= 0.0:
        linear[:] = 0.0
        true[:] = 0.0
        slope[:] = 0.0
        stiffened[0], stiffened[1] = 1.0, 0.0
        return False
    stiffness = thing.stiffness * area
    force = -stiffness * gap
    factor, bend = 1.0, 0.0
    if indentation > 0.0 and stiff.share > 0.0:
        depth = indentation / stiff.thickness
        rise = stiff.share * depth**stiff.power
        factor = 1.0 + rise
        # d(1/s)/dε · dε/d(indentation)
        bend = -rise * stiff.power / (depth * factor * factor * stiff.thickness)
    stiffened[0], stiffened[1] = factor, -force * bend * factor
    n0, n1, n2 = normal
    aside = work[8:]
    if abs(n2) < 0.9:
        b0, b1, b2 = -n1, n0, 0.0
    else:
        b0, b1, b2 = 0.0, -n2, n1
    size = 1.0 / np.sqrt(b0 * b0 + b1 * b1 + b2 * b2)
    b0, b1, b2 = b0 * size, b1 * size, b2 * size
    c0, c1, c2 = n1 * b2 - n2 * b1, n2 * b0 - n0 * b2, n0 * b1 - n1 * b0
    # Where the point of the object that the node now touches was, as seen from where the node was
    r, p, r0, p0 = pose.rotation, pose.place, pose.old_rotation, pose.old_place
    q0, q1, q2 = now[0] - p[0], now[1] - p[1], now[2] - p[2]
    l0 = r[0, 0] * q0 + r[1, 0] * q1 + r[2, 0] * q2
    l1 = r[0, 1] * q0 + r[1, 1] * q1 + r[2, 1] * q2
    l2 = r[0, 2] * q0 + r[1, 2] * q1 + r[2, 2] * q2
    s0 = before[0] - (r0[0, 0] * l0 + r0[0, 1] * l1 + r0[0, 2] * l2 + p0[0])
    s1 = before[1] - (r0[1, 0] * l0 + r0[1, 1] * l1 + r0[1, 2] * l2 + p0[1])
    s2 = before[2] - (r0[2, 0] * l0 + r0[2, 1] * l1 + r0[2, 2] * l2 + p0[2])
    slip_b, slip_c = s0 * b0 + s1 * b1 + s2 * b2, s0 * c0 + s1 * c1 + s2 * c2
    old_b, old_c = old[0] * b0 + old[1] * b1 + old[2] * b2, old[0] * c0 + old[1] * c1 + old[2] * c2
    limit = thing.friction * force
    bristle = thing.bristle * area
    dahl_vector(old_b, old_c, slip_b, slip_c, limit, bristle, thing.exponent, secant, work)
    if trial and bristle * np.hypot(slip_b, slip_c) > _TRIAL * limit:
        alike = old_b * slip_b + old_c * slip_c > _ALIKE * np.hypot(old_b, old_c) * np.hypot(
            slip_b, slip_c
        )
        if not (alike and np.hypot(old_b, old_c) > _ALIKE * limit):
            work[0], work[1] = old_b + bristle * slip_b, old_c + bristle * slip_c
            work[2], work[3], work[4], work[5] = bristle, 0.0, 0.0, bristle
            work[6], work[7] = 0.0, 0.0
    f_b, f_c = work[0], work[1]
    for a in range(3):
        tangential = f_b * _at(a, b0, b1, b2) + f_c * _at(a, c0, c1, c2)
        true[a] = force * normal[a] + tangential
        linear[a] = force / factor * normal[a] + tangential
    if not tangent:
        return True
    steep = 1.0  # slope of the gap along the normal, which a mesh rounds off at its edges
    if thing.kind == GRID:
        x, y, z = now[0] + _ASIDE * n0, now[1] + _ASIDE * n1, now[2] + _ASIDE * n2
        steep = (gap_at(thing, pose, x, y, z, aside) - gap) / _ASIDE
    # The slip is measured before the object's turn in the step: the axes are turned with it.
    u0, u1, u2 = _turned(r, r0, b0, b1, b2)
    w0, w1, w2 = _turned(r, r0, c0, c1, c2)
    for k in range(3):  # column: the direction in which the node moves
        nk, bk, ck = normal[k], _at(k, u0, u1, u2), _at(k, w0, w1, w2)
        rise = steep * stiffness * nk
        v_b = work[2] * bk + work[3] * ck + work[6] * thing.friction * rise
        v_c = work[4] * bk + work[5] * ck + work[7] * thing.friction * rise
        straight = -rise / factor - force * bend * radial[k]
        for a in range(3):
            na = normal[a]
            sideways = v_b * _at(a, b0, b1, b2) + v_c * _at(a, c0, c1, c2)
            slope[a, k] = straight * na - sideways
    if thing.kind != PLANE:
        # The normal turns as the node moves along a curved object: its force and the friction turn
        # with it, and what was motion towards the object becomes slip.
        towards = s0 * n0 + s1 * n1 + s2 * n2
        for turn in range(3 if thing.kind == GRID else 2):
            t0, t1, t2 = (
                (b0, b1, b2) if turn == 0 else ((c0, c1, c2) if turn == 1 else (n0, n1, n2))
            )
            x, y, z = now[0] + _ASIDE * t0, now[1] + _ASIDE * t1, now[2] + _ASIDE * t2
            gap_at(thing, pose, x, y, z, aside)
            for a in range(3):
                aside[a] = (aside[a] - normal[a]) / _ASIDE
            turn_b = aside[0] * b0 + aside[1] * b1 + aside[2] * b2
            turn_c = aside[0] * c0 + aside[1] * c1 + aside[2] * c2
            v_b = -towards * (work[2] * turn_b + work[3] * turn_c)
            v_c = -towards * (work[4] * turn_b + work[5] * turn_c)
            lean = f_b * turn_b + f_c * turn_c
            for a in range(3):
                change = force / factor * aside[a] - lean * normal[a]
                change += v_b * _at(a, b0, b1, b2) + v_c * _at(a, c0, c1, c2)
                slope[a, 0] += change * t0
                slope[a, 1] += change * t1
                slope[a, 2] += change * t2
    return True


@njit(forceinline=True)
def _at(k: int, x: float, y: float, z: float) -> float:
    return x if k == 0 else (y if k == 1 else z)


@njit(forceinline=True)
def _turned(r: Array, r0: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A vector turned from the old rotation of an object to the new one."""
    a = r0[0, 0] * x + r0[1, 0] * y + r0[2, 0] * z
    b = r0[0, 1] * x + r0[1, 1] * y + r0[2, 1] * z
    c = r0[0, 2] * x + r0[1, 2] * y + r0[2, 2] * z
    return (
        r[0, 0] * a + r[0, 1] * b + r[0, 2] * c,
        r[1, 0] * a + r[1, 1] * b + r[1, 2] * c,
        r[2, 0] * a + r[2, 1] * b + r[2, 2] * c,
    )
