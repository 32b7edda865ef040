"""One step of a dome's contact: semi-smooth Newton on the forces of the nodes that touch."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit
from .krylov_kernels import System, prepare, product_of, solve
from .node_kernels import SHORTEST, Contact, Outcome, closing, lever, settle, true_force, wrench
from .touch_kernels import Pose, Stiffening, Touched
from .turn_kernels import turned

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Single = NDArray[np.float32]

#: Residual of the linear systems, relative.
_LOOSE, _TIGHT = 0.1, 0.005
#: Share of the tolerance that is left for the change by another round, which is estimated.
_SURE = 0.03
#: Rounds with the secant, where the residual does not halve.
_SECANTS = 2


class Second(NamedTuple):
    """A second fingertip on the same object; its nodes come after those of the first one.

    Both are described along the same axes, each from a place of its own, and close along z: the
    first one moves to +z and the second one to −z by the seventh entry of ξ.

    Attributes
    ----------
    first: number of its first node
    compliance: among its nodes [m/N]
    place: of the object as this fingertip sees it, before the step and on entry [m], (2, 3)
    stiff: of its skin
    share: of its compliance that acts within a step
    """

    first: int
    compliance: Single
    place: Array
    stiff: Stiffening
    share: float


@njit()
def nobody(stiff: Stiffening) -> Second:
    """No second fingertip: a value of the same type, so that one kernel serves both."""
    return Second(0, np.empty((0, 0), np.float32), np.empty((2, 3)), stiff, 0.0)


@njit()
def solve_contact(
    near: Contact,
    thing: Touched,
    pose: Pose,
    stiff: Stiffening,
    share: float,
    free: NDArray[np.bool_],
    inertia: Array,
    wanted: Array,
    tolerance: float,
    most_rounds: int,
    warm: bool,
    system: System,
    outcome: Outcome,
    second: Second,
) -> tuple[float, int, int, int]:
    """Forces at the end of a step, and the object's pose on its free axes.

    Parameters
    ----------
    share: of the compliance that acts within a step; viscosity makes it less than 1
    free: axes of the pose (3 translations, 3 rotations) that are not prescribed
    inertia: M of the free axes [N/m, N·m]: the object's reaction is `wanted` − M·ξ
    wanted: wrench on the object about its place without the fingertip [N, N·m]; with a second
        fingertip, then the force with which both close, and M and `free` are as long
    tolerance: relative change of the forces at which the step is solved
    warm: whether the guess is near the solution: then no node is tried to stick first
    second: fingertip on the other side, if there are seven axes; else `nobody`

    Returns
    -------
    Relative change that another round would make, rounds, products with the compliance, nodes
    that touch.
    """
    n, axes = len(near.rest), len(free)
    size, split = 3 * n, n
    moves = free.any()
    forces, u = outcome.linear.reshape(-1), outcome.displacement.reshape(-1)
    offset = near.offset.reshape(-1)
    at = Pose(pose.old_rotation, pose.old_place, pose.rotation.copy(), pose.place.copy())
    there, firm, part = at, stiff, share
    pinched = axes == 7
    if pinched:
        split, firm, part = second.first, second.stiff, second.share
        there = Pose(at.old_rotation, second.place[0].copy(), at.rotation, second.place[1].copy())
    motion = outcome.motion
    motion[:] = 0.0
    turn = at.rotation @ at.old_rotation.T
    tries = not warm
    old = np.empty((n, 3))
    for i in range(n):
        for a in range(3):
            old[i, a] = (
                turn[a, 0] * near.friction[i, 0]
                + turn[a, 1] * near.friction[i, 1]
                + turn[a, 2] * near.friction[i, 2]
            )
    active = np.empty(n, np.int64)
    right, change = np.empty(size + axes), np.empty(size + axes)
    linear, slope, stiffened = np.empty(3), np.empty((3, 3)), np.empty(2)
    own, answer, now, work = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(11)
    room = np.empty((3, 3, 3))
    products, touching = 0, 0
    secants, former, error = 0, np.inf, _TIGHT if warm else 1.0
    rounds, length = 0, 1.0
    _displace(near.compliance, forces[: 3 * split], offset[: 3 * split], share, u[: 3 * split])
    if pinched:
        _displace(second.compliance, forces[3 * split :], offset[3 * split :], part, u[3 * split :])
    while True:
        count, touching, residual = 0, 0, 0.0
        reaction = np.zeros(axes)
        firsts = 0
        for i in range(n):
            its, law, acting = (at, stiff, share) if i < split else (there, firm, part)
            for a in range(3):
                now[a] = near.rest[i, a] + u[3 * i + a]
                for b in range(3):
                    own[a, b] = acting * near.own[i, a, b]
            touches = settle(
                near, thing, its, law, i, forces, own, old[i], tries and rounds == 0, secants > 0,
                outcome, now, linear, slope, answer, stiffened, work, room,
            )  # fmt: skip
            held = forces[3 * i] != 0.0 or forces[3 * i + 1] != 0.0 or forces[3 * i + 2] != 0.0
            touching += touches
            if not (touches or held):
                continue
            active[count] = i
            for a in range(3):
                difference = linear[a] - forces[3 * i + a]
                right[3 * count + a] = difference
                residual += difference * difference
                for b in range(3):
                    system.own[count, a, b] = own[a, b]
                    system.answer[count, a, b] = answer[a, b]
            if moves:
                lever(system.arm, free, now, its.place, count)
                wrench(outcome.true[i], now, its.place, reaction)
                if pinched:
                    closing(system.arm, outcome.true[i], i < split, reaction, count)
                true_force(system, outcome.normal[i], near.radial[i], stiffened, count)
            count += 1
            firsts += i < split
        if rounds > 0 and secants == 0 and residual < 4.0 * former:
            # Another round would change the forces by less than this one, as the residual did.
            following = error * min(1.0, np.sqrt(residual / former))
            if following < _SURE * tolerance:
                error = following
                break
        if (count == 0 and not moves) or rounds == most_rounds:
            error = 0.0 if count == 0 else max(error, tolerance)
            break
        if rounds > 1 and residual > former and length > SHORTEST and secants == 0:
            length *= 0.5  # too far: back by half
            gathered = int(system.gathered[0])
            for k in range(gathered):
                for a in range(3):
                    forces[3 * system.gathered[2 + k] + a] -= length * change[3 * k + a]
            if moves:
                for c in range(axes):
                    motion[c] -= length * change[3 * gathered + c]
                _carry(at, pose, motion)
                if pinched:
                    _close(at, there, second.place[1], motion)
            for k in range(size):
                u[k] -= length * system.vectors[6, k]
            continue
        if secants > 0:
            secants -= 1
        elif rounds > 1 and residual > 0.5 * former:
            secants = _SECANTS
            former = residual
            rounds += 1
            continue  # the same forces again, with the secants
        former = residual
        if not _gathered(system, share, part, active, firsts, count):
            _gather(near.compliance, share, active, firsts, 0, system.block)
            if pinched:
                others = count - firsts
                _gather(second.compliance, part, active[firsts:], others, split, system.second)
        if moves:
            _reaction(system, right, free, wanted, reaction, inertia, motion, count)
            if not prepare(system, count, inertia, free):
                error = 1.0
                break
        products += solve(system, count, right, moves, min(_LOOSE, max(_TIGHT, error)), change)
        moved, load = 0.0, 1e-30
        for k in range(count):
            i = active[k]
            for a in range(3):
                forces[3 * i + a] += change[3 * k + a]
                moved += change[3 * k + a] ** 2
                load += forces[3 * i + a] ** 2
        error = np.sqrt(moved / load)
        if moves:
            for c in range(axes):
                motion[c] += change[3 * count + c]
            _carry(at, pose, motion)
            if pinched:
                _close(at, there, second.place[1], motion)
        length = 1.0
        x, more = system.vectors[7], system.vectors[6]
        _displace_more(near.compliance, active, firsts, change, share, x, more, u[: 3 * split], 0)
        if pinched:
            _displace_more(
                second.compliance, active[firsts:], count - firsts, change[3 * firsts :], part,
                x[3 * split :], more[3 * split :], u[3 * split :], split,
            )  # fmt: skip
        products += 1
        rounds += 1
    for i in range(n):
        along = 0.0
        for a in range(3):
            along += outcome.true[i, a] * outcome.normal[i, a]
        for a in range(3):
            outcome.tangential[i, a] = outcome.true[i, a] - along * outcome.normal[i, a]
            if (
                outcome.true[i, 0] == 0.0
                and outcome.true[i, 1] == 0.0
                and outcome.true[i, 2] == 0.0
            ):
                forces[3 * i + a] = 0.0
    return error, rounds, products, touching


@njit()
def _reaction(
    system: System,
    right: Array,
    free: NDArray[np.bool_],
    wanted: Array,
    reaction: Array,
    inertia: Array,
    motion: Array,
    count: int,
) -> None:
    """Right-hand side of the object's free axes, after those of its nodes."""
    axes = len(free)
    for c in range(axes):
        total = 0.0
        if free[c]:
            total = wanted[c] - reaction[c]
            for d in range(axes):
                total -= inertia[c, d] * motion[d]
            for k in range(count):
                for a in range(3):
                    back = 0.0
                    for b in range(3):
                        bent = 0.0
                        for d in range(3):
                            bent += system.bend[k, a, d] * system.own[k, d, b]
                        back += (system.true[k, a, b] - bent) * right[3 * k + b]
                    total += system.arm[c, 3 * k + a] * back
        right[3 * count + c] = total


