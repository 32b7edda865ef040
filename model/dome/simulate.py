"""Simulation of a dome and an object over a whole motion."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ..checks import finite
from ..force_field import ForceField
from ..limit_surface import margin_within
from .dome import SoftBody, lattice
from .motion import Motion
from .solid import Solid
from .state import DomeState, StepCount, resting
from .stepper import Stepper, displacements

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class DomeRun:
    """Record of a motion of an object over a dome in K steps.

    Attributes
    ----------
    dome, solid, motion: body, object and its motion
    times: time at the end of every step [s], shape (K,)
    places, rotations: poses of the object, shapes (K, 3) [m] and (K, 3, 3)
    total_forces, total_torques: force of the object on the dome [N], and torque about the sphere's
        centre [N·m], shapes (K, 3)
    rounds, touching: number of Newton rounds, and of touching nodes, in each step, shape (K,)
    halvings, unconverged: number of halvings of steps, and of parts that did not converge
    states: S states at some of the times, including the last
    """

    dome: SoftBody
    solid: Solid
    motion: Motion
    times: Array
    places: Array
    rotations: Array
    total_forces: Array
    total_torques: Array
    rounds: NDArray[np.int64]
    touching: NDArray[np.int64]
    halvings: int
    unconverged: int
    states: tuple[DomeState, ...]

    @property
    def end(self) -> DomeState:
        """The last state."""
        return self.states[-1]

    @property
    def positions(self) -> Array:
        """Positions of the nodes in each kept state [m], shape (S, N, 3)."""
        points = lattice(self.dome).points
        return np.stack([points + displacements(self.dome, state) for state in self.states])

    @property
    def forces(self) -> Array:
        """Forces on the nodes in each kept state [N], shape (S, N, 3)."""
        return np.stack([state.forces for state in self.states])


def dome_forces(dome: SoftBody, state: DomeState, whole: bool = True) -> ForceField:
    """Contact forces of a state: the truth against which estimates are scored.

    Parameters
    ----------
    dome: dome or pad
    state: state of the dome
    whole: whether all nodes have their deformed positions (default); otherwise nodes far from the
        object have their rest positions, which is many times as fast
    """
    normal = np.einsum("ij,ij->i", state.forces, state.normals)
    if whole:
        position = lattice(dome).points + displacements(dome, state)
    else:
        position = lattice(dome).points.copy()
        position[state.near] += state.displacement[state.near]
    touching = 1e-6  # normal force above which a node is in contact, over the force of all [–]
    return ForceField(
        position=position,
        normal=normal,
        friction=state.friction.copy(),
        contact=normal > touching * max(normal.sum(), 1e-9),
        totals_covariance=np.zeros((2, 2)),
        directions=state.normals.copy(),
        wrench_covariance=np.zeros((4, 4)),
    )


def limit_margin(dome: SoftBody, solid: Solid, state: DomeState) -> float:
    """Margin of a state to the limit surface of friction and torsion; NaN without contact.

    It is 1 − 1/λ, with the largest factor λ by which friction and torsion could both grow at the
    present normal forces. Without torsion it is Γ on a flat object. On a round object, friction
    towards the middle counts in ΣFf but not here.
    """
    return margin_within(dome_forces(dome, state), solid.friction)


def contact_steps(
    dome: SoftBody, solid: Solid, motion: Motion, dt: float, start: DomeState | None = None
) -> Iterator[tuple[Stepper, StepCount]]:
    """Step a dome while an object moves, for loops that use each step.

    Parameters
    ----------
    dome: dome or pad
    solid: object
    motion: motion of the object over time
    dt: longest step [s]; every knot of the motion ends a step
    start: state from which to go on (default: at rest)

    Yields
    ------
    stepper after a step, always the same object, with its `state()`; and counts of the step
    """
    finite("time step", dt, "s", above=0.0)
    stepper = Stepper(dome, solid, motion, start or resting(dome, solid, motion))
    for time in _times(motion, dt, stepper.time):
        count = stepper.advance(time)
        yield stepper, count


def simulate_contact(
    dome: SoftBody,
    solid: Solid,
    motion: Motion,
    dt: float = 1e-3,
    *,
    start: DomeState | None = None,
    keep: int = 20,
) -> DomeRun:
    """Simulate an object that presses and moves on a dome.

    Parameters
    ----------
    dome: dome or pad
    solid: object
    motion: motion of the object over time
    dt: longest step (default 1 ms) [s]; every knot of the motion ends a step
    start: state of a run from which to go on, at a time of the same motion (default: at rest)
    keep: number of states that are kept, evenly over the steps (default 20)

    Raises
    ------
    UserError
        For an object in the dome at the start, a press that is too deep, and a step without
        solution.
    """
    if not isinstance(solid, Solid):  # a bare shape is a common slip
        raise UserError(f"a dome is touched by a Solid, got {solid!r}; make one: Solid(shape=…)")
    finite("time step", dt, "s", above=0.0)
    finite("states to keep", keep, "", above=0.0)
    stepper = Stepper(dome, solid, motion, start or resting(dome, solid, motion))
    times = _times(motion, dt, stepper.time)
    kept = set(np.unique(np.linspace(len(times) - 1, 0, min(keep, len(times))).round()).astype(int))
    rows, counts, states = [], [], []
    points = lattice(dome).points
    for k, time in enumerate(times):
        counts.append(stepper.advance(time))
        near = stepper.near
        force = stepper.forces[near]
        torque = np.cross(points[near] + stepper.displacement[near], force).sum(axis=0)
        rows.append((stepper.place.copy(), stepper.rotation.copy(), force.sum(axis=0), torque))
        if k in kept:
            states.append(stepper.state())
    places, rotations, forces, torques = (np.stack(part) for part in zip(*rows, strict=True))
    return DomeRun(
        dome=dome, solid=solid, motion=motion, times=times, places=places, rotations=rotations,
        total_forces=forces, total_torques=torques,
        rounds=np.array([count.rounds for count in counts]),
        touching=np.array([count.touching for count in counts]),
        halvings=sum(count.halvings for count in counts),
        unconverged=sum(count.unconverged for count in counts),
        states=tuple(states),
    )  # fmt: skip


def _times(motion: Motion, dt: float, start: float) -> Array:
    """Ends of the steps after `start` [s], at most dt apart, including every knot.

    They do not depend on `start`, so that a continued run takes the same steps.
    """
    ends: list[float] = []
    for before, after in zip(motion.times[:-1], motion.times[1:], strict=True):
        count = max(1, int(np.ceil((after - before) / dt - 1e-9)))
        ends.extend(before + (after - before) * np.arange(1, count + 1) / count)
    times = np.array(ends)
    times = times[times > start + 1e-12]
    if not len(times):
        raise UserError(f"the motion ends at {motion.duration:g} s, and the run is at {start:g} s")
    return times
