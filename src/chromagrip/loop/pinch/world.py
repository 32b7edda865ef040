"""The model's side of a pinch: two domes, an object with a weight, drive and hand."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import located
from ...model import DomeState, Solid, dome_forces
from ...model.dome import follow_dome_slip, no_dome_slip
from ...model.pinch import (
    Pinch,
    PinchRecord,
    PinchState,
    PinchStepper,
    follow_pinch,
    pinch_rest,
)
from ...scene.fingers import build_pinch
from ...scene.scene import Scene
from ...sensing.contact import Contact, dome_contact, of_dome
from ..dome_world import changed_solid, solid_at
from ..world import Clock, World, drive_forces

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Pinched:
    """Both fingertips and the object at one instant.

    Attributes
    ----------
    solid: object with its friction and stiffness at that instant
    state: state of the pinch
    fingers: contact of each fingertip, in its own frame
    record: record of the pinch so far
    """

    solid: Solid
    state: PinchState
    fingers: tuple[Contact, Contact]
    record: PinchRecord


class PinchPlant:
    """Two domes under a scene's drive, and a hand on its path; a `Plant` of the loop.

    Parameters
    ----------
    scene: scene of two fingers
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

    def rest(self) -> World[Pinched]:
        """World before the grip begins."""
        start, record = self._start, PinchRecord()
        fingers = self._fingers(self._solid, start, None)
        now = Pinched(solid=self._solid, state=start, fingers=fingers, record=record)
        return World(now=now, exposed=now, applied=0.0, forces=np.full(2, math.inf))

    def next_frame(self, world: World[Pinched], command: float, index: int) -> World[Pinched]:
        """World at the frame after frame `index`, under a commanded force [N].

        Raises
        ------
        UserError
            When the model fails.
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
        return World(
            now=now,
            exposed=exposed if clock.exposure else now,
            applied=applied,
            forces=forces[-1],
            over=now.record.dropped,
        )

    def changed(self, world: World[Pinched], scene: Scene) -> World[Pinched]:
        """World with the µ and the stiffness of another scene, see `Plant`."""
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
        fingers = self._fingers(solid, state, last)
        fields = fingers[0].field, fingers[1].field
        record = follow_pinch(last.record, self.pinch, state, fields, self.limits)
        return Pinched(solid=solid, state=state, fingers=fingers, record=record)

    def _fingers(
        self, solid: Solid, state: PinchState, last: Pinched | None
    ) -> tuple[Contact, Contact]:
        """Contact of each finger in a state; `last` is the pinch before, None at the start."""
        domes, starts = (self.pinch.first, self.pinch.second), _skins(self._start)
        contacts = []
        for k, after in enumerate(_skins(state)):
            field = dome_forces(domes[k], after, whole=False)
            slip = no_dome_slip(domes[k])
            if last is not None:
                _, before, slip = of_dome(last.fingers[k])
                slip = follow_dome_slip(slip, domes[k], before, after, field)
            contacts.append(dome_contact(domes[k], solid, starts[k], after, slip, field))
        return contacts[0], contacts[1]


def _skins(state: PinchState) -> tuple[DomeState, DomeState]:
    return state.first, state.second