@njit()
def _displace(compliance: Single, forces: Array, offset: Array, share: float, out: Array) -> None:
    """Displacement by all forces, in double precision."""
    size = len(out)
    loaded = np.empty(size, np.int64)
    count = 0
    for j in range(size):
        if forces[j] != 0.0:
            loaded[count] = j
            count += 1
    product_of(compliance, loaded, count, forces, out, size)
    for k in range(size):
        out[k] = out[k] * share + offset[k]


@njit()
def _displace_more(
    compliance: Single,
    active: Index,
    count: int,
    change: Array,
    share: float,
    x: Single,
    more: Single,
    out: Array,
    split: int,
) -> None:
    """Add the displacement by a change of forces, which is small: in single precision.

    Parameters
    ----------
    x: to work in
    more: what is added (output)
    split: number of the fingertip's first node
    """
    columns = np.empty(3 * count, np.int64)
    for k in range(count):
        for a in range(3):
            columns[3 * k + a] = 3 * (active[k] - split) + a
            x[columns[3 * k + a]] = share * change[3 * k + a]
    product_of(compliance, columns, 3 * count, x, more, len(out))
    for k in range(len(out)):
        out[k] += more[k]


@njit()
def _carry(at: Pose, pose: Pose, motion: Array) -> None:
    """Put the object where its free axes have moved it from the pose at the start."""
    for a in range(3):
        at.place[a] = pose.place[a] + motion[a]
    rotation = turned(pose.rotation, motion[3:])
    for a in range(3):
        for b in range(3):
            at.rotation[a, b] = rotation[a, b]


