"""How the skin moves in the sequences that trackers are scored on."""

import math
from collections.abc import Callable, Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial import KDTree

from ...extras import need
from ...model import (
    ContactObject,
    Fingertip,
    Motion,
    SoftBody,
    Solid,
    equilibrium,
    press_and_move,
    simulate_contact,
)
from ...model.shapes import Shape, ball, box, cylinder, mesh
from ...render import (
    DomeMap,
    Membrane,
    MembraneMap,
    SensorDesign,
    centroids,
    outlines,
    rest_membrane,
)

Array = NDArray[np.float64]

#: Grip and load [N] of the node model, one after the other and again from the first.
_GRASP = ((0.0, 0.0), (1.0, 0.0), (2.5, 0.3), (3.0, 0.8), (3.0, 0.0), (2.0, -0.4), (0.8, 0.0))
#: Nodes of its chain.
_NODES = 101
#: Frames of one period of grasp and sway.
ROUND = 40
#: Largest turn about the apex of a field that drifts [rad].
_DRIFT_TURN = math.radians(5.0)
#: Press and motion after it of a contact on the dome [s].
_PRESS, _MOVE = 0.4, 0.6
#: Steps of the silicone in a second, at least.
_STEPS = 160
#: Radius of the cylinder that rolls [m], and how far it rolls to either side [rad].
_ROD, _SWING = 3.5e-3, math.radians(20.0)


