"""The fingertip and the object in three dimensions, and the camera's picture."""

import math
from typing import TYPE_CHECKING, Any

import cv2
import msgspec
import numpy as np
import scipy
from numpy.typing import NDArray

from ..loop.shown.dome_picture import SLIPPING
from ..loop.shown.tactile_video import MAGNIFY
from ..loop.steps.sample import Sample
from ..model import DomeState, ForceField
from ..model.dome import displacements, lattice
from ..scene.scene import Scene
from ..scene.settings import ObjectSettings
from .session import Shown

if TYPE_CHECKING:
    import trimesh
    import viser

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Units of the view in a metre: it shows centimetres.
UNIT = 100.0
#: Length of the longest arrow [cm], and arrows below this share of it are left out.
LONGEST, _LEAST = 0.5, 0.04
#: Colours of the skin, of skin that is pressed most, of the object, RGB.
SKIN, PRESSED, OBJECT = np.array([232, 226, 214]), np.array([20, 90, 190]), (120, 120, 125)
#: Colours of friction where skin sticks and slips, RGB; slipping arrows are thicker at their heads.
STICKS, SLIPS = (20, 20, 20), (213, 94, 0)
#: Side of the picture on the page [px].
PICTURE = 420
#: Colour of the markers' motion, RGB.
_MOTION = (0, 130, 60)


class FingertipView:
    """Skin coloured by pressure, friction as arrows, and the object in its place.

    Parameters
    ----------
    server: of the page
    """

    def __init__(self, server: "viser.ViserServer") -> None:
        self._server = server
        self._scene: Scene | None = None
        self._drawn: tuple[Any, ...] = ()
        self._largest = 1e-6
        server.scene.set_up_direction("+z")
        server.scene.configure_default_lights(cast_shadow=False)  # which take most of the time
        server.initial_camera.position = (1.6, -1.6, 1.9)
        server.initial_camera.look_at = (0.0, 0.0, 0.6)

    def show(self, shown: Shown, estimated: bool) -> None:
        """Draw a frame, with the estimated forces or the true ones."""
        sample, scene = shown.sample, shown.scene
        if self._scene is None or _looks(scene) != _looks(self._scene):
            self._begin(scene)
        self._scene = scene
        observation = sample.observation
        field, mu = sample.field, sample.friction
        if estimated and observation is not None and sample.tracks is not None:
            field, mu = observation.field, observation.friction
        with self._server.atomic():
            if scene.body == "dome":
                self._show_dome(sample, field)
            else:
                self._show_chain(sample)
            self._show_arrows(field, mu)

    def _begin(self, scene: Scene) -> None:
        """Draw skin and object of a scene."""
        self._largest = 1e-6
        for drawn in self._drawn:
            drawn.remove()
        if scene.body == "dome":
            self._dome = scene.build_dome()
            self._points: Array = lattice(self._dome).points
        else:
            self._points = _half_sphere(scene.build_fingertip().radius)
        flat = scipy.spatial.Delaunay(self._points[:, :2])
        faces = flat.simplices.astype(np.uint32)
        self._skin = self._server.scene.add_mesh_simple(
            "/skin", UNIT * self._points, faces, color=tuple(SKIN), side="double",
            opacity=0.9,
        )  # fmt: skip
        mesh = object_mesh(scene.object)
        self._object = self._server.scene.add_mesh_simple(
            "/object", UNIT * np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.uint32),
            color=OBJECT, opacity=0.25, side="double",
        )  # fmt: skip
        self._dots = self._server.scene.add_point_cloud(
            "/pressure", UNIT * self._points[:1], SKIN[None], point_size=0.04, point_shape="circle"
        )
        self._arrows = self._server.scene.add_arrows(
            "/friction", np.zeros((1, 2, 3)), np.array(STICKS), shaft_radius=0.006,
            head_radius=0.018, head_length=0.04,
        )  # fmt: skip
        self._drawn = (self._skin, self._object, self._dots, self._arrows)

    def _show_dome(self, sample: Sample, field: ForceField) -> None:
        state = sample.truth.state
        assert isinstance(state, DomeState)
        moved: Array = self._points + displacements(self._dome, state)
        self._skin.vertices = (UNIT * moved).astype(np.float32)
        self._object.position = tuple(UNIT * state.place)
        turn = scipy.spatial.transform.Rotation.from_matrix(state.rotation)
        self._object.wxyz = tuple(turn.as_quat(scalar_first=True))
        pressed = field.contact & (field.normal > 0.0)
        self._show_pressure(field.position[pressed], field.normal[pressed])

    def _show_chain(self, sample: Sample) -> None:
        x, _ = sample.truth.place
        apex = float(sample.field.position[:, 1].max())
        self._object.position = (UNIT * x, 0.0, UNIT * apex)
        field = sample.field
        pressed = field.contact
        position, _, _ = in_space(field)
        self._show_pressure(position[pressed], field.normal[pressed])

    def _show_pressure(self, position: Array, normal: Array) -> None:
        """Dots where the skin is pressed, the darker the more."""
        if not len(position):
            position, normal = self._points[:1], np.zeros(1)
        share = normal / max(float(normal.max()), 1e-9)
        colours = SKIN + share[:, None] * (PRESSED - SKIN)
        self._dots.points = (UNIT * position).astype(np.float32)
        self._dots.colors = colours.astype(np.uint8)

    def _show_arrows(self, field: ForceField, mu: float) -> None:
        """Friction of each node, to one scale, which shrinks where it must."""
        position, friction, size = in_space(field)
        largest = float(size.max(initial=0.0))
        self._largest = max(self._largest, largest)
        kept = np.flatnonzero(field.contact & (size > _LEAST * self._largest))
        start = UNIT * position[kept]
        way = LONGEST / self._largest * friction[kept]
        if not len(kept):
            start, way = np.full((1, 3), -1.0), np.full((1, 3), 1e-4)
            kept = np.zeros(1, dtype=np.intp)
        slips = size[kept] > SLIPPING * mu * field.normal[kept]
        self._arrows.points = np.stack([start, start + way], axis=1).astype(np.float32)
        self._arrows.colors = np.where(slips[:, None], SLIPS, STICKS).astype(np.uint8)


