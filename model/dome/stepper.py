"""A dome in contact, one step after another; the arrays that a step works in."""

import numpy as np
from numpy.typing import NDArray

from ..errors import ConvergenceError, PiercedError
from ..kernels.dome.compliance_kernels import displace
from ..kernels.dome.near_kernels import find_near, node_groups
from ..kernels.dome.newton_kernels import Contact, Outcome, solve_contact, turned
from ..kernels.dome.touch_kernels import Pose
from .compliance import skin_compliance
from .dome import Lattice, SoftBody, lattice
from .motion import Motion
from .near_block import NearBlock
from .placing import rotation_of, touching_place
from .solid import Solid, touched
from .state import DomeState, StepCount, check_state
from .stiffening import stiffening_of

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: Distance at which a node is taken into a step's unknowns, in pitches, …
MARGIN = 0.25
#: … and how much further those are that come with it.
WIDER = 2.2
#: Relative change of the forces at which a step is solved, and the most rounds it may take.
TOLERANCE, ROUNDS = 3e-4, 20
#: Times that a step is halved; the parts are taken as they are if they changed by less than this.
HALVINGS, ENOUGH = 4, 0.05
#: Times that it is halved before the skin is slowed down, and the most steps of that.
_BEFORE_CREEP, _CREEPS = 1, 80
#: Lag of a skin that is slowed down, at first, at most, and below which it is none.
_SLOW, _SLOWEST, _QUICK = 8.0, 1e3, 0.3
#: Part of the thickness beyond which the silicone is not described.
DEEPEST = 0.8
#: A step in which a free object might leap through the silicone is halved up to so many times.
_LEAPS = 10
#: Forces that viscosity remembers below this are forgotten [N].
_FORGOTTEN = 1e-9


