"""An object pressed on a dome and moved, and the resulting contact."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, cast

import numpy as np
import scipy
from numpy.typing import NDArray

from ...errors import UserError, located
from ...model import DomeState, ForceField, Motion, PiercedError, dome_forces, margin_within
from ...model.dome import Stepper, displacements, lattice, resting, rise_beside
from ...render import TruthMap
from ...scene.scene import Scene
from ...scene.shapes import build_pose
from .poses import OF_EACH, Entry, Settled, Shot, rounded, sums_of

Array = NDArray[np.float64]


#: Arrays of a truth file of a dome of silicone, in order.
DOME_ARRAYS = OF_EACH | {
    "seen_m": "displacement (x, y, z) of each node of the skin, (N, 3)",
    "force_position_m": "place (x, y, z) of each node of the pressed skin, (N, 3)",
    "force_normal_n": "normal force of the object on each node, (N,)",
    "force_friction_n": "friction on each node, (N, 3)",
    "force_contact": "node is in contact, (N,)",
    "force_direction": "unit normal of the object at each node in contact, 0 elsewhere, (N, 3)",
    "force_area_m2": "area of the skin that each node stands for, (N,)",
    "force_slips": "node is in contact and slips, (N,)",
    "object_place_m": "place of the object's own origin, (3,)",
    "object_rotation": "of the object's own axes to the sensor's, (3, 3)",
    "traction_pa": "force of the object per area of skin that each pixel shows, (H, W, 3)",
    "contact_mask": "pixel shows skin in contact, (H, W)",
}


@dataclass(frozen=True, kw_only=True)
class DomePose:
    """Pose of an object on a dome: it is tilted and turned, then pressed, sheared and twisted.

    Attributes
    ----------
    press: depth along −z from the first touch [m]; not used with a force
    shear: displacement along x and y [m]
    twist: turn about z after the press [rad]
    tilt: turns about x and y before the press [rad]
    azimuth: turn about z before the press [rad]
    force: force on the object along x, y and −z, instead of press and shear [N]; None: no force
    moment: torque about z, instead of the twist [N·m]; None: no torque
    """

    press: float = 0.0
    shear: tuple[float, float] = (0.0, 0.0)
    twist: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)
    azimuth: float = 0.0
    force: tuple[float, float, float] | None = None
    moment: float | None = None

    arrays: ClassVar[dict[str, str]] = DOME_ARRAYS

    def settled(self, scene: Scene) -> Settled:
        """Settle the dome or the pad in the pose."""
        state, contact = settle_dome(scene, self)
        return Settled(pose=self, state=state, field=contact, friction=scene.object.friction)

    def words(self, settled: Settled) -> str:
        """Describe the motion of the object in words."""
        if self.force is not None:
            parts = ["held with {:z.2g}, {:z.2g} and {:z.2g} N".format(*self.force)]
        else:
            parts = [f"pressed {1e3 * self.press:.3g} mm"]
            if any(self.shear):
                way = " and ".join(f"{1e3 * s:.3g}" for s in self.shear)
                parts.append(f"sheared {way} mm")
        if self.twist:
            parts.append(f"twisted {np.degrees(self.twist):.3g}°")
        return ", ".join(parts)

    def object_name(self, scene: Scene) -> str:
        """Name of the shape."""
        return scene.build_solid().shape.name

    def entry(self, settled: Settled) -> Entry:
        """Pose of the object for `poses.json`."""
        entry: Entry = {
            "tilt_deg": np.degrees(self.tilt).tolist(),
            "azimuth_deg": math.degrees(self.azimuth),
        }
        if self.force is None:
            entry |= {"press_mm": 1e3 * self.press, "shear_mm": [1e3 * s for s in self.shear]}
        else:
            entry["load_n"] = list(self.force)
        if self.moment is None:
            entry["twist_deg"] = math.degrees(self.twist)
        else:
            entry["moment_nmm"] = 1e3 * self.moment
        return entry

    def sums(self, scene: Scene, shot: Shot) -> Entry:
        """Sums of the forces, torques, and depth of the deepest point, for `poses.json`."""
        field, friction = _forces(shot), shot.settled.friction
        limit = margin_within(field, friction)
        torque = [1e3 * field.torque(axis) for axis in np.eye(3)]
        outwards = lattice(scene.build_dome()).outwards
        deepest = -1e3 * float(np.einsum("ij,ij->i", shot.seen, outwards).min())
        force_digits = 5  # decimals of forces [N]; further ones are errors of the solver
        torque_digits = 4  # decimals of torques [N·mm]
        return sums_of(field, friction, force_digits) | {
            "limit_margin": rounded(limit, force_digits) if np.isfinite(limit) else None,
            "force_n": [rounded(force, force_digits) for force in field.total_force.tolist()],
            "torque_nmm": [rounded(part, torque_digits) for part in torque],
            "deepest_mm": rounded(deepest, 4),
        }

    def seen(
        self, scene: Scene, settled: Settled, truth: TruthMap, drive: Array
    ) -> tuple[Array, NDArray[np.float32] | None]:
        """Displacements of the nodes [m], and the traction at each pixel [Pa]."""
        dome, state = scene.build_dome(), cast("DomeState", settled.state)
        traction = truth.skin_image(drive, state.forces / lattice(dome).areas[:, None])
        return displacements(dome, state), traction

    def further(self, scene: Scene, shot: Shot) -> Sequence[Any]:
        """Arrays of displacements, forces, and the object's place."""
        field, state = _forces(shot), cast("DomeState", shot.settled.state)
        assert shot.traction is not None
        slipping = 0.999  # share of the friction limit above which a node slips
        slips = field.friction_sizes > slipping * shot.settled.friction * field.normal
        pixels = np.nan_to_num(abs(shot.traction)).max(axis=-1)
        return [
            shot.seen, field.position, field.normal, field.friction, field.contact,
            field.directions, lattice(scene.build_dome()).areas, slips & field.contact, state.place,
            state.rotation, shot.traction, pixels > 0.0,
        ]  # fmt: skip


