"""Many independent fingertips at once: one chain, with an object, a grip and a load for each.

`step_many` steps them under forces, `place_many` to given positions of rigid part and object.

The compiled loop releases the interpreter lock, so that threads can share the batch.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit
from ...errors import UserError
from ..kernels.bordered_kernels import Scratch, scratch
from ..kernels.contact import Contact, contact_frame
from ..kernels.implicit_kernels import SOLVED, UNSOLVED, Record, Rule, advance
from ..objects import ContactObject
from .assembly import Chain, chain, contact, lifts
from .drive import Drive
from .fingertip import CONTACT_THRESHOLD, Fingertip
from .plant import IMPLICIT, NO_RECORD, _broken, _in_parts, _memory
from .state import State, state_of

Array = NDArray[np.float64]

#: Whether rigid part and object have a given position. As a literal in a kernel it would compile
#: `advance` again.
_FREE, _HELD = (False, False), (True, True)
#: Rule of `place_many`, for many copies that need not be exact: to 0.1 µm, and of first order, as
#: the motion before a step may have been one that is known only roughly.
_ROUGHLY = IMPLICIT._replace(tolerance=1e-7, second_order=False)
#: Shortest part of a step that is divided because it has no solution, and most tries.
_LEAST_PART, _MOST_TRIES = 1e-3, 60


@dataclass(frozen=True, kw_only=True)
class Ensemble:
    """Stacked states of B fingertips with N nodes; attributes as in `State`.

    Attributes
    ----------
    time: time of the states [s]
    nodes: displacements (x, z) [m], shape (B, N, 2)
    pose: displacement of the rigid part along z and of the object along x [m], shape (B, 2)
    friction: Dahl force of each node [N], shape (B, N)
    slip_rate: tangential speed of the object relative to each node [m/s], shape (B, N)
    rate: mean rates of the nodes and, last, of the pose over the previous step [m/s], shape
        (B, N + 1, 2)
    step: length of the previous step [s]
    """

    time: float
    nodes: Array
    pose: Array
    friction: Array
    slip_rate: Array
    rate: Array
    step: float

    def __len__(self) -> int:
        """Number of fingertips."""
        return len(self.pose)

    def take(self, rows: Sequence[int]) -> "Ensemble":
        """Some of the fingertips, in this order; they may repeat."""
        picked = np.asarray(rows)
        return self.each(lambda part: part[picked])

    def each(self, change: Callable[[Array], Array]) -> "Ensemble":
        """The same with each array changed, such as to combinations of the fingertips."""
        return _stepped(self.time, tuple(change(part) for part in _parts(self)), self.step)

    def state(self, index: int) -> State:
        """State of one fingertip."""
        return state_of(
            self.time,
            self.nodes[index],
            self.pose[index],
            self.friction[index],
            self.slip_rate[index],
            self.rate[index],
            self.step,
        )


def _parts(ensemble: Ensemble) -> tuple[Array, ...]:
    """What kernels step in place: displacements, friction, slip rate, pose and rates."""
    return (
        ensemble.nodes, ensemble.friction, ensemble.slip_rate, ensemble.pose, ensemble.rate,
    )  # fmt: skip


def _copied(ensemble: Ensemble) -> tuple[Array, ...]:
    """Copies of these."""
    return tuple(part.copy() for part in _parts(ensemble))


def _stepped(time: float, parts: tuple[Array, ...], step: float) -> Ensemble:
    """Ensemble at a time [s] of parts as of `_parts`, after a step [s]."""
    nodes, friction, slip_rate, pose, rate = parts
    return Ensemble(
        time=time,
        nodes=nodes,
        pose=pose,
        friction=friction,
        slip_rate=slip_rate,
        rate=rate,
        step=step,
    )


def rest_ensemble(fingertip: Fingertip, count: int) -> Ensemble:
    """Ensemble of undeformed fingertips whose apex just touches the object.

    Parameters
    ----------
    fingertip: the same fingertip for all
    count: number of fingertips
    """
    n = fingertip.nodes
    return Ensemble(
        time=0.0,
        nodes=np.zeros((count, n, 2)),
        pose=np.zeros((count, 2)),
        friction=np.zeros((count, n)),
        slip_rate=np.zeros((count, n)),
        rate=np.zeros((count, n + 1, 2)),
        step=0.0,
    )


def step_many(
    fingertip: Fingertip,
    objects: Sequence[ContactObject],
    ensemble: Ensemble,
    dt: float,
    grip: Array,
    load: Array,
    threads: int = 1,
) -> Ensemble:
    """Make implicit steps with an ensemble; every fingertip moves as with `step`.

    Parameters
    ----------
    fingertip: the same fingertip for all
    objects: one object per fingertip, flat or round, without patches
    ensemble: B states to start from; not changed
    dt: step [s]
    grip, load: force on rigid part and object at the end of each step [N], shape (B, steps) or (B,)
    threads: number of threads that share the batch; it does not change the result

    Raises
    ------
    UserError
        When the shapes do not fit, or an object has a profile or patches.
    ModelError
        When a fingertip has no solution; the message names its index.
    """
    goals = np.stack(
        [np.atleast_2d(np.transpose(grip)), np.atleast_2d(np.transpose(load))], axis=-1
    )
    goals = np.ascontiguousarray(goals.swapaxes(0, 1), dtype=float)
    count = len(ensemble)
    if len(objects) != count or goals.shape[0] != count:
        raise UserError(
            f"an ensemble of {count} needs as many objects, grips and loads, got {len(objects)} "
            f"objects and forces of shape {goals.shape[:2]}"
        )
    if not (dt > 0.0 and np.isfinite(dt) and np.isfinite(goals).all()):
        raise UserError(f"a step needs dt > 0 and finite forces, got {dt=}")
    if any(obj.profile is not None for obj in objects):
        raise UserError("an ensemble takes flat and round objects, not profiles")
    if any(obj.patches for obj in objects):
        raise UserError("an ensemble takes objects of one friction each, not patches")
    ch = chain(fingertip)
    contacts = np.array([contact(fingertip, obj)[:8] for obj in objects])
    y = _copied(ensemble)

    def run(part: slice) -> None:
        w, begin, stop = scratch(fingertip.nodes), part.start, part.stop
        done, before = 0, ensemble.step
        while True:
            begin, done, ended = _advance_many(
                ch, contacts, w, *y, dt, before, _FREE, goals, IMPLICIT, NO_RECORD, begin, stop,
                done,
            )  # fmt: skip
            if begin == stop:
                return
            one = tuple(a[begin] for a in y)
            last = dt if done else before
            time = ensemble.time + done * dt
            goal = goals[begin, done]
            if ended != UNSOLVED:
                raise type(error := _broken(ended, time + dt, goal, dt))(f"{begin}: {error}")
            drive = Drive.constant(*goal)
            _in_parts(
                ch, contact(fingertip, objects[begin]), w, one, drive, time, dt, last, IMPLICIT
            )
            done += 1

    edges = [count * k // threads for k in range(threads + 1)]
    parts = [slice(a, b) for a, b in pairwise(edges) if b > a]
    if len(parts) == 1:
        run(parts[0])
    else:
        with ThreadPoolExecutor(len(parts)) as pool:
            list(pool.map(run, parts))
    return _stepped(ensemble.time + dt * goals.shape[1], y, dt)


@njit()
def _advance_many(
    ch: Chain, contacts: Array, w: Scratch, u: Array, friction: Array, slip: Array, pose: Array,
    rate: Array, dt: float, before: float, held: tuple[bool, bool], goals: Array, rule: Rule,
    nothing: Record, begin: int, stop: int, done: int,
) -> tuple[int, int, int]:  # fmt: skip
    """Advance fingertips begin…stop in place; return the first failure: index, step and reason."""
    no_knots, no_pieces = np.empty(0), np.empty((1, 4))
    steps = goals.shape[1]
    for b in range(begin, stop):
        c = contacts[b]
        ct = Contact(
            c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], no_knots, no_pieces, no_knots, no_knots
        )
        start = done if b == begin else 0
        last = before if start == 0 else dt
        reached, ended = advance(
            ch, ct, w, u[b], friction[b], slip[b], pose[b], rate[b], dt, last, held,
            goals[b], rule, nothing, start, steps + 1,
        )  # fmt: skip
        if ended != SOLVED:
            return b, reached, ended
    return stop, 0, SOLVED


@dataclass(frozen=True, kw_only=True)
class Copies:
    """Parameters of B copies of a fingertip, each with an object of its own.

    Attributes
    ----------
    chain: parameters of the fingertip
    contacts: parameters of the objects, shape (B, 8)
    """

    chain: Chain
    contacts: Array

    def take(self, rows: Sequence[int]) -> "Copies":
        """Some of the copies, in this order; they may repeat."""
        return Copies(chain=self.chain, contacts=self.contacts[np.asarray(rows)])

    def sums(self, ensemble: Ensemble) -> Array:
        """ΣFn, and ΣFf along the object's tangent, of each copy [N], shape (B, 2)."""
        out = np.empty((len(ensemble), 2))
        _sums_many(self.chain, self.contacts, ensemble.nodes, ensemble.friction, ensemble.pose, out)
        return out


