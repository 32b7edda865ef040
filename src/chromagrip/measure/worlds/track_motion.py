"""How the skin moves in the sequences that trackers are scored on."""

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial import KDTree

from ...model import ContactObject, Fingertip, equilibrium
from ...render import Membrane, MembraneMap, SensorDesign, centroids, outlines, rest_membrane

Array = NDArray[np.float64]

#: Grip and load [N] of the node model, one after the other and again from the first.
_GRASP = ((0.0, 0.0), (1.0, 0.0), (2.5, 0.3), (3.0, 0.8), (3.0, 0.0), (2.0, -0.4), (0.8, 0.0))
#: Nodes of its chain.
_NODES = 101
#: Frames of one period of grasp and sway.
ROUND = 40


def motion(
    sensor: SensorDesign,
    places: Array | None,
    count: int,
    *,
    grasp: float,
    sway_px: float,
    shift_pitch: float,
    layer_shift_px: float,
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
        if layer_shift_px:
            slide = np.array([layer_shift_px * min(1.0, 4.0 * (k + 1) / count), 0.0]) / focal
            membrane = _turned(membrane, np.outer([1.0, 0.0], slide), fixed_rim=False)
        yield membrane


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


def _rotated(vectors: Array, axis: Array, angle: Array) -> Array:
    """Rodrigues' formula for vectors (M, 3) about one axis by angles (M,)."""
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    along = (vectors @ axis)[:, None] * axis
    return vectors * cos + np.cross(axis, vectors) * sin + along * (1.0 - cos)