def motion(
    sensor: SensorDesign,
    places: Array | None,
    count: int,
    *,
    grasp: float,
    sway_px: float,
    shift_pitch: float,
    layer_shift_px: float,
    drift_pitch: float,
) -> Iterator[Membrane]:
    """Membranes of so many frames, with all markers at the given places or as designed.

    `Conditions` describes the motion.
    """
    membrane_map, path = MembraneMap(sensor, _NODES, places), _grasp_path()
    focal = float(sensor.camera.build().jacobian(np.array([0.0, 0.0, 1.0]))[0, 0])
    jump = shift_pitch * pitch(sensor)
    for k in range(count):
        turn = (k + 1) / ROUND
        membrane = membrane_map(grasp * path(turn))
        # Out and back: every second frame is at rest again, in between the direction turns.
        place = jump * (k % 2) * np.array([np.cos(2.4 * (k // 2)), np.sin(2.4 * (k // 2))])
        around = 2 * np.pi * turn
        place += sway_px * np.array([np.sin(around), 0.7 * np.sin(2 * around)])
        if place.any():
            membrane = _turned(membrane, np.outer(sensor.follow, place) / focal, fixed_rim=True)
        if drift_pitch:
            # On a circle through rest, whose directions are all, and to and fro about the apex.
            aside = (
                0.5 * drift_pitch * pitch(sensor) * np.array([1 - np.cos(around), np.sin(around)])
            )
            membrane = _turned(membrane, np.outer(sensor.follow, aside) / focal, fixed_rim=False)
            membrane = _spun(membrane, np.array(sensor.follow) * _DRIFT_TURN * np.sin(around))
        if layer_shift_px:
            slide = np.array([layer_shift_px * min(1.0, 4.0 * (k + 1) / count), 0.0]) / focal
            membrane = _turned(membrane, np.outer([1.0, 0.0], slide), fixed_rim=False)
        yield membrane


def contact_motion(
    sensor: SensorDesign,
    places: Array | None,
    count: int,
    name: str,
    scale: float = 1.0,
    deeper: float = 1.0,
) -> Iterator[Membrane]:
    """Membranes of so many frames of an object that is pressed on the dome and moved.

    Parameters
    ----------
    name: of `CONTACTS`
    scale: factor on the motion after the press
    deeper: factor on the press
    """
    dome, (shape, move) = sensor.dome, CONTACTS[name]
    solid = Solid(shape=shape(), friction=0.6)
    each = max(1, math.ceil(_STEPS / count))
    dt = (_PRESS + _MOVE) / (count * each)
    run = simulate_contact(dome, solid, move(dome, scale, deeper), dt, keep=each)
    membrane_map = DomeMap(sensor, dome, places)
    ends = (_PRESS + _MOVE) * (np.arange(count) + 1) / count
    for end in ends:
        state = min(run.states, key=lambda one: abs(one.time - end))
        yield membrane_map(state.linear)


def _pressed(
    share: float,
    *,
    shift: tuple[float, float] = (0.0, 0.0),
    twist: float = 0.0,
    tilt: tuple[float, float] = (0.0, 0.0),
) -> Callable[[SoftBody, float, float], Motion]:
    """A press by a share of the silicone's thickness, then a shift [m], or a twist [rad]."""

    def motion(dome: SoftBody, scale: float, deeper: float) -> Motion:
        return press_and_move(
            deeper * share * dome.thickness,
            shift=(scale * shift[0], scale * shift[1]),
            twist=scale * twist,
            tilt=tilt,
            press_s=_PRESS,
            move_s=_MOVE,
        )

    return motion


def _rolled(dome: SoftBody, scale: float, deeper: float) -> Motion:
    """A rod along y is pressed beside the apex, and rolls over it to the other side."""
    angles = scale * np.concatenate([[-_SWING], np.linspace(-_SWING, _SWING, 41)])
    rest, poses = dome.radius + _ROD, np.zeros((42, 6))
    apart = rest - np.array([-2e-5, *[deeper * 0.35 * dome.thickness] * 41])
    poses[:, 0], poses[:, 2] = apart * np.sin(angles), apart * np.cos(angles) - rest
    poses[:, 4] = (angles - angles[0]) * rest / _ROD
    times = np.concatenate([[0.0], np.linspace(_PRESS, _PRESS + _MOVE, 41)])
    return Motion(times=times, poses=poses)


def _two_balls() -> Shape:
    """Two balls of 2.5 mm beside each other, as one mesh; both touch."""
    trimesh = need("trimesh", "mesh")
    balls = [trimesh.creation.icosphere(subdivisions=3, radius=2.5) for _ in range(2)]
    for side, one in zip((-2.6, 2.6), balls, strict=True):
        one.apply_translation([side, 0.0, 0.0])
    return mesh(trimesh.util.concatenate(balls), scale=1e-3, centred=True)


#: Object, and motion on a dome by two factors, on the motion after the press and on the press.
CONTACTS: dict[str, tuple[Callable[[], Shape], Callable[[SoftBody, float, float], Motion]]] = {
    "twist": (lambda: ball(12e-3), _pressed(0.4, twist=math.radians(40.0))),
    "edge": (
        lambda: box((24e-3, 8e-3, 8e-3), 0.3e-3),
        _pressed(0.35, tilt=(math.pi / 4, 0.0), shift=(0.5e-3, 0.4e-3)),
    ),
    "two-contacts": (_two_balls, _pressed(0.4, shift=(0.3e-3, 0.3e-3))),
    "roll": (lambda: cylinder(_ROD, 40e-3, 0.5e-3), _rolled),
}


def pitch(sensor: SensorDesign) -> float:
    """Typical distance of the image of a marker to the next one of its layer [px]."""
    centre = centroids(outlines(rest_membrane(sensor), sensor.view), square=False)[0]
    return float(np.median(np.asarray(KDTree(centre).query(centre, k=2)[0])[:, 1]))


@lru_cache(maxsize=1)
def _grasp_path() -> CubicSpline:
    """Node displacements (N, 2) [m] over the share of a grasp, 0…1, smooth and periodic."""
    tip, at_rest = Fingertip(nodes=_NODES), np.zeros((_NODES, 2))
    loaded = [
        equilibrium(tip, ContactObject(), grip, load).deformation.seen for grip, load in _GRASP[1:]
    ]
    shares = np.linspace(0.0, 1.0, len(loaded) + 2)
    return CubicSpline(shares, np.stack([at_rest, *loaded, at_rest]), bc_type="periodic")


def _turned(membrane: Membrane, turns: Array, fixed_rim: bool) -> Membrane:
    """Each layer turned about the sphere's centre, towards (x, y) by so much [rad], turns (2, 2).

    With a fixed rim the turn is that of the apex, and falls off smoothly to nothing at 85°.
    """
    centres, axes = membrane.centres.copy(), membrane.axes.copy()
    for layer, (x, y) in enumerate(turns):
        at = membrane.centres[layer]
        turn = np.full(len(at), np.hypot(x, y))
        if fixed_rim:
            polar = np.arctan2(np.hypot(at[:, 0], at[:, 1]), at[:, 2])
            turn *= np.cos(0.5 * np.pi * np.clip(polar / np.deg2rad(85.0), 0.0, 1.0)) ** 2
        direction = np.arctan2(y, x)
        across = np.array([-np.sin(direction), np.cos(direction), 0.0])
        for vectors in (centres[layer], axes[layer, ..., 0], axes[layer, ..., 1]):
            vectors[:] = _rotated(vectors, across, turn)
    return Membrane(centres=centres, axes=axes)


def _spun(membrane: Membrane, angles: Array) -> Membrane:
    """Each layer turned about the apex by an angle [rad]."""
    matrix = np.array(
        [[[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]] for a in angles]
    )
    centres = np.einsum("lij,lmj->lmi", matrix, membrane.centres)
    return Membrane(centres=centres, axes=np.einsum("lij,lmjk->lmik", matrix, membrane.axes))


def _rotated(vectors: Array, axis: Array, angle: Array) -> Array:
    """Rodrigues' formula for vectors (M, 3) about one axis by angles (M,)."""
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    along = (vectors @ axis)[:, None] * axis
    return vectors * cos + np.cross(axis, vectors) * sin + along * (1.0 - cos)
