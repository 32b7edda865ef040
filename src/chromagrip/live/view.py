"""The fingertip and the object in three dimensions."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import scipy
from numpy.typing import NDArray

from ..loop.results.dome_picture import SLIPPING
from ..loop.sample import Sample
from ..model import ForceField
from ..model.dome import displacements, lattice
from ..scene.scene import Body, Scene
from ..sensing.contact import Contact, of_dome
from .solid import Array, half_sphere, object_mesh, skin_faces

if TYPE_CHECKING:
    import trimesh
    import viser

Floats = NDArray[np.float32]

#: Colours of the skin, of the most pressed skin and of the object, RGB.
SKIN = np.array([226, 212, 186])
PRESSED = np.array([20, 90, 190])
OBJECT = (70, 125, 95)
#: Colours of friction where skin sticks and slips, RGB.
STICKS = (20, 20, 20)
SLIPS = (213, 94, 0)


#: First place of the eye, and the place that it looks at, about where objects touch [cm].
_EYE = np.array([0.75, -1.0, 1.6])
_CONTACT = np.array([0.0, 0.0, 0.9])


async def _raise_contact(client: "viser.ClientHandle") -> None:
    """Move the contact up in a narrow window, whose lower part is covered by the panel.

    A coroutine, as the client cannot leave while it runs.
    """
    narrow = 700  # width below which the panel covers the lower part of the view [px]
    if client.camera.image_width < narrow:
        farther, lower = 1.5 * (_EYE - _CONTACT), _CONTACT - (0.0, 0.0, 0.8)
        client.camera.position, client.camera.look_at = lower + farther, lower


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """Drawing of a frame.

    Attributes
    ----------
    skin: places of the skin's points [m], (N, 3); None if they do not move
    place: place of the object [m], (3,); None if there is no object
    turn: rotation of the object as a quaternion, real part first
    pressed, normal: places of pressed skin [m], (P, 3), and the forces there [N], (P,)
    start, force, slips: places of nodes [m], (K, 3), their friction [N], (K, 3), and whether they
        slip, (K,)
    """

    skin: Floats | None = None
    place: tuple[float, float, float] | None = None
    turn: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    pressed: Floats
    normal: Floats
    start: Floats
    force: Floats
    slips: NDArray[np.bool_]


class FingertipView:
    """Skin coloured by pressure, friction as arrows, and the object in its place.

    Parameters
    ----------
    server: server of the page
    """

    #: Units of the view in a metre: it shows centimetres.
    _unit = 100.0

    def __init__(self, server: "viser.ViserServer") -> None:
        self._server = server
        self._handles: tuple[Any, ...] = ()
        self._object: Any = None
        self._largest = 1e-6
        server.scene.set_up_direction("+z")
        server.scene.configure_default_lights(cast_shadow=False)  # shadows take most of the time
        server.initial_camera.position = tuple(_EYE)
        server.initial_camera.look_at = tuple(_CONTACT)
        server.on_client_connect(_raise_contact)

    def lay(self, points: Array, mesh: "trimesh.Trimesh | None") -> None:
        """Draw a skin at rest, and an object."""
        self._largest = 1e-6
        for handle in self._handles:
            handle.remove()
        scene = self._server.scene
        self._rest = points
        self._skin = scene.add_mesh_simple(
            "/skin", self._unit * points, skin_faces(points), color=tuple(SKIN), side="double",
            opacity=0.6 if mesh is None else 0.9,  # an estimate's contact lies below skin at rest
        )  # fmt: skip
        self._dots = scene.add_point_cloud(
            "/pressure", self._unit * points[:1], SKIN[None], point_size=0.04, point_shape="circle"
        )
        self._arrows = scene.add_arrows(
            "/friction", np.zeros((1, 2, 3)), np.array(STICKS), shaft_radius=0.004,
            head_radius=0.012, head_length=0.03,
        )  # fmt: skip
        self._handles = (self._skin, self._dots, self._arrows)
        self._object = None
        if mesh is not None:
            # Only its far side, transparent, so that the contact is visible.
            self._object = scene.add_mesh_simple(
                "/object", self._unit * np.asarray(mesh.vertices),
                np.asarray(mesh.faces, np.uint32), color=OBJECT, opacity=0.2, side="back",
            )  # fmt: skip
            self._handles += (self._object,)

    def show(self, drawn: Drawn) -> None:
        """Draw a frame."""
        with self._server.atomic():
            if drawn.skin is not None:
                self._skin.vertices = self._unit * drawn.skin
            if self._object is not None and drawn.place is not None:
                x, y, z = drawn.place
                self._object.position = (self._unit * x, self._unit * y, self._unit * z)
                self._object.wxyz = drawn.turn
            self._show_pressure(drawn)
            self._show_arrows(drawn)

    def _show_pressure(self, drawn: Drawn) -> None:
        """Draw dots at pressed skin; darker ones are pressed more."""
        position, normal = drawn.pressed, drawn.normal
        if not len(position):
            position, normal = self._rest[:1].astype(np.float32), np.zeros(1, np.float32)
        share = normal / max(float(normal.max()), 1e-9)
        colours = SKIN + share[:, None] * (PRESSED - SKIN)
        self._dots.points = self._unit * position
        self._dots.colors = colours.astype(np.uint8)

    def _show_arrows(self, drawn: Drawn) -> None:
        """Draw the friction of each node, to one scale, which shrinks for larger forces."""
        size = np.linalg.norm(drawn.force, axis=1)
        self._largest = max(self._largest, float(size.max(initial=0.0)))
        least = 0.04  # share of the longest below which arrows are omitted
        kept = size > least * self._largest
        # Height of the arrows above the dots, so that these do not hide them [cm].
        above = np.array([0.0, 0.0, 0.03], np.float32)
        start, slips = self._unit * drawn.start[kept] + above, drawn.slips[kept]
        longest = 0.5  # length of the longest arrow [cm]
        way = longest / self._largest * drawn.force[kept]
        if not len(start):  # viser refuses an empty list: draw one too small to be visible
            start, way = np.full((1, 3), -1.0, np.float32), np.full((1, 3), 1e-4, np.float32)
            slips = np.zeros(1, bool)
        self._arrows.points = np.stack([start, start + way], axis=1).astype(np.float32)
        self._arrows.colors = np.where(slips[:, None], SLIPS, STICKS).astype(np.uint8)


class GraspView(FingertipView):
    """The view of a grasp, whose scene may change."""

    _scene: Scene | None = None
    _draw: "Draw"

    def begin(self, scene: Scene) -> None:
        """Draw skin and object of a scene, unless they are drawn already."""
        if self._scene is None or _looks(scene) != _looks(self._scene):
            points, self._draw = _BODIES[scene.body](scene)
            self.lay(points, object_mesh(scene.object))
        self._scene = scene

    def drawn(self, sample: Sample, estimated: bool) -> Drawn:
        """Drawing of a frame, with the estimated forces if asked for and known."""
        observation = sample.observation
        field, mu = sample.field, sample.friction
        if estimated and observation is not None and sample.tracks is not None:
            field, mu = observation.field, observation.friction
        return self._draw(sample.contact, field, mu)


def _chain(scene: Scene) -> "tuple[Array, Draw]":
    """Points of the skin of a scene's chain, and the function that draws its contacts."""

    def draw(contact: Contact, field: ForceField, mu: float) -> Drawn:
        apex = float(contact.field.position[:, 1].max())
        return drawn_forces(field, mu, place=(contact.place[0], 0.0, apex))

    return half_sphere(scene.build_fingertip().radius), draw


