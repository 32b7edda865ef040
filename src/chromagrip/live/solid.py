"""Surfaces of skins and objects as triangles."""

import math
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import NDArray

from ..scene.settings import ObjectSettings

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Faces = NDArray[np.uint32]


def object_mesh(settings: ObjectSettings) -> "trimesh.Trimesh":
    """Surface of an object about its origin [m]; of a file, about the middle of its box."""
    import trimesh

    size = [1e-3 * length for length in settings.size_mm]
    side = 0.024  # side and thickness of the drawn piece of a plane [m]
    thickness = 0.0005
    if settings.mesh:
        made = trimesh.load(settings.mesh, force="mesh")
        made.apply_scale(1e-3 * settings.mesh_unit_mm)
        made.apply_translation(-made.bounds.mean(axis=0))
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
        made = trimesh.creation.box(extents=(side, side, thickness))
        made.apply_translation((0.0, 0.0, 0.5 * thickness))
    else:
        made = trimesh.creation.icosphere(subdivisions=4, radius=1e-3 * abs(settings.radius_mm))
    return made


def half_sphere(radius: float) -> Array:
    """Points of a half sphere about its centre, ring after ring [m], (N, 3)."""
    points = [np.array([[0.0, 0.0, 1.0]])]
    rings = 16  # rings of a half sphere
    for ring in range(1, rings + 1):
        angle, around = 0.5 * math.pi * ring / rings, np.arange(6 * ring) * math.pi / (3 * ring)
        x, y = math.sin(angle) * np.cos(around), math.sin(angle) * np.sin(around)
        points.append(np.stack([x, y, np.full(6 * ring, math.cos(angle))], axis=-1))
    return radius * np.concatenate(points)


def skin_faces(points: Array) -> Faces:
    """Triangles between points of a skin that has one height at each place, (M, 3).

    They are found on the flattened skin: viewed from above, its steep rim would have no width.
    """
    across = np.hypot(points[:, 0], points[:, 1])
    height = points[:, 2] - points[:, 2].min() + 0.1 * across.max()
    flat = np.arctan2(across, height) / np.maximum(across, 1e-12)
    return np.asarray(scipy.spatial.Delaunay(flat[:, None] * points[:, :2]).simplices, np.uint32)
