"""Parameters of chain and object for the compiled kernels, scaled to the node spacing."""

from functools import lru_cache
from typing import NamedTuple, get_args

import numpy as np
import scipy
from numpy.typing import NDArray

from ...errors import UserError
from ..kernels.contact import Contact
from ..objects import ContactObject
from .fingertip import REFERENCE_NODES, Fingertip, SpringLaw

Array = NDArray[np.float64]


class Chain(NamedTuple):
    """Parameters of a chain of N nodes, in SI units; the rigid part holds the two at the rims."""

    rest: Array  # (N, 2) node positions
    share: Array  # (N,) arc length of a node over that at 251 even nodes
    tissue: Array  # (N,) stiffness of the spring from each node to the rigid part
    membrane: Array  # (N − 1,) stiffness of the spring from each node to the next
    cross_tissue: Array  # (N,) Poisson factor of `tissue`, with the sign of its half
    cross_membrane: Array  # (N − 1,) Poisson factor of `membrane`
    damping: Array  # (N,) damper from each node to ground
    damping_rigid: float  # damper from the rigid part to ground
    law: int  # index in `SpringLaw`


@lru_cache(maxsize=64)
def chain(fingertip: Fingertip) -> Chain:
    """Parameters of a fingertip."""
    rest, share = fingertip.rest_positions(), fingertip.shares()
    arc = fingertip.arc_lengths()
    spacing = np.diff(arc) * ((REFERENCE_NODES - 1) / arc[-1])
    sign = fingertip.poisson_signs()
    return Chain(
        rest=rest,
        share=share,
        tissue=fingertip.tissue_stiffness * share,
        membrane=fingertip.membrane_stiffness / spacing,
        cross_tissue=fingertip.poisson_tissue * sign,
        cross_membrane=fingertip.poisson_membrane * np.sign(sign[1:] + sign[:-1]),
        damping=fingertip.damping_node * share,
        damping_rigid=float(fingertip.damping_rigid),
        law=get_args(SpringLaw).index(fingertip.law),
    )


@lru_cache(maxsize=256)
def contact(fingertip: Fingertip, obj: ContactObject) -> Contact:
    """Parameters of an object, placed so that it just touches the fingertip at rest.

    Raises
    ------
    UserError
        When a hollow is too narrow for the fingertip to enter.
    """
    knots, pieces = _spline(obj.profile)
    bend = np.array([obj.curvature], dtype=float)
    lift = _profile_lift(fingertip, knots, pieces) if len(knots) else lifts(fingertip, bend)[0]
    places, factors = np.array(obj.patches, dtype=float).reshape(-1, 2).T.copy()
    # An integer would compile every kernel again.
    return Contact(
        stiffness=float(obj.stiffness),
        mu=float(obj.friction),
        bristle=float(obj.dahl_stiffness),
        exponent=float(obj.dahl_exponent),
        drag=float(obj.drag),
        curvature=float(obj.curvature),
        lift=float(lift),
        travel=1.0 if obj.surface == "travels" else 0.0,
        knots=knots,
        pieces=pieces,
        places=places,
        factors=factors,
    )


def check_fit(fingertip: Fingertip, obj: ContactObject) -> None:
    """Refuse a hollow object that is too narrow for the fingertip to enter.

    Raises
    ------
    UserError
        With the radius of the hollow and the width of the fingertip.
    """
    contact(fingertip, obj)


def _spline(profile: tuple[tuple[float, float], ...] | None) -> tuple[Array, Array]:
    """Knots and piece coefficients of a cubic spline through the points, straight beyond them."""
    if profile is None:
        return np.empty(0), np.empty((1, 4))
    # Contiguous, as the empty knots are: kernels are compiled once for both.
    x, z = np.array(profile).T.copy()
    curve = scipy.interpolate.CubicSpline(x, z, bc_type="natural")
    pieces = np.zeros((len(x) + 1, 4))
    pieces[1:-1] = curve.c[::-1].T
    for end, place in ((0, x[0]), (-1, x[-1])):
        pieces[end, :2] = curve(place), curve(place, 1)
    return x, pieces


def _profile_lift(fingertip: Fingertip, knots: Array, pieces: Array) -> float:
    """Shift along z at which an object with a profile first touches a node [m]."""
    x, z = fingertip.rest_positions().T
    k = np.searchsorted(knots, x)
    h = x - knots[np.maximum(k - 1, 0)]
    surface = sum(pieces[k, p] * h**p for p in range(4))
    return float((z - surface).max())


def lifts(fingertip: Fingertip, curvature: Array) -> Array:
    """Shifts along z at which flat or round objects first touch a node [m], shape (B,).

    Parameters
    ----------
    curvature: of the objects [1/m], shape (B,)

    Raises
    ------
    UserError
        When a hollow is too narrow for the fingertip to enter.
    """
    x, z = fingertip.rest_positions().T
    wide = abs(x).max()
    flat = curvature == 0.0
    radius = 1.0 / np.where(flat, 1.0, curvature)
    for bend, r in zip(curvature, radius, strict=True):
        if -wide <= r < 0.0:
            raise UserError(
                f"object curvature {bend} 1/m is a hollow of {-r:.4g} m radius, too narrow for a "
                f"fingertip {wide:.4g} m wide to each side: expected a radius above 0 mm, or of "
                f"{-1e3 * wide:.4g} mm or less for a hollow"
            )
    # Python's power is not always rounded as NumPy's square is; each run has had the former.
    square = np.array([r**2 for r in radius.tolist()])
    radius, flat = radius[:, None], flat[:, None]
    under = abs(x) < abs(radius)
    drop = np.sqrt(np.where(under, square[:, None] - x**2, 0.0))
    surface = np.where(flat, 0.0, radius - np.sign(radius) * drop)
    return np.asarray(np.where(under | flat, z - surface, -np.inf).max(axis=1))
