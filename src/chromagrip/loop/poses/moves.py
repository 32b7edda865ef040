"""An object that moves to a pose on a dome in real time, observed once a frame."""

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from ...errors import located
from ...model import Motion, dome_forces
from ...model.dome import Stepper, no_dome_slip, resting
from ...scene.scene import Scene
from ...sensing.contact import Contact, dome_contact, follow_dome
from .dome_poses import DomePose, path_to

Array = NDArray[np.float64]


def moves(scene: Scene, pose: DomePose) -> Iterator[Contact]:
    """Yield the contact at every frame of a scene whose object is pressed, sheared and twisted.

    The object starts at its first touch of the dome, is pressed in the first 0.4 of the scene's
    duration, and reaches the pose at its end. Only the nodes near the object move, see
    `dome_forces`.

    Raises
    ------
    UserError
        For a press that is too deep, and for a contact that does not converge.
    """
    dome, solid = scene.build_dome(), scene.build_solid()
    motion = _timed(path_to(scene, pose), (scene.frames - 1) * scene.period)
    with located(f"a press of {1e3 * pose.press:.3g} mm"):
        start = resting(dome, solid, motion)
        stepper = Stepper(dome, solid, motion, start)
        field = dome_forces(dome, start, whole=False)
        contact = dome_contact(dome, solid, start, start, no_dome_slip(dome), field)
        yield contact
        for index in range(1, scene.frames):
            for end in _ends(motion, stepper.time, index * scene.period):
                contact = follow_dome(stepper, contact, start, end)
            yield contact


def _timed(poses: Array, duration: float) -> Motion:
    """Motion along poses; the second one is reached at the end of the press."""
    # Share of a scene's duration in which the object is pressed; then it is moved.
    pressing_share = 0.4
    share = np.linspace(pressing_share, 1.0, len(poses) - 1)
    return Motion(times=duration * np.concatenate([[0.0], share]), poses=poses)


def _ends(motion: Motion, start: float, end: float) -> list[float]:
    """Ends of the steps between two frames [s]; the end of the press is one of them."""
    corner = float(motion.times[1])
    parts = [start, corner, end] if start + 1e-9 < corner < end - 1e-9 else [start, end]
    ends: list[float] = []
    # Longest step of the silicone: motion [m] and turn [rad] of the object.
    step, turn = 50e-6, math.radians(1.5)
    for first, last in pairwise(parts):
        before, after = motion.pose_at(first), motion.pose_at(last)
        way = float(np.linalg.norm(after[:3] - before[:3]))
        turns = (
            scipy.spatial.transform.Rotation.from_rotvec(after[3:])
            * scipy.spatial.transform.Rotation.from_rotvec(before[3:]).inv()
        )
        count = max(1, math.ceil(way / step - 1e-6), math.ceil(turns.magnitude() / turn - 1e-6))
        ends += [first + (last - first) * (k + 1) / count for k in range(count)]
    return ends
