"""A dome in contact, one step after another; the arrays that a step works in."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ..errors import ConvergenceError, PiercedError
from ..kernels.compliance_kernels import displace, fill_block
from ..kernels.krylov_kernels import System, new_system
from ..kernels.near_kernels import find_near
from ..kernels.newton_kernels import Contact, Outcome, solve_contact, turned
from ..kernels.touch_kernels import Pose
from ..shapes import distances
from .compliance import compliance_scale, compliance_table
from .dome import Dome, Lattice, lattice
from .motion import Motion
from .solid import Solid, touched
from .stiffening import stiffening_of

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: Distance at which a node is taken into a step's unknowns, in pitches, …
MARGIN = 0.25
#: … and how much further those are that come with it.
WIDER = 2.2
#: Relative change of the forces at which a step is solved, and the most rounds it may take.
TOLERANCE, ROUNDS = 3e-4, 30
#: Times that a step is halved; the parts are taken as they are if they changed by less than this.
HALVINGS, ENOUGH = 4, 0.05
#: Part of the thickness beyond which the silicone is not described.
DEEPEST = 0.8
#: Forces that viscosity remembers below this are forgotten [N].
_FORGOTTEN = 1e-9


@dataclass(frozen=True, kw_only=True)
class DomeState:
    """All that a step of a dome starts from.

    Attributes
    ----------
    time: [s]
    place, rotation: of the object in the sensor's frame [m], shapes (3,) and (3, 3)
    velocity: of its place, and its angular velocity [m/s, rad/s], shape (6,)
    displacement: of the nodes [m], shape (N, 3); right for those in `near`, see `displacements`
    linear: forces that the linear skin carries [N], shape (N, 3)
    memory: the same, as viscosity remembers them [N], shape (N, 3)
    forces: of the object on the nodes [N], shape (N, 3)
    friction: the part of `forces` in the object's tangent planes [N], shape (N, 3)
    normals: of the object at the nodes that touch it, zero elsewhere, shape (N, 3)
    near: nodes that a step looks at, in the order of its equations, shape (n,)
    """

    time: float
    place: Array
    rotation: Array
    velocity: Array
    displacement: Array
    linear: Array
    memory: Array
    forces: Array
    friction: Array
    normals: Array
    near: Index


class StepCount(NamedTuple):
    """What a step took.

    Attributes
    ----------
    rounds: of Newton's method
    products: with the compliance
    touching: nodes that touch at its end
    halvings: how often it, or a part of it, was halved
    error: relative change of the forces in the last round
    unconverged: parts of the step that were taken although they did not converge
    """

    rounds: int
    products: int
    touching: int
    halvings: int
    error: float
    unconverged: int = 0


class Stepper:
    """Arrays of a dome and an object in contact; `advance` makes a step and changes them."""

    def __init__(self, dome: Dome, solid: Solid, motion: Motion, state: DomeState) -> None:
        self.dome, self.solid, self.motion = dome, solid, motion
        self.thing = touched(solid)
        self.lattice: Lattice = lattice(dome)
        self.radial = self.lattice.points / dome.radius
        self.table = compliance_table(dome)
        self.scale = compliance_scale(dome)
        self.capacity = 0
        self.compliance = np.zeros((0, 0), np.float32)
        self.system: System = new_system(0)
        self.near = np.zeros(0, np.int64)
        self.is_near = np.zeros(len(self.radial), np.bool_)
        self.flags = np.zeros(len(self.radial), np.bool_)
        self.start = touching_place(dome, solid, _rotation(motion.poses[0]))
        self.restore(state)

    def touch(self, solid: Solid) -> None:
        """Go on with another material of the same object."""
        self.solid, self.thing = solid, touched(solid)

    def restore(self, state: DomeState) -> None:
        """Take over a state."""
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
        count = self._solve(until, load)
        if count.error < TOLERANCE:
            return count
        if depth == HALVINGS:
            if count.error < ENOUGH:
                return count._replace(unconverged=1)
            raise ConvergenceError(
                f"the contact at {until:.6g} s does not converge in steps of "
                f"{(until - before.time) * 1e6:.3g} µs; a softer object or smoother motion does"
            )
        self.restore(before)
        first = self._attempt(0.5 * (before.time + until), depth + 1, load)
        second = self._attempt(until, depth + 1, load)
        return StepCount(
            count.rounds + first.rounds + second.rounds,
            count.products + first.products + second.products,
            second.touching,
            1 + first.halvings + second.halvings,
            max(first.error, second.error),
            first.unconverged + second.unconverged,
        )

    def _solve(self, until: float, load: Array | None) -> StepCount:
        step = until - self.time
        free = np.asarray(self.motion.moves_free, np.bool_)
        moves = bool(free.any())
        rotation, place = self._guess(until)
        inertia, wanted = self._inertia(rotation, until, step, load)
        lag = self.dome.relaxation / step
        share = 1.0 / (1.0 + lag)
        for _ in range(4):
            self._find(rotation, place)
            near = self.near
            offset = np.zeros((len(near), 3))
            if lag:
                size = 3 * len(near)
                offset.ravel()[:] = self.compliance[:size, :size] @ (
                    lag * share * self.memory[near].ravel()
                )
            contact = Contact(
                self.lattice.points[near],
                self.radial[near],
                self.lattice.areas[near],
                self.lattice.points[near] + self.displacement[near],
                offset,
                self.friction[near],
                self.compliance,
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
                self.system, outcome,
            )  # fmt: skip
            moved = outcome.motion
            new_place, new_rotation = place + moved[:3], turned(rotation, moved[3:])
            if not moves or not self._missed(new_rotation, new_place):
                break
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
        return _rotation(pose), self.start + pose[:3]

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
        if count and not (self.flags & ~self.is_near).any() and len(self.near) <= 1.5 * count + 20:
            return
        if not count and not len(self.near):
            return
        self._flag(pose, WIDER * margin)
        stay = self.near[self.flags[self.near]]
        new = np.flatnonzero(self.flags & ~self.is_near)
        kept = len(stay) if len(stay) == len(self.near) else 0
        self._take(np.concatenate([stay, new]), kept)
        if len(new):
            loaded = np.flatnonzero(
                self.memory.any(axis=1) if self.dome.relaxation else self.linear.any(axis=1)
            )
            source = self.memory if self.dome.relaxation else self.linear
            displace(
                self.table, len(self.lattice.angles), self.lattice.ring, self.lattice.azimuth,
                self.scale, loaded, source, new, self.displacement,
            )  # fmt: skip

    def _flag(self, pose: Pose, margin: float) -> int:
        return find_near(
            self.thing, pose, margin, self.lattice.points, self.displacement, self.linear,
            self.memory, self.flags,
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
        if len(near) > self.capacity:
            self.capacity = len(near) + 32
            room = np.zeros((3 * self.capacity, 3 * self.capacity), np.float32)
            room[: 3 * kept, : 3 * kept] = self.compliance[: 3 * kept, : 3 * kept]
            self.compliance, self.system = room, new_system(self.capacity)
        self.near = near
        self.is_near[:] = False
        self.is_near[near] = True
        fill_block(
            self.table, len(self.lattice.angles), self.lattice.ring, self.lattice.azimuth,
            self.scale, near, kept, self.compliance,
        )  # fmt: skip

    def _check_depth(self) -> None:
        near = self.near
        if not len(near):
            return
        depth = -np.einsum("ij,ij->i", self.displacement[near], self.radial[near])
        deepest = depth.max() / self.dome.thickness
        if deepest > DEEPEST:
            raise PiercedError(
                f"at {self.time:.6g} s the object is pressed to {deepest:.0%} of the silicone of "
                f"{1e3 * self.dome.thickness:.3g} mm; the dome is described to {DEEPEST:.0%}"
            )


def _rotation(pose: Array) -> Array:
    return turned(np.eye(3), np.ascontiguousarray(pose[3:]))


def displacements(dome: Dome, state: DomeState) -> Array:
    """Displacement of every node of the skin in a state [m], shape (N, 3)."""
    nodes = lattice(dome)
    out = np.zeros_like(state.displacement)
    forces = state.memory if dome.relaxation else state.linear
    displace(
        compliance_table(dome), len(nodes.angles), nodes.ring, nodes.azimuth,
        compliance_scale(dome), np.flatnonzero(forces.any(axis=1)), forces,
        np.arange(len(nodes.ring)), out,
    )  # fmt: skip
    return out


def touching_place(
    dome: Dome, solid: Solid, rotation: Array, beside: tuple[float, float] = (0.0, 0.0)
) -> Array:
    """Place above the apex at which a turned object just touches the dome [m], shape (3,).

    Parameters
    ----------
    beside: of the place beside the apex, along x and y [m]

    Raises
    ------
    UserError: when the object cannot lie on the dome
    """
    points = lattice(dome).points
    height = dome.radius + max(solid.shape.reach_down(rotation), 0.0) + dome.radius
    for _ in range(400):
        place = np.array([*beside, height])
        gap, normal = distances(solid.shape, (points - place) @ rotation)
        nearest = int(gap.argmin())
        point, distance = points[nearest], gap[nearest]
        for _ in range(20):  # nearest point of the sphere, by projections to and fro
            surface = point - distance * (rotation @ normal[nearest])
            closer = dome.radius * surface / np.linalg.norm(surface)
            (new,), (facing,) = distances(solid.shape, ((closer - place) @ rotation)[None])
            if new >= distance - 1e-12:
                break
            point, distance, normal[nearest] = closer, new, facing
        if abs(distance) < 1e-9:
            return place
        height -= distance
    raise UserError(f"the object {solid.shape.name} does not come to lie on the dome from above")


def resting(dome: Dome, solid: Solid, motion: Motion) -> DomeState:
    """State at the start of a motion, in which nothing touches.

    Raises
    ------
    UserError: when the object is in the dome at the start.
    """
    rotation = _rotation(motion.poses[0])
    place = touching_place(dome, solid, rotation) + motion.poses[0, :3]
    gap, _ = distances(solid.shape, (lattice(dome).points - place) @ rotation)
    if gap.min() < -1e-9:
        raise UserError(
            f"the object {solid.shape.name} is {-1e3 * gap.min():.3g} mm inside the dome at the "
            "start; the first pose must not be below the one that just touches, which is all zeros"
        )
    count = len(gap)

    def zeros() -> Array:
        return np.zeros((count, 3))

    return DomeState(
        time=0.0, place=place, rotation=rotation, velocity=np.zeros(6), displacement=zeros(),
        linear=zeros(), memory=zeros(), forces=zeros(), friction=zeros(), normals=zeros(),
        near=np.zeros(0, np.int64),
    )  # fmt: skip