def _dome(scene: Scene) -> "tuple[Array, Draw]":
    """Points of the skin of a scene's silicone, and the function that draws its contacts."""
    dome = scene.build_dome()
    points = lattice(dome).points

    def draw(contact: Contact, field: ForceField, mu: float) -> Drawn:
        _, state, _ = of_dome(contact)
        turn = scipy.spatial.transform.Rotation.from_matrix(state.rotation)
        w, x, y, z = turn.as_quat(scalar_first=True).tolist()
        place = (float(state.place[0]), float(state.place[1]), float(state.place[2]))
        skin = _small(points + displacements(dome, state))
        return drawn_forces(field, mu, skin=skin, place=place, turn=(w, x, y, z))

    return points, draw


#: Draws the contact of a body with forces and µ, true or estimated.
Draw = Callable[[Contact, ForceField, float], Drawn]
_BODIES: dict[Body, Callable[[Scene], tuple[Array, Draw]]] = {"chain": _chain, "dome": _dome}


def drawn_forces(field: ForceField, mu: float, **more: Any) -> Drawn:
    """Drawing of forces; `more` are the other values of `Drawn`."""
    position, friction, size = in_space(field)
    pressed = field.contact & (field.normal > 0.0)
    arrows, start = np.flatnonzero(field.contact), position
    beside = 4e-4  # distance between the rows of a chain's arrows, only for display [m]
    if field.directions is None:  # in one line the arrows would hide each other
        arrows = arrows[::3]
        start = position.copy()
        start[arrows, 1] = beside * (np.arange(len(arrows)) % 3 - 1)
    return Drawn(
        pressed=_small(position[pressed]),
        normal=_small(field.normal[pressed]),
        start=_small(start[arrows]),
        force=_small(friction[arrows]),
        slips=(size > SLIPPING * mu * field.normal)[arrows],
        **more,
    )


def in_space(field: ForceField) -> tuple[Array, Array, Array]:
    """Positions and friction of nodes in space [m, N], (N, 3), and the friction's size, (N,)."""
    if field.directions is not None:
        return field.position, field.friction, field.friction_sizes
    x, z = field.position.T
    zeros = np.zeros_like(x)
    return (
        np.stack([x, zeros, z], axis=-1),
        np.stack([field.friction, zeros, zeros], axis=-1),
        abs(field.friction),
    )


def _small(values: Array) -> Floats:
    return np.asarray(values, np.float32)


def _looks(scene: Scene) -> tuple[object, ...]:
    """Values of a scene that determine the drawn skin and object."""
    ignored = {
        "friction": 0.5, "stiffness_kpa": 200.0, "friction_times_s": (), "frictions": (),
    }  # fmt: skip
    return scene.body, scene.sensor, scene.dome, msgspec.structs.replace(scene.object, **ignored)