def copies_of(
    fingertip: Fingertip,
    *,
    friction: Array,
    curvature: Array,
    stiffness: Array,
    dahl_stiffness: Array,
    dahl_exponent: Array,
) -> Copies:
    """Make B copies of a fingertip, each with a flat or round object that travels.

    Parameters
    ----------
    fingertip: the same for all
    friction, curvature, stiffness, dahl_stiffness, dahl_exponent: as of `ContactObject`, shape (B,)

    Raises
    ------
    UserError
        When a hollow is too narrow for the fingertip to enter.
    """
    lift = lifts(fingertip, curvature)
    none, travels = np.zeros(len(friction)), np.ones(len(friction))
    columns = (stiffness, friction, dahl_stiffness, dahl_exponent, none, curvature, lift, travels)
    return Copies(chain=chain(fingertip), contacts=np.stack(columns, axis=1))


def place_many(
    copies: Copies, ensemble: Ensemble, poses: Array, dt: float
) -> tuple[Ensemble, NDArray[np.bool_]]:
    """Step every copy to a given position of its rigid part and object.

    Parameters
    ----------
    copies: B copies
    ensemble: B states to start from; not changed
    poses: position of the rigid part along z and of the object along x [m], shape (B, 2)
    dt: length of the step [s]

    Returns
    -------
    States, and which of them were found (B,); the others are of a shorter motion.
    """
    y = _copied(ensemble)
    solved = np.empty(len(poses), np.bool_)
    memory = _memory(copies.chain.rest.shape[0])
    _place_many(
        copies.chain, copies.contacts, memory, *y, dt, ensemble.step, _HELD,
        np.ascontiguousarray(poses, dtype=float), _ROUGHLY, NO_RECORD, solved,
    )  # fmt: skip
    return _stepped(ensemble.time + dt, y, dt), solved


