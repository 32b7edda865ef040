"""Pictures of single poses with their ground truth, without a run; poses of the node model."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

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
from ...render import Frame, GroundTruth, SensorDesign, TruthMap
from ...scene.scene import Scene

Array = NDArray[np.float64]


#: Arrays of every truth file, in order, with their meaning; layer 0 is magenta, 1 yellow.
OF_EACH = {
    "pixels_px": "projected centre (x, y) of each marker, (2, M, 2)",
    "image_centres_px": "centroid (x, y) of each marker's outline in the image, (2, M, 2)",
    "areas_px2": "area of each outline, (2, M)",
    "visible": "marker is there, faces the camera and lies in the image, (2, M)",
    "overlap": "share of each magenta marker's image that yellow covers, (M,)",
    "centres_m": "marker centres (x, y, z) in the sensor frame, (2, M, 3)",
    "normals": "of the markers, outwards, (2, M, 3)",
    "masks": "share of each pixel that a layer covers, 255 is all, (2, H, W)",
    "flow_px": "motion (x, y) of what a resting pixel shows of a layer, NaN off it, (2, H, W, 2)",
    "depth_m": "distance from the camera to the skin along each pixel's ray, NaN off it, (H, W)",
}
#: Arrays of a truth file of a chain or of displacements, in order.
ARRAYS = OF_EACH | {
    "seen_m": "node displacements (x, z) relative to the camera, (N, 2)",
    "force_position_m": "place (x, z) of each node's contact force, (N, 2); forces of a dome only",
    "force_normal_n": "normal force on each node, (N,)",
    "force_friction_n": "friction on each node, along the object's tangent, (N,)",
    "force_contact": "node is in contact, (N,)",
}


#: One picture of `poses.json`: names of its files, and forces or displacements.
Entry = dict[str, str | float | list[float] | None]


class AnyPose(Protocol):
    """A pose of a body, with the contents of its files.

    Attributes
    ----------
    arrays: names of the arrays in its truth file, in order, with their meaning
    """

    arrays: ClassVar[dict[str, str]]

    def settled(self, scene: Scene) -> "Settled":
        """Settle a scene's fingertip and object in the pose.

        Raises
        ------
        UserError
            For a pose that cannot be held.
        """

    def words(self, settled: "Settled") -> str:
        """Describe the pose in words."""

    def object_name(self, scene: Scene) -> str:
        """Name of the object; empty if it has no name."""

    def entry(self, settled: "Settled") -> Entry:
        """Pose for `poses.json`."""

    def sums(self, scene: Scene, shot: "Shot") -> Entry:
        """Forces of the contact for `poses.json`."""

    def seen(
        self, scene: Scene, settled: "Settled", truth: TruthMap, drive: Array
    ) -> tuple[Array, NDArray[np.float32] | None]:
        """Displacements and traction of a `Shot`."""

    def further(self, scene: Scene, shot: "Shot") -> Sequence[Any]:
        """Arrays of the truth file after those of `OF_EACH`."""


@dataclass(frozen=True, kw_only=True)
class Settled:
    """A pose and the resulting contact.

    Attributes
    ----------
    pose: forces or displacements
    state: state of the chain or the silicone
    field: contact forces; None for a pad of the node model
    friction: µ of the contact as a whole, see `whole_friction`
    """

    pose: "AnyPose"
    state: State | DomeState
    field: ForceField | None
    friction: float


@dataclass(frozen=True, kw_only=True)
class Shot:
    """One picture and its ground truth.

    Attributes
    ----------
    settled: pose and contact
    frame: image of the camera
    truth: ground truth of that image
    rest_depth: depth of the skin at rest [m], shape (H, W)
    seen: node displacements relative to the rigid part [m], shape (N, 2), for silicone (N, 3)
    traction: traction of the object on the skin at each pixel [Pa], (H, W, 3); None for a chain
    """

    settled: Settled
    frame: Frame
    truth: GroundTruth
    rest_depth: NDArray[np.float32]
    seen: Array
    traction: NDArray[np.float32] | None = None


@dataclass(frozen=True, kw_only=True)
class Pose:
    """Forces on a dome, or displacements of a pad.

    A dome is in balance under the forces. The node model does not describe a pad, which is
    displaced instead.

    Attributes
    ----------
    grip, load: forces on a dome along z and x [N]
    depth, shear: displacements of the middle of a pad along −z and x [m]
    """

    grip: float = 0.0
    load: float = 0.0
    depth: float = 0.0
    shear: float = 0.0

    arrays: ClassVar[dict[str, str]] = ARRAYS

    def settled(self, scene: Scene) -> Settled:
        """Settle the chain in the pose, or displace the pad."""
        state, field = settle(scene, self)
        friction = np.nan
        if field is not None:
            friction = whole_friction(scene.build_fingertip(), scene.build_object(), state, field)
        return Settled(pose=self, state=state, field=field, friction=float(friction))

    def words(self, settled: Settled) -> str:
        """Describe the pose in words."""
        if settled.field is None:
            return f"pressed {self.depth * 1e3:g} mm, sheared {self.shear * 1e3:g} mm"
        return f"grip {self.grip:g} N, load {self.load:g} N"

    def object_name(self, scene: Scene) -> str:
        """Return "": objects of the node model have no names."""
        return ""

    def entry(self, settled: Settled) -> Entry:
        """Forces, or displacements of a pad, for `poses.json`."""
        if settled.field is None:
            return {"press_mm": self.depth * 1e3, "shear_mm": self.shear * 1e3}
        return {"grip_n": self.grip, "load_n": self.load}

    def sums(self, scene: Scene, shot: Shot) -> Entry:
        """Sums of the forces for `poses.json`; empty for a pad."""
        field = shot.settled.field
        return {} if field is None else sums_of(field, shot.settled.friction)

    def seen(
        self, scene: Scene, settled: Settled, truth: TruthMap, drive: Array
    ) -> tuple[Array, None]:
        """The displacements that drive the picture."""
        return drive, None

    def further(self, scene: Scene, shot: Shot) -> Sequence[Any]:
        """Arrays of displacements, and of forces if they are known."""
        field = shot.settled.field
        if field is None:
            return [shot.seen]
        return [shot.seen, field.position, field.normal, field.friction, field.contact]


def sums_of(field: ForceField, friction: float, digits: int | None = None) -> Entry:
    """Sums of contact forces, µ and Γ, rounded to `digits` decimals."""
    margin = field.safety_margin(friction)
    return {
        "normal_n": rounded(field.total_normal, digits),
        "friction_n": rounded(field.total_friction, digits),
        "mu": friction if np.isfinite(friction) else None,
        "margin": rounded(margin, digits) if np.isfinite(margin) else None,
    }


def rounded(value: float, digits: int | None) -> float:
    """Round to `digits` decimals, without a negative zero."""
    return value if digits is None else round(value, digits) + 0.0


def settle(scene: Scene, pose: Pose) -> tuple[State, ForceField | None]:
    """Settle a pose of a scene's fingertip and object; returns state and contact forces.

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
    largest = obj.friction * pose.grip
    flat = obj.curvature == 0.0 and obj.profile is None and not obj.patches
    if flat and abs(pose.load) >= largest:
        raise UserError(
            f"grip {pose.grip:g} N cannot hold a load of {pose.load:g} N: a friction of "
            f"{obj.friction:g} holds less than {largest:.3g} N"
        )


def _displaced(scene: Scene, sensor: SensorDesign, pose: Pose) -> State:
    """State of a pad into which a round or flat object is pushed, and along which it is pulled.

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
    inner = np.clip((half - abs(x)) / 1e-3, 0.0, 1.0)
    share = depth / pose.depth if pose.depth > 0.0 else np.ones(nodes)
    moved = np.column_stack([pose.shear * share, -depth]) * inner[:, None]
    return state_of(
        0.0, moved, np.zeros(2), np.zeros(nodes), np.zeros(nodes), np.zeros((nodes + 1, 2)), 0.0
    )
