"""Shapes of objects in three dimensions, as signed distances: formulas and triangle meshes."""

from .mesh import mesh_shape
from .primitives import ball, box, capsule, cone, cylinder, plane, torus
from .shape import Shape, distances, reach_down

__all__ = [
    "Shape",
    "ball",
    "box",
    "capsule",
    "cone",
    "cylinder",
    "distances",
    "mesh_shape",
    "plane",
    "reach_down",
    "torus",
]
