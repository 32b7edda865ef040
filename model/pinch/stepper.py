"""Stepper of a pinch: two skins, coupled by the object's pose and the closing distance."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..dome.skin import MARGIN, Skin
from ..dome.solid import Solid
from ..dome.state import StepCount
from ..dome.stepper import STEP
from ..errors import ConvergenceError
from ..kernels.dome.krylov_kernels import System, new_system
from ..kernels.dome.newton_kernels import Second, solve_contact
from ..kernels.dome.node_kernels import Contact, Outcome
from ..kernels.dome.touch_kernels import Pose
from ..kernels.dome.turn_kernels import rotation_vector, turned
from .body import Moving, Scheme, carried, scheme, wanted
from .pinch import FACING, Pinch, bases
from .state import PinchState

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class Solved(NamedTuple):
    """Solution of a step.

    Attributes
    ----------
    place, rotation: pose of the object in the hand, (3,) [m] and (3, 3)
    closing: distance by which each fingertip has closed [m]
    moving: state of motion of the object in the world
    support: force of the table [N]
    """

    place: Array
    rotation: Array
    closing: float
    moving: Moving
    support: float


class PinchStepper:
    """Arrays of a pinch; `advance` makes a step and changes them."""

    def __init__(self, pinch: Pinch, state: PinchState) -> None:
        self.pinch = pinch
        self.bases = bases(pinch)
        self.skins = (
            Skin(pinch.first, pinch.solid, state.first),
            Skin(pinch.second, pinch.solid, state.second),
        )
        self._centre = np.array(pinch.body.centre)
        self._reach = float(np.linalg.norm(abs(pinch.solid.shape.bounds).max(axis=0)))
        # Way in pitches that object and skin may come after nodes were looked for: within the
        # margin of `Skin.find` none can have been missed. Half is for skin that is not looked at.
        sure = 0.5 * MARGIN
        self._sure = sure * min(skin.dome.spacing for skin in self.skins)
        self._system: System = new_system(0, 1)
        self._blocks: list[Index] = []
        self._facing = np.zeros((0, 0), np.float32)
        self._now(state)

    def touch(self, solid: Solid) -> None:
        """Change the material of the object, whose shape stays."""
        for skin in self.skins:
            skin.touch(solid)

    def restore(self, state: PinchState) -> None:
        """Set all arrays from a state.

        Raises
        ------
        UserError: for a state of other fingertips.
        """
        for skin, its in zip(self.skins, (state.first, state.second), strict=True):
            skin.restore(its)
        self._now(state)

    def _now(self, state: PinchState) -> None:
        """Set the values of a state that belong to no skin."""
        self.time, self.moving, self.closing = state.time, state.moving, state.closing
        self.drift, self.support, self.level = state.drift, state.support, state.level
        self.came = state.came

    def state(self) -> PinchState:
        """Copy everything that the next step starts from."""
        return PinchState(
            time=self.time, first=self.skins[0].state(), second=self.skins[1].state(),
            moving=self.moving, closing=self.closing, drift=self.drift, support=self.support,
            level=self.level, came=self.came,
        )  # fmt: skip

    def pose(self) -> tuple[Array, Array]:
        """Position [m] (3,) and rotation matrix (3, 3) of the object in the hand."""
        skin = self.skins[0]
        return skin.place + self._base(0, self.closing), skin.rotation

    def advance(self, until: float, grip: float) -> StepCount:
        """Step to a time [s] under a grip force of the drive [N], in halves until it converges.

        Raises
        ------
        ConvergenceError: when the shortest part of the step does not converge
        PiercedError: when the object is pressed too deep into the silicone
        """
        count = self._attempt(until, grip, 0)
        for skin in self.skins:
            skin.check_depth()
        return count

    def _attempt(self, until: float, grip: float, depth: int) -> StepCount:
        """Make a step that is halved `depth` times so far, or its halves."""
        before = self.state()
        place, _ = self.pose()
        count = self._solve(until, grip)
        way = float(np.linalg.norm(self.pose()[0] - place))
        held = any(len(skin.near) for skin in self.skins)
        leapt = held and depth < STEP.leaps and way > min(skin.dome.stride for skin in self.skins)
        if count.error < STEP.tolerance and not leapt:
            return count
        if depth >= STEP.halvings and not leapt:
            if count.error < STEP.enough:
                return count._replace(unconverged=1)
            raise ConvergenceError(
                f"the contact at {until:.6g} s does not converge in steps of "
                f"{(until - before.time) * 1e6:.3g} µs; a softer object or smoother motion does"
            )
        self.restore(before)
        first = self._attempt(0.5 * (before.time + until), grip, depth + 1)
        second = self._attempt(until, grip, depth + 1)
        return StepCount(
            count.rounds + first.rounds + second.rounds,
            count.products + first.products + second.products,
            second.touching,
            1 + first.halvings + second.halvings,
            max(first.error, second.error),
            first.unconverged + second.unconverged,
        )

    def _solve(self, until: float, grip: float) -> StepCount:
        """Solve one step and take it over, whatever its error."""
        step = until - self.time
        lags = [skin.dome.relaxation / step for skin in self.skins]
        s, hand = scheme(self.moving, step), self.pinch.hand.at(until)
        self._body = self.pinch.body_at(until)
        self._gravity = self._body.mass * np.array(self.pinch.gravity)
        old_place, old_rotation = self.pose()
        place = old_place + step * self.drift[:3]
        rotation = turned(old_rotation, step * self.drift[3:])
        closing, stands, guess = self.closing, self.support > 0.0, None
        came = self.came + step * self._way(self.drift)
        rounds = products = 0
        solves = 6  # at most: nodes that were missed, the table, the turn of the inertia
        lacking = 1e-4  # force that the inertia of the pose found may lack, of what acts
        for turn in range(solves):
            if came > self._sure:
                came = 0.0
                self._find(place, rotation, closing)
            if self._room():
                guess = None
            contact, outcome = self._contact(lags, guess)
            inertia, wrench = self._border(s, hand, place, rotation, closing, grip, stands)
            error, more, made, touching = self._solved(
                contact, outcome, lags, (place, rotation, closing), inertia, wrench,
                guess is not None,
            )  # fmt: skip
            rounds, products, guess = rounds + more, products + made, outcome
            motion = outcome.motion
            place, rotation = place + motion[:3], turned(rotation, motion[3:6])
            closing += motion[6]
            moved = contact.rest + outcome.displacement - contact.before
            came += self._way(motion) + float(abs(moved).max(initial=0.0))
            far = turn + 1 < solves and came > self._sure
            if far and self._missed(place, rotation, closing):
                continue
            found, lacks, pushed = self._carried(
                s, hand, (place, rotation, closing), contact, outcome
            )
            if self.pinch.table and (pushed > 0.0) != stands:
                stands = not stands
            elif lacks < lacking or error > STEP.tolerance:
                break
        self.came = came
        self._take_over(until, found, outcome, lags, (old_place, old_rotation))
        return StepCount(rounds, products, touching, 0, error)

    def _border(
        self,
        s: Scheme,
        hand: tuple[Array, Array],
        place: Array,
        rotation: Array,
        closing: float,
        grip: float,
        stands: bool,
    ) -> tuple[Array, Array]:
        """Inertia matrix (7, 7) of pose and closing distance, and wrench (7,) that drives them."""
        origin, turn = hand
        arm = rotation @ self._centre
        centre = origin + turn @ (place + arm)
        asked = wanted(self._body, self.moving, s, centre, turn @ rotation)
        force = turn.T @ (asked.force + self._gravity)
        mass = asked.mass * np.eye(3)
        if stands:
            down = turn.T @ self.pinch.down
            force -= self._pushed(centre) * down
            mass += self.pinch.table_stiffness * np.outer(down, down)
        # From the centre of mass to the object's origin
        lever = np.eye(6)
        lever[:3, 3:] = -_cross(arm)
        middle = np.zeros((6, 6))
        middle[:3, :3], middle[3:, 3:] = mass, turn.T @ asked.inertia @ turn
        inertia, wrench = np.zeros((7, 7)), np.empty(7)
        inertia[:6, :6] = lever.T @ middle @ lever
        wrench[:6] = lever.T @ np.concatenate([force, turn.T @ asked.torque])
        drag = 2.0 * self.pinch.drag / s.step
        inertia[6, 6] = drag
        wrench[6] = 2.0 * grip - drag * (closing - self.closing)
        return inertia, wrench

    def _pushed(self, centre: Array) -> float:
        """Force of the table for a position of the centre of mass [N]; negative above the table."""
        return self.pinch.table_stiffness * (float(self.pinch.down @ centre) - self.level)

    def _carried(
        self,
        s: Scheme,
        hand: tuple[Array, Array],
        at: tuple[Array, Array, float],
        contact: Contact,
        outcome: Outcome,
    ) -> tuple[Solved, float, float]:
        """Object at the end of a step, its relative imbalance there, and force of the table [N].

        This force is negative where the object is above the table.
        """
        place, rotation, closing = at
        origin, turn = hand
        split = len(self.skins[0].near)
        nodes = contact.rest + outcome.displacement
        nodes[:split] += self._base(0, closing)
        nodes[split:] += self._base(1, closing)
        arm = rotation @ self._centre
        centre = origin + turn @ (place + arm)
        force = -(turn @ outcome.true.sum(axis=0)) + self._gravity
        moments = (nodes - place - arm).T @ outcome.true
        torque = -(
            turn @ np.array([moments[k - 2, k - 1] - moments[k - 1, k - 2] for k in range(3)])
        )
        pushed = 0.0
        if self.pinch.table:
            pushed = self._pushed(centre)
            force = force - max(pushed, 0.0) * self.pinch.down
        moving = carried(self.moving, s, centre, turn @ rotation, force, torque)
        asked = wanted(self._body, self.moving, s, centre, turn @ rotation)
        negligible = 1e-6  # force below which a lack does not matter [N]
        scale = float(abs(outcome.true).sum() + abs(self._gravity).sum()) + negligible
        reach = 1e-3 + float(np.linalg.norm(arm))
        lacks = np.linalg.norm(asked.force + force) + np.linalg.norm(asked.torque + torque) / reach
        solved = Solved(place, rotation, closing, moving, max(pushed, 0.0))
        return solved, float(lacks) / scale, pushed

    def _take_over(
        self,
        until: float,
        found: Solved,
        outcome: Outcome,
        lags: list[float],
        old: tuple[Array, Array],
    ) -> None:
        """Set the state from a step's solution."""
        step = until - self.time
        turn = rotation_vector(found.rotation @ old[1].T)
        self.drift = np.concatenate([found.place - old[0], turn]) / step
        self.time, self.moving = until, found.moving
        self.closing, self.support = found.closing, found.support
        split = len(self.skins[0].near)
        for k, skin in enumerate(self.skins):
            part = slice(0, split) if k == 0 else slice(split, None)
            axes = _axes(k)
            its = Outcome(
                axes * outcome.linear[part],
                axes * outcome.true[part],
                axes * outcome.tangential[part],
                axes * outcome.normal[part],
                axes * outcome.displacement[part],
                outcome.motion,
            )
            skin.take_over(skin.near, its, lags[k])
            skin.place = axes * (found.place - self._base(k, found.closing))
            skin.rotation = axes[:, None] * found.rotation
            skin.time = until

    def _solved(
        self,
        contact: Contact,
        outcome: Outcome,
        lags: list[float],
        at: tuple[Array, Array, float],
        inertia: Array,
        wrench: Array,
        warm: bool,
    ) -> tuple[float, int, int, int]:
        """Run the solver: relative error, rounds, products and touching nodes."""
        place, rotation, closing = at
        first, second = self.skins
        pose = Pose(first.rotation, first.place, rotation, place - self._base(0, closing))
        there = np.stack([FACING * second.place, place - self._base(1, closing)])
        other = Second(
            len(first.near), self._facing, there, second.stiffening(), 1.0 / (1.0 + lags[1])
        )
        free = np.ones(7, np.bool_)
        answer: tuple[float, int, int, int] = solve_contact(
            contact, first.thing, pose, first.stiffening(), 1.0 / (1.0 + lags[0]), free, inertia,
            wrench, STEP.tolerance, STEP.rounds, warm, self._system, outcome, other,
        )  # fmt: skip
        return answer

    def _contact(self, lags: list[float], guess: Outcome | None) -> tuple[Contact, Outcome]:
        """Active nodes of both fingertips in the hand's axes, relative to each own centre."""
        first, second = (skin.contact(lag) for skin, lag in zip(self.skins, lags, strict=True))
        own = FACING[:, None] * second.own * FACING
        contact = Contact(
            np.concatenate([first.rest, FACING * second.rest]),
            np.concatenate([first.radial, FACING * second.radial]),
            np.concatenate([first.areas, second.areas]),
            np.concatenate([first.before, FACING * second.before]),
            np.concatenate([first.offset, FACING * second.offset]),
            np.concatenate([first.friction, FACING * second.friction]),
            first.compliance,
            np.concatenate([first.own, own]),
        )
        if guess is None:
            one, other = self.skins
            linear = np.concatenate([one.linear[one.near], FACING * other.linear[other.near]])
        else:
            linear = guess.linear
        a, b, c, d = np.zeros((4, *linear.shape))
        return contact, Outcome(linear, a, b, c, d, np.zeros(7))

    def _find(self, place: Array, rotation: Array, closing: float) -> None:
        """Choose the active nodes again where the object comes near inactive ones."""
        for k, skin in enumerate(self.skins):
            axes = _axes(k)
            skin.find(axes[:, None] * rotation, axes * (place - self._base(k, closing)))

    def _way(self, motion: Array) -> float:
        """Largest displacement of an object's point relative to a fingertip, by a motion [m]."""
        turn = math.sqrt(float(motion[3:6] @ motion[3:6])) * self._reach
        return math.sqrt(float(motion[:3] @ motion[:3])) + turn + float(abs(motion[6:]).sum())

    def _missed(self, place: Array, rotation: Array, closing: float) -> bool:
        """Whether the object reached inactive nodes; if so, activate them."""
        missed = [
            skin.missed(_axes(k)[:, None] * rotation, _axes(k) * (place - self._base(k, closing)))
            for k, skin in enumerate(self.skins)
        ]
        return any(missed)

    def _room(self) -> bool:
        """Allocate the equations of both fingertips; return whether their nodes have changed."""
        blocks = [skin.near for skin in self.skins]
        if self._blocks and all(a is b for a, b in zip(blocks, self._blocks, strict=True)):
            return False
        self._blocks = blocks
        squares = [skin.block.compliance for skin in self.skins]
        if len(squares[0]) > len(self._system.block) or len(squares[1]) > len(self._system.second):
            self._system = new_system(len(squares[0]) // 3, max(len(squares[1]) // 3, 1))
        self._system.gathered[0] = -1
        signs = np.tile(FACING.astype(np.float32), len(squares[1]) // 3)
        self._facing = signs[:, None] * squares[1] * signs
        return True

    def _base(self, k: int, closing: float) -> Array:
        """Position of a fingertip's centre in the hand [m], shape (3,)."""
        out = self.bases[k].copy()
        out[2] += closing if k == 0 else -closing
        return out


def _axes(k: int) -> Array:
    """Signs of fingertip k's axes in the hand's axes."""
    return FACING if k else np.ones(3)


def _cross(arm: Array) -> Array:
    """Matrix of the cross product with a vector from the left."""
    x, y, z = arm
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
