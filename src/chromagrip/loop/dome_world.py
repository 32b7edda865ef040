"""The dome's side of the loop: silicone, object and drive between two frames."""

import math
from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from ..errors import UserError, located
from ..model import Motion, SoftBody, Solid, dome_forces
from ..model.dome import Stepper, no_dome_slip, resting, rise_beside
from ..scene.scene import Scene
from ..scene.settings import ObjectSettings
from ..scene.shapes import build_pose
from ..sensing.contact import Contact, dome_contact, follow_dome, of_dome
from .world import Clock, World, calm, drive_forces

Array = NDArray[np.float64]

#: Damper between the gripper's drive and ground [N·s/m]: that of the whole chain, 252 × 0.1.
PRESS_DRAG = 25.2


class DomePlant:
    """A dome under a scene's drive and load; a `Plant`.

    The grip presses the object along −z, the load pulls it along x. If the scene has them, a
    second load pulls along y and a torque turns it about z. Its other axes are fixed.

    Parameters
    ----------
    scene: scene with dome, object, load, drive and clock
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.dome: SoftBody = scene.build_dome()
        self.clock = Clock.of_scene(scene)
        self._solid = scene.build_solid()
        self._motion = self._guided()
        with located("the dome gave up"):
            start = resting(self.dome, self._solid, self._motion)
        self._stepper = Stepper(self.dome, self._solid, self._motion, start)
        self._start = start

    def rest(self) -> World[Contact]:
        """World before the grip begins."""
        self._stepper.restore(self._start)
        field = dome_forces(self.dome, self._start, whole=False)
        now = dome_contact(
            self.dome, self._solid, self._start, self._start, no_dome_slip(self.dome), field
        )
        return World(now=now, exposed=now, applied=0.0, forces=np.full(2, math.inf))

    def next_frame(self, world: World[Contact], command: float, index: int) -> World[Contact]:
        """World at the frame after frame `index`, see `Plant`."""
        clock = self.clock
        times = index * clock.frame + (np.arange(clock.steps) + 0.5) * clock.step
        applied, forces = drive_forces(self.scene, clock, world.applied, command, times.tolist())
        ends = times + 0.5 * clock.step
        state = of_dome(world.now)[1]
        self._stepper.restore(state)
        slow = calm(self.scene, world, forces, abs(state.velocity[:3]).max())
        if slow and not clock.exposure and not self.scene.object.changes:
            ends, times, forces = ends[-1:], times[-1:], forces[-1:]
        contact = exposed = world.now
        for k in range(len(ends)):
            if len(ends) - k == clock.exposure:
                exposed = contact
            contact = self._step(contact, times[k], ends[k], forces[k])
        # Sums of steps round; frames are counted.
        time = (index + 1) * clock.frame
        now = replace(contact, state=replace(of_dome(contact)[1], time=time))
        return World(
            now=now,
            exposed=exposed if clock.exposure else now,
            applied=applied,
            forces=forces[-1],
        )

    def changed(self, world: World[Contact], scene: Scene) -> World[Contact]:
        """World with the load and object of another scene, see `Plant`."""
        for axis, key in (("y", "sideways_n"), ("rz", "twists_nmm")):
            if any(getattr(scene.load, key)) and axis not in self._motion.free:
                raise UserError(
                    f"the object cannot move along {axis}; to change load.{key} during a grasp, "
                    "start it with such a load"
                )
        self._solid = changed_solid(self._solid, self.scene.object, scene.object)
        self.scene = scene
        return world

    def _guided(self) -> Motion:
        """Motion of the object: free along x and z, and along y and about z if it is loaded so."""
        load, drag = self.scene.load, self.scene.object.drag_n_s_per_m
        free = ["x", "z"]
        if any(load.sideways_n):
            free.append("y")
        if any(load.twists_nmm):
            free.append("rz")
        # Damping of a turn: that of a slide, at the largest radius of a contact.
        turning = drag * (0.5 * self.dome.radius) ** 2
        pose = build_pose(self.scene.object)
        turn = scipy.spatial.transform.Rotation.from_rotvec(pose[3:]).as_matrix()
        pose[2] += rise_beside(self.dome, self._solid, turn, (pose[0], pose[1]))
        return Motion(
            times=np.array([0.0, max(self.scene.duration_s, self.clock.frame)]),
            poses=np.stack([pose, pose]),
            free=tuple(free),
            drag=(drag, drag, PRESS_DRAG, 0.0, 0.0, turning),
        )

    def _step(self, contact: Contact, time: float, end: float, forces: Array) -> Contact:
        """Contact after a step from the stepper's state, under grip and load [N]."""
        solid = solid_at(self.scene, self._solid, time)
        if solid is not self._stepper.solid:
            self._stepper.touch(solid)
        load = self.scene.load
        grip, pull = forces
        wrench = np.array([pull, load.sideways(time), -grip, 0.0, 0.0, load.twist(time)])
        with located("the dome gave up"):
            return follow_dome(self._stepper, contact, self._start, end, wrench)


def changed_solid(solid: Solid, before: ObjectSettings, now: ObjectSettings) -> Solid:
    """Give a scene's object the friction and stiffness of another one."""
    stiffness = solid.stiffness * now.stiffness_kpa / before.stiffness_kpa
    return replace(solid, stiffness=stiffness, friction=now.friction)


def solid_at(scene: Scene, solid: Solid, time: float) -> Solid:
    """A scene's object at a time [s]; the same object if its settings do not change."""
    settings = scene.object
    if not settings.changes:
        return solid
    return replace(
        solid,
        stiffness=solid.stiffness * settings.stiffness_kpa_at(time) / settings.stiffness_kpa,
        friction=settings.friction_at(time),
    )