class Stepper:
    """Arrays of a dome and an object in contact; `advance` makes a step and changes them."""

    def __init__(self, dome: SoftBody, solid: Solid, motion: Motion, state: DomeState) -> None:
        self.dome, self.solid, self.motion = dome, solid, motion
        self.thing = touched(solid)
        self.lattice: Lattice = lattice(dome)
        self.radial = self.lattice.outwards
        self.groups = node_groups(self.lattice.points)
        self.block = NearBlock(dome)
        self.is_near = np.zeros(len(self.radial), np.bool_)
        self.flags = np.zeros(len(self.radial), np.bool_)
        self.start = touching_place(dome, solid, rotation_of(motion.poses[0]))
        self.restore(state)

    @property
    def near(self) -> Index:
        """Nodes that are looked at, shape (n,)."""
        return self.block.near

    def touch(self, solid: Solid) -> None:
        """Go on with another material of the same object."""
        self.solid, self.thing = solid, touched(solid)

    def restore(self, state: DomeState) -> None:
        """Take over a state.

        Raises
        ------
        UserError: for a state of another dome.
        """
        check_state(self.dome, state)
        self.time = state.time
        self.place, self.rotation = state.place.copy(), state.rotation.copy()
        self.velocity = state.velocity.copy()
        self.displacement = state.displacement.copy()
        self.linear, self.memory = state.linear.copy(), state.memory.copy()
        self.forces, self.friction = state.forces.copy(), state.friction.copy()
        self.normals = state.normals.copy()
        if not np.array_equal(self.near, state.near):
            self._take(state.near.copy(), 0)

    def state(self) -> DomeState:
        """Copy of everything that the next step starts from."""
        return DomeState(
            time=self.time,
            place=self.place.copy(),
            rotation=self.rotation.copy(),
            velocity=self.velocity.copy(),
            displacement=self.displacement.copy(),
            linear=self.linear.copy(),
            memory=self.memory.copy(),
            forces=self.forces.copy(),
            friction=self.friction.copy(),
            normals=self.normals.copy(),
            near=self.near.copy(),
        )

    def advance(self, until: float, load: Array | None = None) -> StepCount:
        """Step to a time, in halves where it does not converge.

        Parameters
        ----------
        load: force and torque on the free axes [N, N·m], shape (6,); None is the motion's

        Raises
        ------
        ConvergenceError: when the shortest part of the step does not converge
        PiercedError: when the object is pressed too deep into the silicone
        """
        count = self._attempt(until, 0, load)
        self._check_depth()
        return count

    def _attempt(self, until: float, depth: int, load: Array | None) -> StepCount:
        before = self.state()
        count = self._solve(until, self.dome.relaxation / (until - self.time), load)
        leapt = np.linalg.norm(self.place - before.place) > self.dome.stride
        leapt &= self.motion.moves_free.any() and depth < _LEAPS
        if count.error < TOLERANCE and not leapt:
            return count
        creeps = not self.motion.moves_free.any() and not self.dome.relaxation
        if creeps and depth == _BEFORE_CREEP:
            self.restore(before)
            return self._creep(until)
        if depth >= HALVINGS and not leapt:
            return self._enough(count, until, until - before.time)
        self.restore(before)
        first = self._attempt(0.5 * (before.time + until), depth + 1, load)
        self._check_depth()
        second = self._attempt(until, depth + 1, load)
        return StepCount(
            count.rounds + first.rounds + second.rounds,
            count.products + first.products + second.products,
            second.touching,
            1 + first.halvings + second.halvings,
            max(first.error, second.error),
            first.unconverged + second.unconverged,
        )

    def _enough(self, count: StepCount, until: float, step: float) -> StepCount:
        if count.error < ENOUGH:
            return count._replace(unconverged=1)
        raise ConvergenceError(
            f"the contact at {until:.6g} s does not converge in steps of "
            f"{step * 1e6:.3g} µs; a softer object or smoother motion does"
        )

    def _creep(self, until: float) -> StepCount:
        """Step in which the skin is slowed down, more and then less, until it is at rest.

        Where a node snaps over an edge there is no equilibrium near the one before, however short
        the step; a viscous skin has a way to the next one.
        """
        step = until - self.time
        self.memory[:] = self.linear
        lag, rounds, products = _SLOW, 0, 0
        for _ in range(_CREEPS):
            before = self.state()
            count = self._solve(until, lag)
            rounds, products = rounds + count.rounds, products + count.products
            if count.error < TOLERANCE:
                if lag == 0.0:
                    break
                lag = 0.6 * lag if lag > _QUICK else 0.0
            else:
                if lag >= _SLOWEST:
                    break
                self.restore(before)
                lag = max(4.0 * lag, _QUICK)
        self.memory[:] = 0.0
        count = count._replace(rounds=rounds, products=products)
        if count.error < TOLERANCE and lag == 0.0:
            return count
        return self._enough(count._replace(error=max(count.error, TOLERANCE)), until, step)

    def _solve(self, until: float, lag: float, load: Array | None = None) -> StepCount:
        step = until - self.time
        free = np.asarray(self.motion.moves_free, np.bool_)
        moves = bool(free.any())
        rotation, place = self._guess(until)
        inertia, wanted = self._inertia(rotation, until, step, load)
        share = 1.0 / (1.0 + lag)
        for _ in range(4):
            self._find(rotation, place)
            near = self.near
            offset = np.zeros((len(near), 3))
            if lag:
                size = 3 * len(near)
                offset.ravel()[:] = self.block.compliance[:size, :size] @ (
                    lag * share * self.memory[near].ravel()
                )
            contact = Contact(
                self.lattice.points[near],
                self.radial[near],
                self.lattice.areas[near],
                self.lattice.points[near] + self.displacement[near],
                offset,
                self.friction[near],
                self.block.compliance,
                self.block.own,
            )
            shape = (len(near), 3)
            outcome = Outcome(
                self.linear[near], np.zeros(shape), np.zeros(shape), np.zeros(shape),
                np.zeros(shape), np.zeros(6),
            )  # fmt: skip
            pose = Pose(self.rotation, self.place, rotation, place)
            stiff = stiffening_of(
                self.dome, self.solid.friction, self.lattice.areas[near], self.forces[near],
                self.friction[near],
            )  # fmt: skip
            error, rounds, products, touching = solve_contact(
                contact, self.thing, pose, stiff, share, free, inertia, wanted, TOLERANCE, ROUNDS,
                False, self.block.system, outcome,
            )  # fmt: skip
            moved = outcome.motion
            new_place, new_rotation = place + moved[:3], turned(rotation, moved[3:])
            if not moves or not self._missed(new_rotation, new_place):
                break
        if step > 0.0:
            self.velocity = self._velocity(step, new_place, moved)
        self.place, self.rotation, self.time = new_place, new_rotation, until
        self.linear[near] = outcome.linear
        self.forces[near], self.friction[near] = outcome.true, outcome.tangential
        on = np.asarray(outcome.true.any(axis=1))
        self.normals[near] = np.where(on[:, None], outcome.normal, 0.0)
        self.displacement[near] = outcome.displacement
        if lag:
            self.memory[near] = share * (outcome.linear + lag * self.memory[near])
            self.memory[abs(self.memory) < _FORGOTTEN] = 0.0
        return StepCount(rounds, products, touching, 0, error)

    def _guess(self, until: float) -> tuple[Array, Array]:
        """Pose that the step starts from on its free axes, and goes to on the others."""
        motion, free = self.motion, self.motion.moves_free
        if not free.any():
            return self._pose(motion.pose_at(until))
        if not free[3:].any():
            rotation, place = self._pose(motion.pose_at(until))
        else:
            now, then = motion.pose_at(until), motion.pose_at(self.time)
            rotation = turned(self.rotation, np.where(free[3:], 0.0, (now - then)[3:]))
            place = self._pose(now)[1]
        return rotation, np.where(free[:3], self.place, place)

    def _pose(self, pose: Array) -> tuple[Array, Array]:
        return rotation_of(pose), self.start + pose[:3]

    def _inertia(
        self, rotation: Array, until: float, step: float, load: Array | None
    ) -> tuple[Array, Array]:
        """M of the free axes over a step, and the wrench with which they would move freely."""
        motion = self.motion
        wanted = (motion.load_at(until) if load is None else load).copy()
        inertia = np.zeros((6, 6))
        if not motion.moves_free.any():
            return inertia, wanted
        mass = np.zeros((6, 6))
        mass[:3, :3] = motion.mass * np.eye(3)
        mass[3:, 3:] = rotation @ np.diag(motion.inertia) @ rotation.T
        wanted[:3] += motion.mass * np.asarray(motion.gravity)
        spin = self.velocity[3:]
        wanted += mass @ self.velocity / step
        wanted[3:] -= np.cross(spin, mass[3:, 3:] @ spin)
        inertia = mass / step**2 + np.diag(motion.drag) / step
        return inertia, wanted

    def _velocity(self, step: float, place: Array, moved: Array) -> Array:
        free = self.motion.moves_free
        change = np.concatenate([place - self.place, moved[3:]]) / step
        if not free.any():
            return change
        return np.where(free, change, np.concatenate([(place - self.place) / step, np.zeros(3)]))

    def _find(self, rotation: Array, place: Array) -> None:
        """Take new nodes into the unknowns where the object comes near them."""
        margin = MARGIN * self.dome.spacing
        pose = Pose(rotation, place, rotation, place)
        count = self._flag(pose, margin)
        near = self.near
        if count and not (self.flags & ~self.is_near).any() and len(near) <= 1.5 * count + 20:
            return
        if not count and not len(near):
            return
        self._flag(pose, WIDER * margin)
        stay = near[self.flags[near]]
        new = np.flatnonzero(self.flags & ~self.is_near)
        kept = len(stay) if len(stay) == len(near) else 0
        self._take(np.concatenate([stay, new]), kept)
        if len(new):
            source = self.memory if self.memory.any() else self.linear
            loaded = np.flatnonzero(source.any(axis=1))
            self.block.displace(loaded, source, new, self.displacement)

    def _flag(self, pose: Pose, margin: float) -> int:
        return find_near(
            self.thing, pose, margin, self.lattice.points, self.displacement, self.linear,
            self.memory, self.near, self.groups, self.flags,
        )  # fmt: skip

    def _missed(self, rotation: Array, place: Array) -> bool:
        """Whether the object came to nodes that were not looked at; they are from now on."""
        self._flag(Pose(rotation, place, rotation, place), 0.0)
        if not (self.flags & ~self.is_near).any():
            return False
        self._find(rotation, place)
        return True

    def _take(self, near: Index, kept: int) -> None:
        """Make the equations those of `near`; the compliance of the first `kept` is there."""
        self.block.take(near, kept)
        self.is_near[:] = False
        self.is_near[near] = True

    def _check_depth(self) -> None:
        near = self.near
        if not len(near):
            return
        depth = -np.einsum("ij,ij->i", self.displacement[near], self.radial[near])
        deepest = depth.max() / self.dome.thickness
        if deepest > DEEPEST:
            raise PiercedError(
                f"at {self.time:.6g} s the object is pressed to {deepest:.0%} of the silicone of "
                f"{1e3 * self.dome.thickness:.3g} mm; it is described to {DEEPEST:.0%}"
            )


def displacements(dome: SoftBody, state: DomeState) -> Array:
    """Displacement of every node of the skin in a state [m], shape (N, 3).

    Raises
    ------
    UserError: for a state of another dome.
    """
    check_state(dome, state)
    out = np.zeros_like(state.displacement)
    forces = state.memory if dome.relaxation else state.linear
    loaded = np.flatnonzero(forces.any(axis=1))
    displace(skin_compliance(dome), loaded, forces, np.arange(len(out)), out)
    return out
