"""Shapes of objects in three dimensions, as signed distances: formulas and triangle meshes."""

from ..kernels.dome.distance_kernels import distance
from .primitives import ball, box, capsule, cone, cylinder, plane, quadric, torus
from .shape import Shape, distances, reach_down
from .triangle_mesh import mesh

__all__ = [
    "Shape",
    "ball",
    "box",
    "capsule",
    "cone",
    "cylinder",
    "distance",
    "distances",
    "mesh",
    "plane",
    "quadric",
    "reach_down",
    "torus",
]
