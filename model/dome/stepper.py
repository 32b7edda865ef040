"""Stepper of a dome in contact, which owns the arrays of the steps."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import ConvergenceError
from ..kernels.dome.compliance_kernels import displace
from ..kernels.dome.newton_kernels import nobody, solve_contact
from ..kernels.dome.node_kernels import Outcome
from ..kernels.dome.touch_kernels import Pose
from ..kernels.dome.turn_kernels import turned
from .compliance import skin_compliance
from .dome import SoftBody
from .motion import Motion, Way
from .placing import rotation_of, touching_place
from .skin import Skin
from .solid import Solid
from .state import DomeState, StepCount, check_state

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class StepSettings:
    """Tuned numbers of a step of the silicone.

    Attributes
    ----------
    tolerance: relative change of the forces at which a step is solved
    rounds: largest number of rounds
    halvings: number of times that a step is halved
    enough: change below which the shortest parts are taken as they are
    leaps: number of halvings of a step in which a free object might leap through the silicone
    before_creep: number of halvings before the skin is slowed down
    creeps: largest number of steps of a slowed skin
    slow, slowest, quick: lag of a slowed skin at first and at most, and below which it is none
    """

    tolerance: float = 3e-4
    rounds: int = 20
    halvings: int = 4
    enough: float = 0.05
    leaps: int = 10
    before_creep: int = 1
    creeps: int = 80
    slow: float = 8.0
    slowest: float = 1e3
    quick: float = 0.3


STEP = StepSettings()


class Stepper(Skin):
    """Arrays of a dome and an object in contact; `advance` makes a step and changes them.

    Attributes
    ----------
    motion: motion of the object in the next steps
    start: place of the object where the motion's pose is all zeros [m], shape (3,)
    """

    #: State that the arrays hold, if it is known.
    _held: DomeState | None = None

    def __init__(self, dome: SoftBody, solid: Solid, motion: Motion, state: DomeState) -> None:
        self.motion: Motion | Way = motion
        self.start = touching_place(dome, solid, rotation_of(motion.poses[0]))
        super().__init__(dome, solid, state)

    def restore(self, state: DomeState) -> None:
        """Set all arrays from a state, as `Skin.restore`; free where they hold it."""
        if state is not self._held:
            super().restore(state)
            self._held = state

    def state(self) -> DomeState:
        """Copy everything that the next step starts from, once a step."""
        if self._held is None:
            self._held = super().state()
        return self._held

    def advance(self, until: float, load: Array | None = None) -> StepCount:
        """Step to a time [s], in halves as long as it does not converge.

        Parameters
        ----------
        load: force and torque on the free axes [N, N·m], shape (6,); None: those of the motion

        Raises
        ------
        ConvergenceError: when the shortest part of the step does not converge
        PiercedError: when the object is pressed too deep into the silicone
        """
        count = self._attempt(until, 0, load)
        self.check_depth()
        return count

    def _attempt(self, until: float, depth: int, load: Array | None) -> StepCount:
        """Make a step that is halved `depth` times so far, or its halves."""
        before = self.state()
        count = self._solve(until, self.dome.relaxation / (until - self.time), load)
        leapt = np.linalg.norm(self.place - before.place) > self.dome.stride
        leapt &= self.motion.moves_free.any() and depth < STEP.leaps
        if count.error < STEP.tolerance and not leapt:
            return count
        creeps = not self.motion.moves_free.any() and not self.dome.relaxation
        if creeps and depth == STEP.before_creep:
            self.restore(before)
            return self._creep(until)
        if depth >= STEP.halvings and not leapt:
            return self._enough(count, until, until - before.time)
        self.restore(before)
        first = self._attempt(0.5 * (before.time + until), depth + 1, load)
        self.check_depth()
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
        """Accept a step with a small error, else raise ConvergenceError."""
        if count.error < STEP.enough:
            return count._replace(unconverged=1)
        raise ConvergenceError(
            f"the contact at {until:.6g} s does not converge in steps of "
            f"{step * 1e6:.3g} µs; a softer object or smoother motion does"
        )

    def _creep(self, until: float) -> StepCount:
        """Make a step with artificial viscosity, which is reduced to 0 as the skin comes to rest.

        Where a node snaps over an edge there is no equilibrium near the previous one, however short
        the step. A viscous skin moves continuously to the next one.
        """
        step = until - self.time
        self._held = None
        self.memory[:] = self.linear
        lag, rounds, products = STEP.slow, 0, 0
        for _ in range(STEP.creeps):
            before = self.state()
            count = self._solve(until, lag)
            rounds, products = rounds + count.rounds, products + count.products
            if count.error < STEP.tolerance:
                if lag == 0.0:
                    break
                lag = 0.6 * lag if lag > STEP.quick else 0.0
            else:
                if lag >= STEP.slowest:
                    break
                self.restore(before)
                lag = max(4.0 * lag, STEP.quick)
        self._held = None
        self.memory[:] = 0.0
        count = count._replace(rounds=rounds, products=products)
        if count.error < STEP.tolerance and lag == 0.0:
            return count
        return self._enough(count._replace(error=max(count.error, STEP.tolerance)), until, step)

    def _solve(self, until: float, lag: float, load: Array | None = None) -> StepCount:
        """Solve one step and take it over, whatever its error; `lag` is viscosity over step."""
        step = until - self.time
        self._held = None
        free = np.array(self.motion.moves_free, np.bool_)
        moves = bool(free.any())
        rotation, place = self._guess(until)
        inertia, wanted = self._inertia(rotation, until, step, load)
        share = 1.0 / (1.0 + lag)
        for _ in range(4):
            self.find(rotation, place)
            near, contact = self.near, self.contact(lag)
            shape = (len(near), 3)
            outcome = Outcome(
                self.linear[near], np.zeros(shape), np.zeros(shape), np.zeros(shape),
                np.zeros(shape), np.zeros(6),
            )  # fmt: skip
            pose = Pose(self.rotation, self.place, rotation, place)
            stiff = self.stiffening()
            error, rounds, products, touching = solve_contact(
                contact, self.thing, pose, stiff, share, free, inertia, wanted,
                STEP.tolerance, STEP.rounds, False, self.block.system, outcome,
                nobody(stiff),
            )  # fmt: skip
            moved = outcome.motion
            new_place, new_rotation = place + moved[:3], turned(rotation, moved[3:])
            if not moves or not self.missed(new_rotation, new_place):
                break
        if step > 0.0:
            self.velocity = self._velocity(step, new_place, moved)
        self.place, self.rotation, self.time = new_place, new_rotation, until
        self.take_over(near, outcome, lag)
        return StepCount(rounds, products, touching, 0, error)

    def _guess(self, until: float) -> tuple[Array, Array]:
        """Guess the pose after a step: the present one on free axes, else the prescribed one."""
        motion = self.motion
        if isinstance(motion, Way):
            return motion.at(until)
        free = motion.moves_free
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
        """Rotation and position of the object at a pose of the motion."""
        return rotation_of(pose), self.start + pose[:3]

    def _inertia(
        self, rotation: Array, until: float, step: float, load: Array | None
    ) -> tuple[Array, Array]:
        """Inertia matrix of the free axes over a step, and wrench that drives them."""
        motion = self.motion
        inertia = np.zeros((6, 6))
        if isinstance(motion, Way) or not motion.moves_free.any():
            return inertia, np.zeros(6)
        wanted = (motion.load_at(until) if load is None else load).copy()
        mass = np.zeros((6, 6))
        mass[:3, :3] = motion.mass * np.eye(3)
        mass[3:, 3:] = rotation @ np.diag(motion.inertia) @ rotation.T
        wanted[:3] += motion.mass * np.asarray(motion.gravity)
        spin = self.velocity[3:]
        wanted += mass @ self.velocity / step
        if spin.any():
            wanted[3:] -= np.cross(spin, mass[3:, 3:] @ spin)
        inertia = mass / step**2 + np.diag(motion.drag) / step
        return inertia, wanted

    def _velocity(self, step: float, place: Array, moved: Array) -> Array:
        """Velocity and angular velocity of the object after a step, shape (6,)."""
        free = self.motion.moves_free
        change = np.concatenate([place - self.place, moved[3:]]) / step
        if not free.any():
            return change
        return np.where(free, change, np.concatenate([(place - self.place) / step, np.zeros(3)]))


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