def _forces(shot: Shot) -> ForceField:
    """Contact forces, which every pose of a dome has."""
    assert shot.settled.field is not None
    return shot.settled.field


def settle_dome(scene: Scene, pose: DomePose) -> tuple[DomeState, ForceField]:
    """Settle a scene's dome under its object in a pose; returns state and contact forces.

    Raises
    ------
    UserError
        For a press that is too deep, a contact that does not converge, and a load under which the
        object slides.
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
                time = before + (after - before) * (k + 1) / count
                try:
                    stepper.advance(time)
                except PiercedError as error:
                    raise _too_deep(pose, time / motion.times[1], dome.thickness) or error from None
        state = stepper.state()
        if pose.force is not None or pose.moment is not None:
            _check_rest(state, pose)
    return state, dome_forces(dome, state)


def _refuse_far(pose: DomePose) -> None:
    """Refuse a motion that would take too long to compute."""
    far_m = 1.0  # longest motion of an object along an axis [m]
    most_turned = 20.0 * math.pi  # longest turn about the dome's axis [rad]
    if max(abs(pose.press), *map(abs, pose.shear)) > far_m or abs(pose.twist) > most_turned:
        raise UserError(
            f"press and shear must be at most {1e3 * far_m:g} mm, the twist at most "
            f"{math.degrees(most_turned):g}°"
        )


def path_to(scene: Scene, pose: DomePose) -> Array:
    """Poses on the way to a pose: the first touch, the end of the press, and even steps from there.

    Returns
    -------
    poses as in `Motion.poses` [m, rad], shape (parts + 2, 6)
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
    parts = max(12, math.ceil(abs(pose.twist) / math.radians(3.0)))
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
    # Longest step of a press or a shear [m] and of a twist [rad].
    step, turn = 20e-6, math.radians(0.5)
    if pose.force is None and pose.moment is None:
        steps = max(12, math.ceil(pose.press / step))
        further = max(
            parts, math.ceil(math.hypot(*pose.shear) / step), math.ceil(abs(pose.twist) / turn)
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
    # Under forces the object creeps: times to apply them and to come to rest [s].
    loading_s, resting_s = 1.0, 1.0
    times = np.array([0.0, loading_s, 2.0 * loading_s, 2.0 * loading_s + resting_s])
    path = np.stack([poses[0], poses[1], poses[-1], poses[-1]])
    # Dampers of an object under forces [N·s/m, N·m·s]; they have no effect at rest.
    drag = (5.0, 5.0, 5.0, 1e-4, 1e-4, 1e-4)
    return Motion(times=times, poses=path, free=tuple(free), loads=loads, drag=drag), 5e-3


def _check_rest(state: DomeState, pose: DomePose) -> None:
    speed = state.velocity
    if np.abs(speed[:3]).max() > 1e-3 or np.abs(speed[3:]).max() > 0.1:
        raise UserError(
            f"the object is not held: it slides at {1e3 * np.abs(speed[:3]).max():.2g} mm/s and "
            f"turns at {np.degrees(np.abs(speed[3:]).max()):.2g} °/s; press more or pull less"
        )


def _too_deep(pose: DomePose, share: float, thickness: float) -> UserError | None:
    """Refusal of a press that goes too deep at a share of its way; None for one after it.

    Parameters
    ----------
    thickness: of the silicone [m]
    """
    if share > 1.0:
        return None
    least = f"{1e3 * share * pose.press:.3g} mm"
    if pose.force is not None:
        least = f"{share * pose.force[2]:.3g} N down"
    return UserError(
        f"expected less than {least}, which presses the object to the depth in the silicone of "
        f"{1e3 * thickness:.3g} mm up to which it is described"
    )


def _said(pose: DomePose) -> str:
    if pose.force is not None:
        x, y, down = pose.force
        return f"a force of {x:g} N along x, {y:g} N along y and {down:g} N down"
    return f"a press of {1e3 * pose.press:g} mm"
