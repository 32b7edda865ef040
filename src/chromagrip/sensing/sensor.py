"""A tactile sensor: an object's pose or a force in; picture, markers, wrench and truth out.

    sensor = chromagrip.TactileSensor("dome-2020", noise=2.0, seed=1)
    sensor.attach(Solid(shape=ball(10e-3), friction=0.5))
    sensor.update(Pose(place=(0.0, 0.0, 29e-3)), dt=1 / 60)
    sensor.data.image, sensor.data.wrench, sensor.data.margin

Its body is the node model's chain, or silicone as a dome or a pad. A picture is rendered when it
is first read.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..by_name import Choice
from ..compiled import announce
from ..errors import UserError, located
from ..model import REFERENCE_NODES, ContactObject, Fingertip, SoftBody, Solid, margin_within
from ..render import (
    Defects,
    Frame,
    MarkerTruth,
    Membrane,
    SensorDesign,
    load_sensor,
    marker_truth,
    open_renderer,
)
from ..scene.scene import Scene
from .bodies import Ability, Body, BodyName, ChainBody, Pose, SiliconeBody
from .camera import SimulatedCamera
from .contact import Contact
from .given import number, numbers

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Places of the axes that follow each one, and those after them.
_NEXT, _AFTER = np.array([1, 2, 0]), np.array([2, 0, 1])
#: Share of µ·Fn at which the friction of a node counts as slipping.
SLIPPING = 0.98


@dataclass(frozen=True, kw_only=True)
class SensorState:
    """State from which the next update of a sensor starts.

    Attributes
    ----------
    contact: true contact at the frame's instant
    exposed: contact that the picture shows
    index: number of the frame
    before: displacements `carried` in the frame before
    obj: attached object; None if the contact comes from `show`
    """

    contact: Contact
    exposed: Contact
    index: int
    before: Array
    obj: ContactObject | Solid | None


class TactileSensor:
    """A fingertip with a camera inside; the same seed and updates give the same bytes.

    That holds for one family of processors and the same versions of the libraries.

    Parameters
    ----------
    design: name or file of a design, or a design
    body: `chain`, `dome` or `pad`, or a body that differs from the design's (default: the
        silicone of the design)
    seed: seed of the specimen's defects and of the noise (default 0)
    noise: standard deviation of a pixel (default 0) [grey levels]
    defects: defects of the specimen and its image (default: those of the design)
    renderer: name, class or other factory of the renderer (default `painter`)
    membrane_map: map from the displacements `carried` of a state to the membrane (default:
        the sensor's own)
    picture: function applied to each finished picture (default: no change)

    Raises
    ------
    UserError
        For a design, a body or a renderer that cannot be used.
    """

    def __init__(
        self,
        design: SensorDesign | str,
        *,
        body: BodyName | Fingertip | SoftBody | None = None,
        seed: int = 0,
        noise: float = 0.0,
        defects: Defects | None = None,
        renderer: Choice = "painter",
        membrane_map: Callable[[Array], Membrane] | None = None,
        picture: Callable[[Image], Image] | None = None,
    ) -> None:
        _check_type(design, (str, SensorDesign), "a design is a name, a file or a SensorDesign")
        self.design = load_sensor(design) if isinstance(design, str) else design
        with located(f"sensor {design}" if isinstance(design, str) else "the sensor"):
            self.body = body_of(self.design, body)
        noise = number(noise, "noise [grey levels]", 0.0)
        if not (number(seed, "seed") % 1 == 0 and 0 <= seed < 2**32):
            raise UserError(f"seed = {seed} must be a whole number from 0 to {2**32 - 1}")
        self._seed, self._noise = int(seed), noise
        self._defects = self.design.defects if defects is None else defects
        self._renderer, self._map, self._picture = renderer, membrane_map, picture
        self._camera: SimulatedCamera | None = None
        self._lent = False
        self._obj: ContactObject | Solid | None = None
        self._state: SensorState | None = None
        self._data: SensorData | None = None

    @classmethod
    def of_scene(
        cls,
        scene: Scene,
        renderer: Choice | None = None,
        camera: SimulatedCamera | None = None,
        membrane_map: Callable[[Array], Membrane] | None = None,
        body: Fingertip | SoftBody | None = None,
    ) -> Self:
        """Make the sensor of a scene of one finger, with its body and specimen.

        Parameters
        ----------
        scene: scene of one finger
        renderer: renderer in place of the scene's
        camera: camera that takes the pictures, and is not closed with the sensor (default: the
            scene's)
        membrane_map: see `TactileSensor`
        body: body in place of the scene's
        """
        if body is None:
            body = scene.build_body()
        sensor = cls(
            scene.build_sensor(),
            body=body,
            seed=scene.seed,
            noise=scene.camera.noise_levels,
            defects=scene.defects,
            renderer=renderer or scene.renderer,
            membrane_map=membrane_map,
        )
        sensor._camera, sensor._lent = camera, camera is not None
        return sensor

    @property
    def ability(self) -> Ability:
        """Abilities of the body: objects, and axes of motions and loads."""
        return self.body.ability

    @property
    def camera(self) -> SimulatedCamera:
        """Camera that takes pictures of any state of the body; opened when first needed."""
        if self._camera is None:
            self._camera = SimulatedCamera(
                self.design,
                open_renderer(self._renderer, self.design),
                self.body.carrier,
                self._noise,
                self._seed,
                self._defects,
                self._map,
                self._picture,
            )
        return self._camera

    def attach(self, obj: ContactObject | Solid) -> None:
        """Attach an object and begin with it above the apex, which it just touches.

        Parameters
        ----------
        obj: object with its friction: a `ContactObject` for a chain, a `Solid` for silicone

        Raises
        ------
        UserError
            For an object that the body cannot touch, see `ability`.
        """
        announce()  # the first contact compiles
        contact = self.body.touch(obj)
        self._obj = obj
        self._take(contact, contact, 0, contact.state.carried)

    def reset(self) -> None:
        """Begin again with the attached object.

        Raises
        ------
        UserError
            Before `attach`.
        """
        if self._obj is None:
            raise UserError("reset() needs an object; call attach() first")
        self.attach(self._obj)

    def update(
        self,
        pose: Pose | None = None,
        *,
        force: ArrayLike | None = None,
        dt: float,
        placed: bool = False,
    ) -> "SensorData":
        """Move the object, and begin the next frame.

        Parameters
        ----------
        pose: pose to which the object moves in a straight line, in the sensor's frame
        force: instead of a pose, force on the object along x, y and z [N], (3,), where a press has
            a negative z; or force and torque about the sensor's axes [N, N·m], (6,)
        dt: time since the last frame [s]
        placed: whether the object is put at the pose, without friction on its way there; on
            silicone alone

        Returns
        -------
        values of the new frame, as `data`

        Raises
        ------
        UserError
            Before `attach`, for a pose or force that the body cannot follow, and when the model
            fails; the sensor then keeps its state.
        """
        if self._obj is None or self._state is None:
            raise UserError("update() needs an object; call attach() first")
        if not number(dt, "dt") > 0.0:
            raise UserError(f"dt = {dt} must be above 0 s")
        _check_type(pose, (Pose, type(None)), "update() needs a Pose")
        if (pose is None) == (force is None):
            raise UserError("update() needs a pose or a force, and not both")
        state = self._state
        if pose is not None:
            contact = self.body.move(state.contact, pose, dt, placed)
        else:
            contact = self.body.load(state.contact, _wrench(force), dt)
        self._take(contact, contact, state.index + 1, state.exposed.state.carried)
        return self.data

    def show(self, contact: Contact, exposed: Contact, index: int) -> None:
        """Take over a contact that was computed elsewhere, such as by the plant of a rig.

        Parameters
        ----------
        contact: contact at the frame's instant
        exposed: contact in the middle of the frame's exposure
        index: number of the frame, which determines its noise; 0 begins again
        """
        first = self._state is None or index == 0
        before = (exposed.state if first else self._state.exposed.state).carried  # type: ignore[union-attr]
        self._take(contact, exposed, index, before)

    @property
    def data(self) -> "SensorData":
        """Values of the current frame.

        Raises
        ------
        UserError
            Before `attach`.
        """
        if self._data is None:
            raise UserError("data is not available before attach(); call attach() first")
        return self._data

    def rest_frames(self, count: int = 1) -> list[Frame]:
        """Take frames of the untouched sensor at time 0, with noise that no other frame has."""
        return self.camera.expose_rest(self.body.untouched(), count)

    def state(self) -> SensorState:
        """State from which the sensor can go on later, any number of times."""
        if self._state is None:
            raise UserError("state() is not possible before attach(); call attach() first")
        return self._state

    def restore(self, state: SensorState) -> None:
        """Go on from a state of this sensor: the next frames are the same bytes as then.

        Raises
        ------
        UserError
            For a value that is not a state, and for the state of another body.
        """
        _check_type(state, (SensorState,), "restore() needs a value of state()")
        if state.obj is not None and state.obj is not self._obj:
            self.attach(state.obj)
        self._state, self._data = state, SensorData(self, state)

    def close(self) -> None:
        """Release the renderer; closing it again does nothing."""
        if self._camera is not None and not self._lent:
            self._camera.close()
            self._camera = None

    def _take(self, contact: Contact, exposed: Contact, index: int, before: Array) -> None:
        self.restore(
            SensorState(contact=contact, exposed=exposed, index=index, before=before, obj=self._obj)
        )


class SensorData:
    """Picture and truth of one frame; each value is computed when it is first read."""

    def __init__(self, sensor: TactileSensor, state: SensorState) -> None:
        self._sensor, self._state = sensor, state
        self.contact: Contact = state.contact

    @property
    def index(self) -> int:
        """Number of the frame, from 0."""
        return self._state.index

    @property
    def time(self) -> float:
        """Instant of the frame [s]."""
        return self.contact.state.time

    @cached_property
    def frame(self) -> Frame:
        """Picture with its time; it shows the middle of the exposure."""
        state = self._state
        exposed = replace(state.exposed.state, time=self.time)
        return self._sensor.camera.expose(exposed, state.index, state.before)

    @property
    def image(self) -> Image:
        """Picture of the camera, RGB, uint8, shape (H, W, 3)."""
        return self.frame.image

    @cached_property
    def markers(self) -> MarkerTruth:
        """True markers in the picture without noise."""
        sensor = self._sensor
        return marker_truth(sensor.design, sensor.camera.membrane(self.contact.state.carried))

    @property
    def marker_px(self) -> Array:
        """Projected centre of each marker [px], shape (2, M, 2); layer 0 is magenta, 1 yellow."""
        return self.markers.pixels

    @property
    def marker_visible(self) -> NDArray[np.bool_]:
        """Markers that lie in the picture, bool, shape (2, M)."""
        return self.markers.visible

    @property
    def marker_pos(self) -> Array:
        """Centre of each marker in the sensor's frame [m], shape (2, M, 3)."""
        return self.markers.centres

    @cached_property
    def _nodes(self) -> tuple[Array, Array]:
        return self._sensor.body.nodes(self.contact)

    @property
    def node_pos(self) -> Array:
        """Place of each node of the skin [m], shape (N, 3); those far from the object at rest."""
        return self._nodes[0]

    @property
    def node_force(self) -> Array:
        """Force of the object on each node [N], shape (N, 3)."""
        return self._nodes[1]

    @cached_property
    def wrench(self) -> Array:
        """Force of the object on the sensor, and its torque about the origin [N, N·m], (6,).

        The torque of a chain, which has no width, is the one in its plane.
        """
        places, forces = self._nodes
        moments = places.T @ forces
        torque = moments[_NEXT, _AFTER] - moments[_AFTER, _NEXT]
        return np.concatenate([forces.sum(axis=0), torque])

    @property
    def slipping(self) -> NDArray[np.bool_]:
        """Nodes whose friction is near its limit, bool, shape (N,)."""
        field = self.contact.field
        limit = SLIPPING * self.contact.friction * field.normal
        return field.contact & (field.friction_sizes >= limit)

    @property
    def friction(self) -> float:
        """µ of the contact as a whole."""
        return self.contact.friction

    @property
    def margin(self) -> float:
        """Safety margin Γ with the object's µ; NaN without contact."""
        return self.contact.field.safety_margin(self.friction)

    @property
    def limit_margin(self) -> float:
        """Margin of friction and torsion together; NaN on a chain and without contact."""
        return margin_within(self.contact.field, self.friction)


def body_of(design: SensorDesign, body: BodyName | Fingertip | SoftBody | None) -> Body:
    """Build the body of a design by name, or wrap a given body.

    Raises
    ------
    UserError
        For a body that the design does not have.
    """
    if body == "chain":  # the one name that is not its silicone's
        body = Fingertip.of_radius(design.shape.radius, nodes=REFERENCE_NODES, law="split")
    if isinstance(body, Fingertip):  # a given body, here and in the next line
        return ChainBody(body, flat=design.shape.flat)
    if isinstance(body, SoftBody):
        return SiliconeBody(body)
    if body not in (None, "dome", "pad"):
        raise UserError(f"body = {body!r}: allowed are chain, dome, pad")
    silicone = SiliconeBody(design.dome)
    if body not in (None, silicone.name):
        raise UserError(f'its silicone is a {silicone.name}; body = "{body}" is not possible')
    return silicone


def _check_type(value: object, allowed: tuple[type, ...], what: str) -> None:
    if not isinstance(value, allowed):
        raise UserError(f"{what}, not a {type(value).__name__}")


def _wrench(force: ArrayLike | None) -> Array:
    """Force and torque on an object [N, N·m], shape (6,)."""
    given = numbers(force, (3, 6), "a force")
    return np.concatenate([given, np.zeros(6 - len(given))])


def open_camera(scene: Scene, renderer: Choice | None = None) -> SimulatedCamera:
    """Open the camera of a scene of one finger; close it after the run.

    Raises
    ------
    UserError
        When the renderer cannot run on this machine.
    """
    return TactileSensor.of_scene(scene, renderer).camera
