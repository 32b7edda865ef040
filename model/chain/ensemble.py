"""Many independent fingertips at once: one chain, with an object, a grip and a load for each.

The compiled loop releases the interpreter lock, so that threads can share the batch.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit
from ...errors import UserError
from ..kernels.bordered_kernels import Scratch, scratch
from ..kernels.contact import Contact
from ..kernels.implicit_kernels import SOLVED, UNSOLVED, Record, Rule, advance
from ..objects import ContactObject
from .assembly import Chain, chain, contact
from .drive import Drive
from .fingertip import Fingertip
from .plant import IMPLICIT, NO_RECORD, _broken, _in_parts
from .state import State, state_of

Array = NDArray[np.float64]

#: Neither rigid part nor object has a given position. As a literal in a kernel it would compile
#: `advance` again.
_FREE = (False, False)


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
    y = tuple(
        part.copy()
        for part in (
            ensemble.nodes,
            ensemble.friction,
            ensemble.slip_rate,
            ensemble.pose,
            ensemble.rate,
        )
    )

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
    nodes, friction, slip_rate, pose, rate = y
    return Ensemble(
        time=ensemble.time + dt * goals.shape[1],
        nodes=nodes,
        pose=pose,
        friction=friction,
        slip_rate=slip_rate,
        rate=rate,
        step=dt,
    )


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
