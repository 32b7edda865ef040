"""Fingertip and object in contact, stepped in time by an implicit integrator (thesis Eq. 2).

The massless object moves along x under the load, contact forces and a drag to ground. The grip
force drives the rigid part along z; it is fixed in x (E9).
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ..errors import ConvergenceError, LostContactError, ModelError, PiercedError
from ..kernels.bordered_kernels import Scratch, scratch
from ..kernels.contact import Contact
from ..kernels.implicit_kernels import LOST, PIERCED, SOLVED, UNSOLVED, Rule, advance, record
from ..objects import ContactObject
from .assembly import Chain, chain, contact
from .drive import Drive
from .fingertip import Fingertip
from .state import State, rest_state, state_of

Array = NDArray[np.float64]

#: The default: BDF2, everything at the end of the step, Newton through the springs' turning.
IMPLICIT = Rule(tolerance=1e-9, max_iterations=30, turning=1.0, second_order=True, lagged=False)
NO_RECORD = record(0, 0)


def step(
    fingertip: Fingertip, obj: ContactObject, state: State, dt: float, grip: float, load: float
) -> State:
    """Make one implicit step under constant grip force and load.

    Parameters
    ----------
    fingertip, obj: fingertip and object
    state: state at the start of the step
    dt: step [s]; second-order accurate where the contact does not change
    grip: force on the rigid part along z [N]
    load: force on the object along x [N]

    Raises
    ------
    ConvergenceError
        When the nonlinear equations were not solved even after repeated halving of the step.
    LostContactError
        When there is a load but nothing touches the object.
    PiercedError
        When the fingertip passes through a round object.
    """
    return steps(fingertip, obj, state, dt, np.array([[grip, load]])).state(-1)


def steps(
    fingertip: Fingertip, obj: ContactObject, state: State, dt: float, forces: Array
) -> "History":
    """Make S implicit steps with constant forces in each; record the start and every step.

    Parameters
    ----------
    fingertip, obj, state, dt: see `step`
    forces: grip and load in each step [N], shape (S, 2)

    Raises
    ------
    ModelError
        As `step` does.
    """
    if not (dt > 0.0 and np.isfinite(dt) and np.isfinite(forces).all()):
        raise UserError(f"a step needs dt > 0 and finite forces, got {dt=}, {forces=}")
    ch, ct = chain(fingertip), contact(fingertip, obj)

    def constant(done: int) -> Drive:
        return Drive.constant(*forces[done].tolist())

    return _march(ch, ct, state, forces, (False, False), constant, dt, 1, IMPLICIT)


_local = threading.local()


def _memory(nodes: int) -> Scratch:
    """Work arrays of this thread, which are reused between calls."""
    kept: dict[int, Scratch] = _local.__dict__.setdefault("kept", {})
    if nodes not in kept:
        kept[nodes] = scratch(nodes)
    return kept[nodes]


def _copied(state: State) -> tuple[Array, Array, Array, Array, Array]:
    """Copies of displacements, friction, slip rate, pose and rates, to be stepped in place."""
    d = state.deformation
    pose = np.array([d.rigid_part, d.object_position])
    return d.nodes.copy(), state.friction.copy(), state.slip_rate.copy(), pose, state.rate.copy()


@dataclass(frozen=True, kw_only=True)
class History:
    """R recorded instants of a run of a chain with N nodes.

    Attributes
    ----------
    time: time of each instant, the first at the start of the run [s], shape (R,)
    nodes: displacements (x, z) [m], shape (R, N, 2)
    pose: displacement of the rigid part along z and of the object along x [m], shape (R, 2)
    friction: Dahl force of each node [N], shape (R, N)
    slip_rate: tangential speed of the object relative to each node [m/s], shape (R, N)
    rate: mean rates of `nodes` and, last, of `pose` over the step before each instant [m/s], shape
        (R, N + 1, 2)
    step: length of that step [s]; 0 at the first instant of a run from rest, shape (R,)
    """

    time: Array
    nodes: Array
    pose: Array
    friction: Array
    slip_rate: Array
    rate: Array
    step: Array

    def __len__(self) -> int:
        """Number of recorded instants."""
        return len(self.time)

    def state(self, index: int) -> State:
        """State at a recorded instant, from which a run can continue."""
        return state_of(
            self.time[index],
            self.nodes[index],
            self.pose[index],
            self.friction[index],
            self.slip_rate[index],
            self.rate[index],
            self.step[index],
        )


def simulate(
    fingertip: Fingertip,
    obj: ContactObject,
    drive: Drive,
    *,
    dt: float,
    duration: float,
    state: State | None = None,
    every: int = 1,
) -> History:
    """Simulate the node model under a drive.

    Parameters
    ----------
    fingertip, obj: chain and object
    drive: grip and load over time
    dt: step [s]
    duration: length of the run, a whole number of steps [s]
    state: state at the start (default: the undeformed fingertip at time 0)
    every: number of steps between records (default 1)

    Raises
    ------
    UserError
        For a step that cannot be used, and a state of another chain.
    ModelError
        When the run fails.
    """
    if not (np.isfinite([dt, duration]).all() and dt > 0.0 and duration > 0.0):
        raise UserError(f"dt and duration must be finite and above 0 s, got {dt=}, {duration=}")
    steps = round(duration / dt)
    if abs(steps * dt - duration) > 1e-6 * dt or every < 1 or steps % every:
        raise UserError(
            f"the duration must be a whole number of recorded steps, got {duration=}, {dt=}, "
            f"{every=}"
        )
    start = rest_state(fingertip) if state is None else state
    if len(start.friction) != fingertip.nodes:
        raise UserError(
            f"the state has {len(start.friction)} nodes and the fingertip {fingertip.nodes}"
        )
    ch, ct = chain(fingertip), contact(fingertip, obj)
    return march(ch, ct, start, drive, dt, steps, every, IMPLICIT)


def march(
    ch: Chain,
    ct: Contact,
    state: State,
    drive: Drive,
    dt: float,
    steps: int,
    every: int,
    rule: Rule,
) -> History:
    """Step by an implicit rule; record the start and every `every`th step."""
    goals = drive.at(state.time + dt * np.arange(1.0, steps + 1.0))
    return _march(ch, ct, state, goals, drive.held, lambda _: drive, dt, every, rule)


def _march(
    ch: Chain,
    ct: Contact,
    state: State,
    goals: Array,
    held: tuple[bool, bool],
    drive_of: Callable[[int], Drive],
    dt: float,
    every: int,
    rule: Rule,
) -> History:
    """Step by a rule to grip and load `goals` (S, 2); `drive_of` gives the drive within a step."""
    y = _copied(state)
    u, friction, slip, pose, rate = y
    n, steps = len(ch.share), len(goals)
    out, memory = record(steps // every + 1, n), _memory(n)
    times: Array = state.time + dt * np.arange(1.0, steps + 1.0)
    for kept, now in zip(out, (u, pose, friction, slip, rate), strict=True):
        kept[0] = now
    done, before = 0, state.step
    while True:
        done, ended = advance(ch, ct, memory, *y, dt, before, held, goals, rule, out, done, every)
        if done == steps:
            break
        if ended != UNSOLVED:
            raise _broken(ended, float(times[done]), goals[done], dt)
        start = state.time + done * dt
        _in_parts(ch, ct, memory, y, drive_of(done), start, dt, before, rule)
        done, before = done + 1, dt
        if done % every == 0:
            for kept, now in zip(out, (u, pose, friction, slip, rate), strict=True):
                kept[done // every] = now
    return History(
        time=np.concatenate([[state.time], times[every - 1 :: every]]),
        nodes=out.nodes,
        pose=out.pose,
        friction=out.friction,
        slip_rate=out.slip,
        rate=out.rate,
        step=np.concatenate([[state.step], np.full(len(out.pose) - 1, dt)]),
    )


def _in_parts(
    ch: Chain,
    ct: Contact,
    memory: Scratch,
    y: tuple[Array, ...],
    drive: Drive,
    start: float,
    dt: float,
    last: float,
    rule: Rule,
) -> None:
    """Divide a step without solution in two, and these again as needed; all in place.

    Where a spring snaps through, no state near the last one is in balance. Only steps so short that
    the dampers act can follow it.
    """
    u_before, pose_before = y[0].copy(), y[3].copy()
    waiting = [(start + dt / 2, dt / 2), (start, dt / 2)]
    # Largest number of parts of a step that does not converge, and the shortest one over the step.
    most_parts, shortest = 3000, 1e-12
    for _ in range(most_parts):
        now, part = waiting.pop()
        # A jump at the start of the step is felt by all of its parts.
        goal = drive.at(np.array([now + part]))
        _, ended = advance(ch, ct, memory, *y, part, last, drive.held, goal, rule, NO_RECORD, 0, 2)
        if ended == SOLVED:
            last = part
        elif ended == UNSOLVED and part > shortest * dt:
            waiting += [(now + part / 2, part / 2), (now, part / 2)]
        else:
            raise _broken(ended, now + part, goal[0], dt)
        if not waiting:
            # Mean rates over the whole step.
            u, _, _, pose, rate = y
            rate[:-1], rate[-1] = (u - u_before) / dt, (pose - pose_before) / dt
            return
    raise _broken(UNSOLVED, now + part, goal[0], dt)


def _broken(ended: int, time: float, goal: Array, dt: float) -> ModelError:
    """Make the error for a step without solution."""
    if ended == PIERCED:
        return PiercedError(
            f"the fingertip went through the object at t = {time:.6g} s under {goal[0]:.4g}: it is "
            "too soft and too sharp for so much"
        )
    if ended == LOST:
        return LostContactError(
            f"a load of {goal[1]:.4g} N at t = {time:.6g} s, but nothing touches the object: "
            "load only while the grip holds it"
        )
    return ConvergenceError(
        f"no equilibrium found at t = {time:.6g} s with dt = {dt:.3g} s, normal {goal[0]:.4g}, "
        f"lateral {goal[1]:.4g}"
    )
