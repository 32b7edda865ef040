"""Shapes of objects in three dimensions, as signed distances: formulas and triangle meshes."""

from ..kernels.dome.distance_kernels import distance
from .mesh import mesh_shape
from .primitives import ball, box, capsule, cone, cylinder, plane, quadric, torus
from .shape import Shape, distances, reach_down

__all__ = [
    "Shape",
    "ball",
    "box",
    "capsule",
    "cone",
    "cylinder",
    "distance",
    "distances",
    "mesh_shape",
    "plane",
    "quadric",
    "reach_down",
    "torus",
]
