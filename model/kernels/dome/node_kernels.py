"""One node of a dome's contact: the force that its own law agrees with, and what it does."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit
from .krylov_kernels import System, invert_three
from .touch_kernels import Pose, Stiffening, Touched, touch

Array = NDArray[np.float64]
Single = NDArray[np.float32]

#: Rounds of a node's own law, and the squared relative error at which it is solved.
_SETTLING, _SETTLED = 40, 1e-12
#: Shortest part of a change of a node's place that is tried.
SHORTEST = 0.02


class Contact(NamedTuple):
    """Nodes near the object at the start of a step, all of shape (n, …).

    Attributes
    ----------
    rest: places of the undeformed nodes [m]
    radial: unit vectors from the centre
    areas: [m²]
    before: places before the step [m]
    offset: displacement that does not come from the forces of this step [m]
    friction: before the step [N]
    compliance: among the nodes [m/N], at least (3n, 3n)
    own: of each node [m/N], at least (n, 3, 3)
    """

    rest: Array
    radial: Array
    areas: Array
    before: Array
    offset: Array
    friction: Array
    compliance: Single
    own: Array


class Outcome(NamedTuple):
    """What a step leaves, arrays of shape (n, 3) that are written to.

    Attributes
    ----------
    linear: forces that the linear skin carries [N]: the guess on entry, the solution on return
    true: forces of the object on the nodes [N]
    tangential: friction, the part of `true` in the object's tangent plane [N]
    normal: of the object at the nodes
    displacement: of the nodes [m]
    motion: δξ of the object's free axes, from the pose on entry [m, rad], (6,), or (7,) between
        two fingertips
    """

    linear: Array
    true: Array
    tangential: Array
    normal: Array
    displacement: Array
    motion: Array


@njit(forceinline=True)
def settle(
    near: Contact,
    thing: Touched,
    at: Pose,
    stiff: Stiffening,
    i: int,
    forces: Array,
    own: Array,
    old: Array,
    trial: bool,
    secant: bool,
    outcome: Outcome,
    now: Array,
    linear: Array,
    slope: Array,
    answer: Array,
    stiffened: Array,
    work: Array,
    room: Array,
) -> bool:
    """Force on node i that its own displacement agrees with, the other forces held.

    Parameters
    ----------
    own: A_ii [m/N], (3, 3)
    now: place of the node [m]; changed to that which agrees
    linear: its force [N], (3,) (output)
    answer: B = dΦ/du*, see `krylov_kernels` [N/m], (3, 3) (output)
    work, room: to work in, (11,) and (3, 3, 3)
    """
    base, step, moved = room[0, 0], room[0, 1], room[0, 2]
    matrix, inverse = room[1], room[2]
    carried = 0.0
    for a in range(3):
        base[a] = now[a]
        for b in range(3):
            base[a] -= own[a, b] * forces[3 * i + b]
        carried += abs(forces[3 * i + a])
    touches = False
    former, length = np.inf, 1.0
    for turn in range(_SETTLING):
        inwards = 0.0
        for a in range(3):
            inwards -= (now[a] - near.rest[i, a]) * near.radial[i, a]
        touches = touch(
            thing, at, stiff, near.areas[i], near.before[i], now, inwards, near.radial[i], old,
            trial, secant, True, outcome.normal[i], work, linear, outcome.true[i], slope, stiffened,
        )  # fmt: skip
        if not touches and carried == 0.0 and turn == 0:
            return False  # as before, and `answer` is not used
        off, size = 0.0, 0.0
        for a in range(3):
            push = 0.0
            for b in range(3):
                push += own[a, b] * linear[b]
            step[a] = base[a] + push - now[a]
            off += step[a] * step[a]
            size += push * push
        if off > former and length > SHORTEST:  # too far: back by half
            length *= 0.5
            for a in range(3):
                now[a] -= length * moved[a]
            continue
        former, length = off, 1.0
        for a in range(3):
            for b in range(3):
                total = 1.0 if a == b else 0.0
                for d in range(3):
                    total -= own[a, d] * slope[d, b]
                matrix[a, b] = total
        if not invert_three(matrix, inverse):
            break
        if off <= _SETTLED * size + 1e-24 or turn == _SETTLING - 1:
            break
        for a in range(3):
            moved[a] = 0.0
            for b in range(3):
                moved[a] += inverse[a, b] * step[b]
            now[a] += moved[a]
    # B = T·(1 − A_ii·T)⁻¹
    for a in range(3):
        for b in range(3):
            total = 0.0
            for d in range(3):
                total += slope[a, d] * inverse[d, b]
            answer[a, b] = total
    return touches


@njit()
def true_force(system: System, normal: Array, radial: Array, stiffened: Array, k: int) -> None:
    """Q and n·κ·r̂ᵀ of a node: its true force changes by Q·δf − n·κ·r̂·δu."""
    for a in range(3):
        for b in range(3):
            whole = 1.0 if a == b else 0.0
            system.true[k, a, b] = whole + (stiffened[0] - 1.0) * normal[a] * normal[b]
            system.bend[k, a, b] = stiffened[1] * normal[a] * radial[b]


@njit()
def closing(arm: Single, force: Array, first: bool, out: Array, k: int) -> None:
    """The force on node k of a fingertip, and those of units, against the way of both."""
    sign = -1.0 if first else 1.0
    arm[6, 3 * k], arm[6, 3 * k + 1], arm[6, 3 * k + 2] = 0.0, 0.0, sign
    out[6] += sign * force[2]


@njit()
def lever(arm: Single, free: NDArray[np.bool_], now: Array, place: Array, k: int) -> None:
    """Wrench about the object's place of unit forces on node k; zero along axes that are held."""
    x, y, z = now[0] - place[0], now[1] - place[1], now[2] - place[2]
    for c in range(6):
        for a in range(3):
            arm[c, 3 * k + a] = 1.0 if free[c] and c == a else 0.0
    if free[3]:
        arm[3, 3 * k + 1], arm[3, 3 * k + 2] = -z, y
    if free[4]:
        arm[4, 3 * k], arm[4, 3 * k + 2] = z, -x
    if free[5]:
        arm[5, 3 * k], arm[5, 3 * k + 1] = -y, x


@njit()
def wrench(force: Array, now: Array, place: Array, out: Array) -> None:
    """Add the wrench of a node's force about the object's place."""
    x, y, z = now[0] - place[0], now[1] - place[1], now[2] - place[2]
    for a in range(3):
        out[a] += force[a]
    out[3] += y * force[2] - z * force[1]
    out[4] += z * force[0] - x * force[2]
    out[5] += x * force[1] - y * force[0]