@njit()
def _place_many(
    ch: Chain, contacts: Array, w: Scratch, u: Array, friction: Array,
    slip: Array, pose: Array, rate: Array, dt: float, before: float, held: tuple[bool, bool],
    poses: Array, rule: Rule, nothing: Record, solved: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Do `place_many` in place; a step without solution is divided into halves."""
    no_knots, no_pieces = np.empty(0), np.empty((1, 4))
    goal, start = np.empty((1, 2)), np.empty((u.shape[1] + 1, 2))
    for b in range(poses.shape[0]):
        c = contacts[b]
        ct = Contact(
            c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], no_knots, no_pieces, no_knots, no_knots
        )
        start[:-1], start[-1] = u[b], pose[b]
        left, part, last, tries = 1.0, 1.0, before, 0
        while left > 0.0 and part >= _LEAST_PART and tries < _MOST_TRIES:
            part = min(part, left)
            goal[0] = start[-1] + (1.0 - left + part) * (poses[b] - start[-1])
            _, ended = advance(
                ch, ct, w, u[b], friction[b], slip[b], pose[b], rate[b], part * dt, last, held,
                goal, rule, nothing, 0, 2,
            )  # fmt: skip
            tries += 1
            if ended == SOLVED:
                last, left = part * dt, left - part
            else:
                part *= 0.5
        solved[b] = left <= 0.0
        if tries > 1:  # mean rates over the whole step
            rate[b, :-1], rate[b, -1] = (u[b] - start[:-1]) / dt, (pose[b] - start[-1]) / dt


@njit()
def _sums_many(
    ch: Chain, contacts: Array, u: Array, friction: Array, pose: Array, out: Array
) -> None:
    """Do `Copies.sums`."""
    no_knots, no_pieces = np.empty(0), np.empty((1, 4))
    for b in range(u.shape[0]):
        stiffness, curvature, lift, travel = (
            contacts[b, 0], contacts[b, 5], contacts[b, 6], contacts[b, 7],
        )  # fmt: skip
        out[b] = 0.0
        for i in range(u.shape[1]):
            x, z = ch.rest[i, 0] + u[b, i, 0], ch.rest[i, 1] + u[b, i, 1]
            gap, _, _ = contact_frame(
                no_knots, no_pieces, curvature, x - travel * pose[b, 1], z - lift
            )
            normal = -stiffness * ch.share[i] * gap
            if normal > CONTACT_THRESHOLD * ch.share[i]:
                out[b, 0] += normal
                out[b, 1] += friction[b, i]