def in_space(field: ForceField) -> tuple[Array, Array, Array]:
    """Positions and friction of nodes in space [m, N], (N, 3), and the friction's size, (N,)."""
    if field.directions is not None:
        return field.position, field.friction, field.friction_sizes
    x, z = field.position.T
    none = np.zeros_like(x)
    return (
        np.stack([x, none, z], axis=-1),
        np.stack([field.friction, none, none], axis=-1),
        abs(field.friction),
    )


def object_mesh(settings: ObjectSettings) -> "trimesh.Trimesh":
    """Surface of an object about its origin [m]."""
    import trimesh

    size = [1e-3 * length for length in settings.size_mm]
    if settings.mesh:
        made = trimesh.load_mesh(settings.mesh)
        made.apply_scale(1e-3 * settings.mesh_unit_mm)
    elif settings.shape == "box":
        made = trimesh.creation.box(extents=size)
    elif settings.shape == "cylinder":
        made = trimesh.creation.cylinder(radius=size[0], height=size[1])
    elif settings.shape == "capsule":
        made = trimesh.creation.capsule(radius=size[0], height=size[1])
    elif settings.shape == "torus":
        made = trimesh.creation.torus(major_radius=size[0], minor_radius=size[1])
    elif settings.shape == "cone":
        made = trimesh.creation.cone(radius=size[0], height=size[1])
    elif math.isinf(settings.radius_mm):
        made = trimesh.creation.box(extents=(0.02, 0.02, 0.0005))
        made.apply_translation((0.0, 0.0, 0.00025))
    else:
        radius = 1e-3 * abs(settings.radius_mm)
        made = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    return made


def blank_picture() -> Image:
    """Picture where the camera has taken none, RGB."""
    return np.full((PICTURE, PICTURE, 3), 128, np.uint8)


def picture_of(shown: Shown) -> Image:
    """The camera's picture with the motion of the markers, magnified, RGB."""
    sample = shown.sample
    if sample.frame is None:
        return blank_picture()
    canvas = sample.frame.image.copy()
    if sample.tracks is not None and sample.rest is not None:
        seen = sample.tracks.visible[0] & sample.rest.visible[0]
        start, now = sample.rest.position[0, seen], sample.tracks.position[0, seen]
        tips = now + (MAGNIFY - 1.0) * (now - start)
        lines = np.rint(16.0 * np.stack([start, tips], axis=1)).astype(np.int32)
        moved = abs(tips - start).max(axis=1) > 1.0
        cv2.polylines(canvas, list(lines[moved]), False, _MOTION, 2, cv2.LINE_AA, 4)
    height, width = canvas.shape[:2]
    scale = PICTURE / width
    size = (PICTURE, round(scale * height))
    return np.asarray(cv2.resize(canvas, size, interpolation=cv2.INTER_AREA), np.uint8)


def _looks(scene: Scene) -> tuple[object, ...]:
    """What the drawn skin and object hang on."""
    same = {"friction": 0.5, "stiffness_kpa": 200.0}
    return scene.body, scene.sensor, scene.dome, msgspec.structs.replace(scene.object, **same)


def _half_sphere(radius: float) -> Array:
    """Points of a dome about its centre [m], (N, 3)."""
    angle = np.arccos(1.0 - (np.arange(500) + 0.5) / 500.0)
    azimuth = np.arange(500) * math.pi * (3.0 - math.sqrt(5.0))
    rim = np.sin(angle)
    return radius * np.stack([rim * np.cos(azimuth), rim * np.sin(azimuth), np.cos(angle)], axis=-1)
