"""Pictures of single poses with their ground truth, outside any run."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError, located
from ...model import (
    ContactObject,
    DomeState,
    ForceField,
    State,
    contact_forces,
    equilibrium,
    refuse_flattening,
    rest_state,
    whole_friction,
)
from ...model.chain import state_of
from ...render import Frame, GroundTruth, SensorDesign
from ...scene.scene import Scene
from .dome_poses import DomePose, settle_dome

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Pose:
    """Forces on a dome, or displacements of a pad.

    A dome is in balance under the forces. The node model does not describe a pad, which is
    displaced instead.

    Attributes
    ----------
    grip, load: forces along z and x [N], of a dome
    depth, shear: displacements of the middle of a pad along −z and x [m]
    """

    grip: float = 0.0
    load: float = 0.0
    depth: float = 0.0
    shear: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Settled:
    """A pose and the contact that it leaves.

    Attributes
    ----------
    pose: forces or displacements
    state: of the chain, or of the dome of silicone
    field: contact forces; None for a pad
    friction: µ of the contact as a whole, see `whole_friction`
    """

    pose: Pose | DomePose
    state: State | DomeState
    field: ForceField | None
    friction: float


@dataclass(frozen=True, kw_only=True)
class Shot:
    """One picture and its ground truth.

    Attributes
    ----------
    settled: pose and contact
    frame: image as the camera gives it
    truth: of that image
    rest_depth: depth of the truth at rest [m], shape (H, W)
    seen: node displacements relative to the rigid part [m], shape (N, 2), of a dome (N, 3)
    traction: of the object on the skin where the image shows it [Pa], (H, W, 3); None of a chain
    """

    settled: Settled
    frame: Frame
    truth: GroundTruth
    rest_depth: NDArray[np.float32]
    seen: Array
    traction: NDArray[np.float32] | None = None


def settle_any(scene: Scene, pose: Pose | DomePose) -> Settled:
    """Contact of a pose of a scene's fingertip, whatever its body, and object.

    Raises
    ------
    UserError: for what cannot be held
    """
    if isinstance(pose, DomePose):
        state, contact = settle_dome(scene, pose)
        return Settled(pose=pose, state=state, field=contact, friction=scene.object.friction)
    rest, field = settle(scene, pose)
    friction = np.nan
    if field is not None:
        friction = whole_friction(scene.build_fingertip(), scene.build_object(), rest, field)
    return Settled(pose=pose, state=rest, field=field, friction=float(friction))


def settle(scene: Scene, pose: Pose) -> tuple[State, ForceField | None]:
    """State of a pose of a scene's fingertip and object, and its contact forces.

    Raises
    ------
    UserError
        When the object cannot be held with these forces.
    """
    sensor = scene.build_sensor()
    if sensor.shape.flat:
        if pose.grip or pose.load:
            raise UserError(
                f"sensor {scene.sensor} is a flat pad, which the node model does not describe: "
                "give --press-mm and --shear-mm instead of --grip and --load"
            )
        return _displaced(scene, sensor, pose), None
    if pose.depth or pose.shear:
        raise UserError(
            f"sensor {scene.sensor} is a dome: give --grip and --load instead of --press-mm and "
            "--shear-mm"
        )
    tip, obj = scene.build_fingertip(), scene.build_object()
    if not pose.grip > 0.0:
        if pose.load:
            raise UserError(f"a load of {pose.load:g} N needs a grip above 0 N to hold it")
        state = rest_state(tip)
    else:
        refuse_flattening(tip, obj, pose.grip)
        _refuse_sliding(obj, pose)
        with located(f"grip {pose.grip:g} N with load {pose.load:g} N cannot be held"):
            state = equilibrium(tip, obj, pose.grip, pose.load)
    return state, contact_forces(tip, obj, state)


def _refuse_sliding(obj: ContactObject, pose: Pose) -> None:
    """Refuse a load that a flat object with one µ everywhere does not hold."""
    held = obj.friction * pose.grip
    flat = obj.curvature == 0.0 and obj.profile is None and not obj.patches
    if flat and abs(pose.load) >= held:
        raise UserError(
            f"grip {pose.grip:g} N cannot hold a load of {pose.load:g} N: a friction of "
            f"{obj.friction:g} holds less than {held:.3g} N"
        )


def _displaced(scene: Scene, sensor: SensorDesign, pose: Pose) -> State:
    """State of a pad that a round or flat object is pushed into and pulled along.

    The skin follows the object where they touch. Within a millimetre of the pad's edge the
    displacement falls to 0. These are kinematics without forces.
    """
    nodes = scene.fingertip.nodes
    half = sensor.shape.radius
    if max(pose.depth, abs(pose.shear)) > half:
        raise UserError(
            f"depth {1e3 * pose.depth:g} mm and shear {1e3 * pose.shear:g} mm must be at most "
            f"{1e3 * half:g} mm, the radius of the pad"
        )
    x = np.linspace(-half, half, nodes)
    obj = scene.object
    gap = 0.5e3 * x**2 / obj.radius_mm
    depth = np.maximum(pose.depth - gap, 0.0)
    held = np.clip((half - abs(x)) / 1e-3, 0.0, 1.0)
    share = depth / pose.depth if pose.depth > 0.0 else np.ones(nodes)
    moved = np.column_stack([pose.shear * share, -depth]) * held[:, None]
    return state_of(
        0.0, moved, np.zeros(2), np.zeros(nodes), np.zeros(nodes), np.zeros((nodes + 1, 2)), 0.0
    )
