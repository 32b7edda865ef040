"""Compiled geometry of the surface that `objects.py` documents: gap and normal of a point."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit

Array = NDArray[np.float64]


class Contact(NamedTuple):
    """Numbers of one object (SI); per-node values at 251 nodes, scaled by a node's share."""

    stiffness: float
    mu: float
    bristle: float
    exponent: float
    drag: float
    curvature: float
    lift: float  # z of the object's own origin when it just touches the fingertip at rest
    travel: float  # 1 where the surface travels with the object, 0 where it stays
    knots: Array  # (M,) x of the profile; empty for flat and round objects
    pieces: Array  # (M + 1, 4) cubic of each piece in x − its knot, the two straight ends included
    places: Array  # (P,) x on the object where a factor of µ is given; empty where µ is one
    factors: Array  # (P,)


@njit()
def friction_at(contact: Any, x: float) -> float:
    """µ at a place of the surface, x in the object's own frame: straight between those given."""
    places, factors = contact.places, contact.factors
    if places.size == 0:
        return contact.mu
    k = int(np.searchsorted(places, x))
    if k == 0:
        return contact.mu * factors[0]
    if k == places.size:
        return contact.mu * factors[k - 1]
    share = (x - places[k - 1]) / (places[k] - places[k - 1])
    return contact.mu * (factors[k - 1] + share * (factors[k] - factors[k - 1]))


@njit()
def frictions_at(contact: Any, x: Array) -> Array:
    """µ at places (N,) of the surface, x in the object's own frame."""
    mu = np.empty(x.size)
    for i in range(x.size):
        mu[i] = friction_at(contact, x[i])
    return mu


@njit()
def height(knots: Array, pieces: Array, x: float) -> tuple[float, float, float]:
    """Height of the profile over its own origin [m], its slope, and the slope's change [1/m]."""
    k = int(np.searchsorted(knots, x))
    c = pieces[k]
    h = x - knots[max(k - 1, 0)]
    return (
        c[0] + h * (c[1] + h * (c[2] + h * c[3])),
        c[1] + h * (2.0 * c[2] + 3.0 * h * c[3]),
        2.0 * c[2] + 6.0 * h * c[3],
    )


@njit(inline="always")
def contact_frame(
    knots: Array, pieces: Array, curvature: float, x: float, z: float
) -> tuple[float, float, float]:
    """Gap and outward normal (n_x, n_z) at the foot of a point, in the object's own frame.

    It takes parts of a Contact: a tuple of so many arrays handed on at every node costs a fifth of
    a whole step.
    """
    if knots.size:
        return _profile_frame(knots, pieces, x, z)
    if curvature == 0.0:
        return -z, 0.0, -1.0
    radius = 1.0 / curvature  # negative for a hollow, whose centre lies below
    z = z - radius
    distance = np.sqrt(x * x + z * z)
    side = np.sign(radius) / distance
    return np.sign(radius) * distance - radius, x * side, z * side


@njit()
def _profile_frame(knots: Array, pieces: Array, x: float, z: float) -> tuple[float, float, float]:
    """Gap and normal at the nearest point of the profile, by Newton from the point above."""
    foot = x
    level, slope, bend = height(knots, pieces, foot)
    for _ in range(20):
        error = foot - x + (level - z) * slope
        # Away from the surface the curve may bend faster than the distance grows.
        curve = max(1.0 + slope * slope + (level - z) * bend, 0.5)
        foot -= error / curve
        level, slope, bend = height(knots, pieces, foot)
        if abs(error) < 1e-13:
            break
    length = np.sqrt(1.0 + slope * slope)
    n_x, n_z = slope / length, -1.0 / length
    return (x - foot) * n_x + (z - level) * n_z, n_x, n_z


@njit()
def contact_frames(contact: Any, points: Array, object_x: float) -> tuple[Array, Array]:
    """Gap (N,) and object normal (N, 2) of points (N, 2) in the ground frame."""
    gap = np.empty(points.shape[0])
    normal = np.empty(points.shape)
    knots, pieces, curvature = contact.knots, contact.pieces, contact.curvature
    for i in range(points.shape[0]):
        x, z = points[i, 0] - contact.travel * object_x, points[i, 1] - contact.lift
        gap[i], normal[i, 0], normal[i, 1] = contact_frame(knots, pieces, curvature, x, z)
    return gap, normal
