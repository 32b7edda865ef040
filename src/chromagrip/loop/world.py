"""The model's side of the loop: a chain, object and drive between two frames.

A *step* is a time step of the node model. A *frame* is a whole number of steps. The middle of a
frame's *exposure* lies some steps before the frame.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..model import ContactObject, Fingertip, no_slip, rest_state
from ..scene.scene import Scene
from ..sensing.contact import Contact, chain_contact, follow_chain, of_chain

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Clock:
    """Steps, frames and exposures of a run.

    Attributes
    ----------
    frame: time from one frame to the next [s]
    steps: steps of the node model in that time
    exposure: steps from the middle of a frame's exposure to the frame
    """

    frame: float
    steps: int
    exposure: int

    @classmethod
    def of_scene(cls, scene: Scene) -> Self:
        """Clock of a scene; its steps are shortened so that a frame is a whole number of them."""
        count = max(1, math.ceil(scene.period * 1e3 / scene.fingertip.step_ms - 1e-9))
        step = scene.period / count
        exposure = round(0.5e-3 * scene.camera.exposure_ms / step)
        return cls(frame=scene.period, steps=count, exposure=exposure)

    @property
    def step(self) -> float:
        """Length of a step [s]."""
        return self.frame / self.steps


#: The contact of one finger, or both fingers and the object that they hold.
Held = TypeVar("Held")


@dataclass(frozen=True, kw_only=True)
class World(Generic[Held]):
    """True contact at a frame.

    Attributes
    ----------
    now: contact at the frame's instant; with two fingers both, and the object
    exposed: the same at the middle of the frame's exposure
    applied: force of the gripper's drive [N]
    forces: grip and load of the last step [N], shape (2,); infinite before the first one
    over: whether the grasp ends here, as the object was dropped
    """

    now: Held
    exposed: Held
    applied: float
    forces: Array
    over: bool = False


@dataclass(frozen=True, kw_only=True)
class Part:
    """Steps of equal length with one object.

    Attributes
    ----------
    obj: the object
    step: length of a step [s]
    forces: grip and load of each step [N], shape (S, 2)
    """

    obj: ContactObject
    step: float
    forces: Array


class Plant(Protocol[Held]):
    """A body under a scene's drive and load."""

    scene: Scene

    def rest(self) -> World[Held]:
        """World before the grip begins."""

    def next_frame(self, world: World[Held], command: float, index: int) -> World[Held]:
        """World at the frame after frame `index`, under a commanded force [N].

        Raises
        ------
        UserError
            When the model fails.
        """

    def changed(self, world: World[Held], scene: Scene) -> World[Held]:
        """World from which to go on with the load, the µ and the stiffness of another scene.

        Raises
        ------
        UserError
            For a load along an axis on which the object is fixed.
        """


def calm(scene: Scene, world: World[Contact], forces: Array, fastest: float) -> bool:
    """Return True if a frame period can be one step: motion and changes of force are small.

    An implicit step of any length follows slow motion. A change of force within it acts at its
    end.

    Parameters
    ----------
    scene: scene with the speed below which motion is slow
    world: world before the period
    forces: grip and load of the steps of the period [N], shape (S, 2)
    fastest: largest speed in the body now [m/s]
    """
    if fastest >= 1e-6 * scene.fingertip.calm_um_per_s:
        return False
    changes = np.ptp(np.vstack([world.forces, forces]), axis=0)
    calm_change = 0.01  # largest relative change of a force in a calm frame period
    return bool((changes <= calm_change * abs(forces[-1])).all())


def drive_forces(
    scene: Scene, clock: Clock, applied: float, command: float, times: list[float]
) -> tuple[float, Array]:
    """Force of the drive after steps, and grip and load of each step [N], shape (S, 2).

    Parameters
    ----------
    scene: scene with drive and load
    clock: clock of the scene
    applied: force of the drive before the steps [N]
    command: commanded force [N]
    times: middles of the steps [s]
    """
    actuator, load = scene.actuator, scene.load
    goal = actuator.rounded(command)
    forces = np.empty((len(times), 2))
    for k, time in enumerate(times):
        applied = actuator.follow(applied, goal, clock.step)
        forces[k] = applied, load.force(time)
    return applied, forces


class ChainPlant:
    """The node model under a scene's drive and load; a `Plant`.

    Parameters
    ----------
    scene: scene with object, load, drive and clock
    fingertip: chain that grips
    """

    def __init__(self, scene: Scene, fingertip: Fingertip) -> None:
        self.scene = scene
        self.fingertip = fingertip
        self.clock = Clock.of_scene(scene)

    def rest(self) -> World[Contact]:
        """World before the grip begins."""
        obj, state = self.scene.build_object(), rest_state(self.fingertip)
        now = chain_contact(self.fingertip, obj, state, no_slip(self.fingertip.nodes))
        return World(now=now, exposed=now, applied=0.0, forces=np.full(2, math.inf))

    def next_frame(self, world: World[Contact], command: float, index: int) -> World[Contact]:
        """World at the frame after frame `index`, see `Plant`."""
        times = index * self.clock.frame + (np.arange(self.clock.steps) + 0.5) * self.clock.step
        applied, forces = drive_forces(
            self.scene, self.clock, world.applied, command, times.tolist()
        )
        now, exposed = self._follow(world.now, self._parts(world, forces, times.tolist()))
        # Sums of steps round; frames are counted.
        state = replace(now.state, time=(index + 1) * self.clock.frame)
        return World(
            now=replace(now, state=state), exposed=exposed, applied=applied, forces=forces[-1]
        )

    def changed(self, world: World[Contact], scene: Scene) -> World[Contact]:
        """World with the load and object of another scene, see `Plant`."""
        self.scene = scene
        obj = scene.build_object(world.now.state.time)
        return replace(world, now=replace(world.now, obj=obj))

    def _parts(self, world: World[Contact], forces: Array, times: list[float]) -> Iterator[Part]:
        """Split the steps of a frame period into parts with one object each."""
        obj, state, _ = of_chain(world.now)
        if self.scene.object.changes:
            for k, time in enumerate(times):
                obj = self.scene.build_object(time)
                yield Part(obj=obj, step=self.clock.step, forces=forces[k : k + 1])
        elif self.clock.exposure == 0 and calm(self.scene, world, forces, abs(state.rate).max()):
            yield Part(obj=obj, step=self.clock.frame, forces=forces[-1:])
        else:
            yield Part(obj=obj, step=self.clock.step, forces=forces)

    def _follow(self, contact: Contact, parts: Iterator[Part]) -> tuple[Contact, Contact]:
        """Contact after the parts, and at the middle of the exposure."""
        todo = list(parts)
        until = sum(len(part.forces) for part in todo) - self.clock.exposure
        exposed = contact
        for part in todo:
            count = len(part.forces)
            midway = 0 < until < count
            kept = (count, until) if midway else (count,)
            after = follow_chain(self.fingertip, part.obj, contact, part.step, part.forces, kept)
            contact = after[0]
            if 0 < until <= count:
                exposed = after[-1]
            until -= count
        return contact, exposed
