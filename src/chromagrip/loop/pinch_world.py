"""The model's side of a pinch: two domes, an object with a weight, drive and hand."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import located
from ..model import DomeState, ForceField, Solid, dome_forces
from ..model.dome import DomeSlip, follow_dome_slip, no_dome_slip
from ..model.pinch import (
    Pinch,
    PinchRecord,
    PinchState,
    PinchStepper,
    follow_pinch,
    pinch_rest,
)
from ..scene.fingers import build_pinch
from ..scene.scene import Scene
from ..sensing.contact import Contact, dome_contact
from .dome_world import changed_solid, solid_at
from .world import Clock, World, drive_forces

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Pinched:
    """Both fingertips and the object at one instant.

    Attributes
    ----------
    solid: the object as it is then
    state: of the pinch
    fingers: contact of each fingertip, in its own frame
    record: of the pinch so far
    """

    solid: Solid
    state: PinchState
    fingers: tuple[Contact, Contact]
    record: PinchRecord


@dataclass(frozen=True, kw_only=True)
class PinchWorld:
    """True pinch at a frame.

    Attributes
    ----------
    now: at the frame's instant
    exposed: at the middle of the frame's exposure
    applied: force of the gripper's drive [N]
    """

    now: Pinched
    exposed: Pinched
    applied: float

    def finger(self, k: int) -> World:
        """World of one finger, as a single one's camera and observer see it."""
        return World(
            now=self.now.fingers[k],
            exposed=self.exposed.fingers[k],
            applied=self.applied,
            forces=np.array([self.applied, 0.0]),
        )


class PinchPlant:
    """Two domes under a scene's drive, and a hand on its path; as a `Plant` of the loop.

    Parameters
    ----------
    scene: with a pinch
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.clock = Clock.of_scene(scene)
        self.limits = scene.pinch.limits
        with located("the pinch gave up"):
            self.pinch: Pinch = build_pinch(scene)
            self._start = pinch_rest(self.pinch)
        self._solid = self.pinch.solid
        self._stepper = PinchStepper(self.pinch, self._start)

    def rest(self) -> PinchWorld:
        """World before the grip begins."""
        solid, start = self._solid, self._start
        slips = (no_dome_slip(self.pinch.first), no_dome_slip(self.pinch.second))
        fingers = self._fingers(solid, start, slips, self._fields(start))
        now = Pinched(solid=solid, state=start, fingers=fingers, record=PinchRecord())
        return PinchWorld(now=now, exposed=now, applied=0.0)

    def next_frame(self, world: PinchWorld, command: float, index: int) -> PinchWorld:
        """World at the frame after frame `index`, under a commanded force [N].

        Raises
        ------
        UserError
            When the silicone cannot go on.
        """
        clock = self.clock
        times = index * clock.frame + (np.arange(clock.steps) + 0.5) * clock.step
        applied, forces = drive_forces(self.scene, clock, world.applied, command, times.tolist())
        ends = times + 0.5 * clock.step
        # Sums of steps round; frames are counted.
        ends[-1] = (index + 1) * clock.frame
        self._stepper.restore(world.now.state)
        now = exposed = world.now
        for k, (time, end) in enumerate(zip(times, ends, strict=True)):
            if len(ends) - k == clock.exposure:
                exposed = now
            now = self._step(now, float(time), float(end), float(forces[k, 0]))
        return PinchWorld(now=now, exposed=exposed if clock.exposure else now, applied=applied)

    def changed(self, world: PinchWorld, scene: Scene) -> PinchWorld:
        """World from which to go on with the µ and the stiffness of another scene."""
        self._solid = changed_solid(self._solid, self.scene.object, scene.object)
        self.scene = scene
        return world

    def _step(self, last: Pinched, time: float, end: float, grip: float) -> Pinched:
        """Pinch after a step from the stepper's state, under a grip [N]."""
        solid = solid_at(self.scene, self._solid, time)
        if solid is not self._stepper.skins[0].solid:
            self._stepper.touch(solid)
        with located("the pinch gave up"):
            self._stepper.advance(end, grip)
        state = self._stepper.state()
        fields = self._fields(state)
        domes = (self.pinch.first, self.pinch.second)
        slips = []
        for k, after in enumerate((state.first, state.second)):
            slip = last.fingers[k].slip
            assert isinstance(slip, DomeSlip)
            slips.append(follow_dome_slip(slip, domes[k], _state(last, k), after, fields[k]))
        return Pinched(
            solid=solid,
            state=state,
            fingers=self._fingers(solid, state, (slips[0], slips[1]), fields),
            record=follow_pinch(last.record, self.pinch, state, fields, self.limits),
        )

    def _fields(self, state: PinchState) -> tuple[ForceField, ForceField]:
        return (
            dome_forces(self.pinch.first, state.first, whole=False),
            dome_forces(self.pinch.second, state.second, whole=False),
        )

    def _fingers(
        self,
        solid: Solid,
        state: PinchState,
        slips: tuple[DomeSlip, DomeSlip],
        fields: tuple[ForceField, ForceField],
    ) -> tuple[Contact, Contact]:
        start = self._start
        return (
            dome_contact(self.pinch.first, solid, start.first, state.first, slips[0], fields[0]),
            dome_contact(self.pinch.second, solid, start.second, state.second, slips[1], fields[1]),
        )


def _state(pinched: Pinched, k: int) -> DomeState:
    return pinched.state.second if k else pinched.state.first
