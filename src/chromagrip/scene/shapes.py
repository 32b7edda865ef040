"""The object of a scene as a shape in three dimensions."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from ..model.shapes import Shape, ball, box, capsule, cone, cylinder, mesh, plane, torus
from .settings import ObjectSettings

Array = NDArray[np.float64]

#: Keys of an object that are only for a dome.
SHAPE_KEYS = (
    "shape", "size_mm", "rounding_mm", "mesh", "mesh_unit_mm", "mesh_cells", "turned_deg",
    "beside_mm",
)  # fmt: skip
#: Keys of an object that are only for the chain.
PROFILE_KEYS = ("profile_mm", "friction_places_mm", "friction_factors", "surface")


def build_shape(settings: ObjectSettings) -> Shape:
    """Build the shape of an object; a ball of radius inf is a plane.

    Raises
    ------
    UserError
        For a hollow surface, for lengths that do not make a shape, and for a mesh that cannot be
        used.
    """
    if settings.mesh:
        unit = 1e-3 * settings.mesh_unit_mm
        return mesh(settings.mesh, scale=unit, cells=settings.mesh_cells, centred=True)
    if settings.shape == "ball":
        if settings.radius_mm < 0.0:
            raise UserError(
                f"object.radius_mm = {settings.radius_mm:g} must be above 0 on a dome: a hollow "
                "object needs the chain"
            )
        return plane() if math.isinf(settings.radius_mm) else ball(1e-3 * settings.radius_mm)
    lengths = tuple(1e-3 * size for size in settings.size_mm)
    rounding = 1e-3 * settings.rounding_mm
    made: dict[str, Callable[[], Shape]] = {
        "cylinder": lambda: cylinder(lengths[0], lengths[1], rounding),
        "box": lambda: box((lengths[0], lengths[1], lengths[2]), rounding),
        "capsule": lambda: capsule(lengths[0], lengths[1]),
        "torus": lambda: torus(lengths[0], lengths[1]),
        "cone": lambda: cone(lengths[0], lengths[1], rounding),
    }
    return made[settings.shape]()


def build_pose(settings: ObjectSettings) -> Array:
    """Pose of the object at the start, as in `Motion.poses` [m, rad], shape (6,)."""
    x, y = (1e-3 * value for value in settings.beside_mm)
    return np.array([x, y, 0.0, *np.radians(settings.turned_deg)])