@njit()
def _close(at: Pose, there: Pose, start: Array, motion: Array) -> None:
    """Put the object, and with it where both fingertips see it after they have closed."""
    for a in range(3):
        there.place[a] = start[a] + motion[a]
    at.place[2] -= motion[6]
    there.place[2] += motion[6]


@njit()
def _gathered(
    system: System, share: float, part: float, active: Index, firsts: int, count: int
) -> bool:
    """Whether the system has the compliance of these nodes; it is marked to have it from now on."""
    gathered, shares = system.gathered, system.share
    same = count == gathered[0] and firsts == gathered[1]
    same = same and np.float32(share) == shares[0] and np.float32(part) == shares[1]
    for k in range(count):
        if not same:
            break
        same = active[k] == gathered[2 + k]
    if not same:
        gathered[0], gathered[1], shares[0], shares[1] = count, firsts, share, part
        for k in range(count):
            gathered[2 + k] = active[k]
    return same


@njit()
def _gather(
    compliance: Single, share: float, active: Index, count: int, split: int, out: Single
) -> None:
    """Compliance among the active nodes of a fingertip whose first node is `split`."""
    part = np.float32(share)
    for k in range(count):
        for a in range(3):
            source, target = compliance[3 * (active[k] - split) + a], out[3 * k + a]
            for j in range(count):
                i = 3 * (active[j] - split)
                target[3 * j] = part * source[i]
                target[3 * j + 1] = part * source[i + 1]
                target[3 * j + 2] = part * source[i + 2]
