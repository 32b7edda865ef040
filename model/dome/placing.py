"""Placing of an object so that it just touches the silicone."""

import numpy as np
import scipy
from numpy.typing import NDArray

from ...errors import UserError
from ..kernels.dome.turn_kernels import turned
from ..shapes import distances
from .dome import SoftBody, lattice
from .solid import Solid

Array = NDArray[np.float64]


def rotation_of(pose: Array) -> Array:
    """Rotation matrix (3, 3) of a pose (6,), from the object's own frame to the world's."""
    return turned(np.eye(3), np.ascontiguousarray(pose[3:]))


def touching_place(
    dome: SoftBody, solid: Solid, rotation: Array, beside: tuple[float, float] = (0.0, 0.0)
) -> Array:
    """Position of an object's origin at which it just touches the skin from above [m], shape (3,).

    Parameters
    ----------
    rotation: rotation matrix from the object's own frame to the world's, shape (3, 3)
    beside: offset of the origin from the axis, along x and y [m]

    Raises
    ------
    UserError: when the object cannot lie on the skin
    """
    points = lattice(dome).points

    # Points about one, on which the nearest of the skin is looked for.
    offsets = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 3)] * 3), axis=-1).reshape(-1, 3)
    looks, shrink = 32, 0.6  # how often, in steps that shrink by this factor

    def lowest(height: float) -> float:
        """Smallest distance of a point of the skin from the object."""
        place = np.array([*beside, height])
        gap, _ = distances(solid.shape, (points - place) @ rotation)
        nearest, width = points[gap.argmin()], dome.spacing
        least = float(gap.min())
        for _ in range(looks):
            around = dome.onto(nearest + width * offsets)
            gap, _ = distances(solid.shape, (around - place) @ rotation)
            if gap.min() < least:
                nearest, least = around[gap.argmin()], float(gap.min())
            width *= shrink
        return least

    above = 2.0 * dome.radius + max(solid.shape.reach_down(rotation), 0.0)
    height = above
    ways, shortest = 400, 1e-6  # most ways down to the skin, and the shortest [m]
    for _ in range(ways):
        gap = lowest(height)
        if gap <= 0.0:
            return np.array([*beside, scipy.optimize.brentq(lowest, height, above, xtol=1e-10)])
        # A distance is a lower bound, and tells less than the way at edges that a mesh rounds.
        above, height = height, height - max(gap, shortest)
    raise UserError(f"the object {solid.shape.name} does not come to lie on the skin from above")


def rise_beside(
    dome: SoftBody, solid: Solid, rotation: Array, beside: tuple[float, float]
) -> float:
    """Height of an object's origin at touch next to the axis, minus that on the axis [m]."""
    if not any(beside):
        return 0.0
    there = touching_place(dome, solid, rotation, beside)
    return float((there - touching_place(dome, solid, rotation))[2])
