"""An object pressed on a dome and moved, and the contact that it leaves."""

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from ...errors import UserError, located
from ...model import DomeState, ForceField, Motion, dome_forces
from ...model.dome import Stepper, resting, rise_beside
from ...scene.scene import Scene
from ...scene.shapes import build_pose

Array = NDArray[np.float64]

#: Longest step of a press or a shear [m] and of a twist [rad], and the least number of steps.
STEP, TURN, FEWEST = 20e-6, math.radians(0.5), 12
#: Under forces the object creeps: time to put them on, and to come to rest [s].
LOADING, RESTING, CREEP = 1.0, 1.0, 5e-3
#: Dampers of an object under forces [N·s/m, N·m·s], which are gone when it is at rest.
DRAG = (5.0, 5.0, 5.0, 1e-4, 1e-4, 1e-4)


#: Longest motion of an object along an axis [m], and about the dome's axis [rad].
_FAR, _TURNS = 1.0, 20.0 * math.pi


@dataclass(frozen=True, kw_only=True)
class DomePose:
    """Where an object goes on a dome: it is tilted and turned, then pressed, sheared and twisted.

    Attributes
    ----------
    press: depth along −z from the first touch [m]; under a force it is found
    shear: displacement along x and y [m]
    twist: turn about z after the press [rad]
    tilt: turns about x and y before the press [rad]
    azimuth: turn about z before the press [rad]
    force: on the object along x and y, and along −z, instead of press and shear [N]; None is none
    moment: about z, instead of the twist [N·m]; None is none
    """

    press: float = 0.0
    shear: tuple[float, float] = (0.0, 0.0)
    twist: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)
    azimuth: float = 0.0
    force: tuple[float, float, float] | None = None
    moment: float | None = None


def settle_dome(scene: Scene, pose: DomePose) -> tuple[DomeState, ForceField]:
    """State of a scene's dome under its object in a pose, and the contact forces.

    Raises
    ------
    UserError: for a press too deep, a contact that does not converge, a load that slides off
    """
    _refuse_far(pose)
    dome, solid = scene.build_dome(), scene.build_solid()
    motion, dt = _motion(scene, pose)
    with located(_said(pose)):
        start = resting(dome, solid, motion)
        stepper = Stepper(dome, solid, motion, start)
        for before, after in zip(motion.times[:-1], motion.times[1:], strict=True):
            count = max(1, math.ceil((after - before) / dt - 1e-9))
            for k in range(count):
                stepper.advance(before + (after - before) * (k + 1) / count)
        state = stepper.state()
        if pose.force is not None or pose.moment is not None:
            _check_rest(state, pose)
    return state, dome_forces(dome, state)


def _refuse_far(pose: DomePose) -> None:
    """Refuse a motion that would take for ever."""
    if max(abs(pose.press), *map(abs, pose.shear)) > _FAR or abs(pose.twist) > _TURNS:
        raise UserError(
            f"press and shear must be at most {1e3 * _FAR:g} mm, the twist at most "
            f"{math.degrees(_TURNS):g}°"
        )


def path_to(scene: Scene, pose: DomePose) -> Array:
    """Poses on the way to a pose: the first touch, the end of the press, and evenly on from there.

    Returns
    -------
    Shape (parts + 2, 6), as `Motion.poses` has them.
    """
    beginning = build_pose(scene.object)
    turned = (
        scipy.spatial.transform.Rotation.from_euler("z", pose.azimuth)
        * scipy.spatial.transform.Rotation.from_euler("xy", pose.tilt)
        * scipy.spatial.transform.Rotation.from_rotvec(beginning[3:])
    )
    beginning[2] += rise_beside(
        scene.build_dome(), scene.build_solid(), turned.as_matrix(), (beginning[0], beginning[1])
    )
    parts = max(FEWEST, math.ceil(abs(pose.twist) / math.radians(3.0)))
    share = np.arange(1, parts + 1) / parts
    pressed = np.concatenate([[0.0, 1.0], np.ones(parts)])
    moved = np.concatenate([[0.0, 0.0], share])
    poses = np.zeros((parts + 2, 6))
    poses[:, :3] = beginning[:3]
    poses[:, 2] -= pressed * pose.press
    poses[:, :2] += moved[:, None] * pose.shear
    for k, part in enumerate(moved):
        poses[k, 3:] = (
            scipy.spatial.transform.Rotation.from_euler("z", part * pose.twist) * turned
        ).as_rotvec()
    return poses


def _motion(scene: Scene, pose: DomePose) -> tuple[Motion, float]:
    """Path to a pose, and the longest step on it [s]."""
    poses = path_to(scene, pose)
    parts = len(poses) - 2
    if pose.force is None and pose.moment is None:
        steps = max(FEWEST, math.ceil(pose.press / STEP))
        further = max(
            parts, math.ceil(math.hypot(*pose.shear) / STEP), math.ceil(abs(pose.twist) / TURN)
        )
        times = np.concatenate(
            [[0.0, float(steps)], steps + further * np.arange(1, parts + 1) / parts]
        )
        return Motion(times=times, poses=poses), 1.0
    free, loads = [], np.zeros((4, 6))
    if pose.force is not None:
        free += ["x", "y", "z"]
        x, y, down = pose.force
        loads[1:, 2] = -down
        loads[2:, :2] = x, y
    if pose.moment is not None:
        free.append("rz")
        loads[2:, 5] = pose.moment
    times = np.array([0.0, LOADING, 2.0 * LOADING, 2.0 * LOADING + RESTING])
    path = np.stack([poses[0], poses[1], poses[-1], poses[-1]])
    return Motion(times=times, poses=path, free=tuple(free), loads=loads, drag=DRAG), CREEP


def _check_rest(state: DomeState, pose: DomePose) -> None:
    speed = state.velocity
    if np.abs(speed[:3]).max() > 1e-3 or np.abs(speed[3:]).max() > 0.1:
        raise UserError(
            f"the object is not held: it slides at {1e3 * np.abs(speed[:3]).max():.2g} mm/s and "
            f"turns at {np.degrees(np.abs(speed[3:]).max()):.2g} °/s; press more or pull less"
        )


def _said(pose: DomePose) -> str:
    if pose.force is not None:
        x, y, down = pose.force
        return f"a force of {x:g} N along x, {y:g} N along y and {down:g} N down"
    return f"a press of {1e3 * pose.press:g} mm"
