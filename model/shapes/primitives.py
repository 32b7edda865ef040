"""Shapes whose distance is a formula; every length in m."""

import math

import numpy as np

from ...errors import UserError
from ..checks import finite, within
from ..kernels.dome import distance_kernels as kernels
from .shape import Shape, make_shape

#: Smallest and largest length of a shape [m].
SMALLEST = 1e-5
LARGEST = 10.0


def plane() -> Shape:
    """A plane; the object fills z > 0."""
    return make_shape(
        "plane",
        kernels.PLANE,
        bounds=[[-np.inf, -np.inf, 0.0], [np.inf, np.inf, np.inf]],
    )


def ball(radius: float) -> Shape:
    """A ball around the origin [m]."""
    within("radius of a ball", radius, "m", SMALLEST, LARGEST)
    return make_shape("ball", kernels.BALL, [radius])


def cylinder(radius: float, length: float = math.inf, rounding: float = 0.0) -> Shape:
    """A cylinder along y around the origin.

    Parameters
    ----------
    radius: from the axis [m]
    length: from end to end [m]; infinite has no ends
    rounding: radius of the rims [m]
    """
    within("radius of a cylinder", radius, "m", SMALLEST, LARGEST)
    if length != math.inf:
        within("length of a cylinder", length, "m", SMALLEST, LARGEST)
    _round("cylinder", rounding, min(radius, length / 2))
    return make_shape("cylinder", kernels.CYLINDER, [radius, length / 2, rounding])


def box(size: float | tuple[float, float, float], rounding: float = 0.0) -> Shape:
    """A box around the origin with rounded edges.

    Parameters
    ----------
    size: edges along x, y and z [m]; one number is a cube
    rounding: radius of its edges and corners [m]
    """
    edges = (size,) * 3 if isinstance(size, int | float) else tuple(size)
    if len(edges) != 3:
        raise UserError(f"size of a box must be one edge or three, got {size!r}")
    for edge in edges:
        within("edge of a box", edge, "m", SMALLEST, LARGEST)
    _round("box", rounding, min(edges) / 2)
    return make_shape("box", kernels.BOX, [*(edge / 2 - rounding for edge in edges), rounding])


def capsule(radius: float, length: float) -> Shape:
    """A capsule along y around the origin: a cylinder with half balls as its ends.

    Parameters
    ----------
    radius: from the axis [m]
    length: from end to end, the half balls included [m]
    """
    within("radius of a capsule", radius, "m", SMALLEST, LARGEST)
    within("length of a capsule", length, "m", 2 * radius, LARGEST)
    return make_shape("capsule", kernels.CAPSULE, [radius, length / 2 - radius])


def torus(ring: float, tube: float) -> Shape:
    """A torus around the axis y, so that its rim is lowest.

    Parameters
    ----------
    ring: radius of the circle that the tube follows [m]
    tube: radius of the tube [m]
    """
    within("ring of a torus", ring, "m", SMALLEST, LARGEST)
    finite("tube of a torus", tube, "m", above=0.0, below=ring)
    return make_shape("torus", kernels.TORUS, [ring, tube])


def cone(radius: float, height: float, rounding: float = 0.0) -> Shape:
    """A cone around the axis z whose tip points to −z.

    Its origin is halfway between the base and the tip that it would have without rounding.

    Parameters
    ----------
    radius: of the base [m]
    height: from the tip to the base, both without rounding [m]
    rounding: radius of the tip and of the rim [m]
    """
    within("radius of a cone", radius, "m", SMALLEST, LARGEST)
    within("height of a cone", height, "m", SMALLEST, LARGEST)
    slant = math.hypot(radius, height)
    _round("cone", rounding, 0.999 * radius * height / (radius + slant))
    tip = rounding * slant / radius - height / 2
    base = height / 2 - rounding
    return make_shape("cone", kernels.CONE, [tip, base, (base - tip) * radius / height, rounding])


def _round(name: str, rounding: float, most: float) -> None:
    """Refuse a rounding that leaves no inner shape; the most is the largest ball that fits in."""
    within(f"rounding of a {name}", rounding, "m", 0.0, most)


def quadric(along_x: float, along_y: float, mixed: float = 0.0) -> Shape:
    """A surface of two curvatures that fills z > 0 about the origin, where it touches z = 0.

    Ball, rod along an axis and plane are exact; other distances are so to second order. Where both
    curvatures are negative it is a hollow.

    Parameters
    ----------
    along_x, along_y: curvature along each axis, positive where the surface bulges to −z [1/m]
    mixed: off-diagonal element of the matrix of curvatures [1/m]
    """
    largest = 1.0 / SMALLEST
    for name, value in (("along x", along_x), ("along y", along_y), ("mixed", mixed)):
        within(f"curvature {name} of a quadric", value, "1/m", -largest, largest)
    return make_shape(
        "quadric",
        kernels.QUADRIC,
        [along_x, mixed, along_y, _strongest(along_x, along_y, mixed)],
        bounds=[[-np.inf, -np.inf, -np.inf], [np.inf, np.inf, np.inf]],
    )


def _strongest(along_x: float, along_y: float, mixed: float) -> float:
    """The principal curvature of larger size: along z it closes a ball and a rod exactly."""
    mean, half = 0.5 * (along_x + along_y), math.hypot(0.5 * (along_x - along_y), mixed)
    return mean + half if mean >= 0.0 else mean - half
