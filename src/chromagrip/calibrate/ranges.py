"""Ranges of the contacts and specimens that a read-out is trained on, and random ones out of them.

They are wider than those of use, so that no use lies at an edge of the training. An object's
friction law and drag vary too: they belong to the object, and no estimator knows them.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..model import REFERENCE_NODES, ContactObject, Fingertip

Array = NDArray[np.float64]
Range = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Ranges:
    """Smallest and largest value of what varies in the training; unless said, evenly in between.

    Attributes
    ----------
    friction: µ, in most objects within `usual_friction`
    stiffness_n_per_m: k_c per node, in logarithm, in most objects within
        `usual_stiffness_n_per_m`
    curvature_per_m: 1/radius of hollow (below 0) and round objects
    tilt_deg: slope of objects that have one
    height_mm, width_mm: of bumps and grooves, standard deviation along x, in logarithm
    contacts_apart_mm: distance of the tops of two ridges
    ridges_mm: their height, in logarithm
    bump_curvature_per_m: largest curvature of the top of a bump or ridge
    dahl_stiffness_n_per_m: σ0 per node, in logarithm
    coulomb_stiffness_n_per_m: σ0 of the few objects without a Dahl law: their bristles move by less
        than a micrometre
    dahl_exponent: n, in logarithm
    drag_n_s_per_m: of the object, in logarithm
    grip_n: in most histories within `usual_grip_n`; soft and sharp objects end before, where the
        fingertip would go through them
    slides_by_n: largest load above the friction limit
    slides_at_mm_per_s: speed of the object at which it slides for long, in logarithm
    grip_step: factor by which a controller grips harder at once, in logarithm
    tremble: standard deviation of a grip that trembles over its mean, in logarithm
    membrane: stiffness of membrane over tissue, over nominal; most specimens are near the middle
    coupling: Poisson factors over nominal; most specimens are near the middle
    damping: dampers of the nodes over nominal, in logarithm. Forces of fast motion are in no single
        image, and grips of half a second move faster than those of use
    """

    friction: Range = (0.1, 1.5)
    usual_friction: Range = (0.15, 1.0)
    stiffness_n_per_m: Range = (1.0, 1200.0)
    usual_stiffness_n_per_m: Range = (40.0, 1200.0)
    curvature_per_m: Range = (-60.0, 1e3 / 3.0)
    tilt_deg: Range = (-12.0, 12.0)
    height_mm: Range = (0.1, 1.2)
    width_mm: Range = (0.5, 3.0)
    contacts_apart_mm: Range = (1.5, 6.5)
    ridges_mm: Range = (0.2, 1.6)
    bump_curvature_per_m: float = 2500.0
    dahl_stiffness_n_per_m: Range = (300.0, 1e4)
    coulomb_stiffness_n_per_m: float = 1e5
    dahl_exponent: Range = (0.5, 2.0)
    drag_n_s_per_m: Range = (20.0, 400.0)
    grip_n: Range = (0.03, 16.0)
    usual_grip_n: Range = (0.3, 7.0)
    slides_by_n: float = 0.5
    slides_at_mm_per_s: Range = (0.2, 10.0)
    grip_step: Range = (1.3, 6.0)
    tremble: Range = (0.003, 0.4)
    membrane: Range = (0.85, 1.15)
    coupling: Range = (0.8, 1.2)
    damping: Range = (0.01, 0.2)


#: Of every training.
RANGES = Ranges()
#: Shapes of objects, each with its share.
SHAPES = {
    "flat": 0.16,
    "round": 0.49,
    "hollow": 0.05,
    "tilted": 0.09,
    "bump": 0.08,
    "groove": 0.05,
    "two": 0.08,
}
#: … and of any other object, as a share of the fingertip's radius.
_INDENTED = 0.5


class Contact(NamedTuple):
    """An object, and what a drive must know of it."""

    obj: ContactObject
    shape: str
    tilt: float  # slope of the surface where it is gripped [rad]
    largest: float  # grip that it carries [N]


def evenly(rng: np.random.Generator, limits: Range) -> float:
    """Number of a range, each as likely."""
    return float(rng.uniform(*limits))


def by_factor(rng: np.random.Generator, limits: Range) -> float:
    """Number of a range, each factor as likely."""
    return float(np.exp(rng.uniform(*np.log(limits))))


def random_specimen(rng: np.random.Generator, nominal: Fingertip) -> Fingertip:
    """Fingertip of other proportions.

    One whose membrane and tissue are stiffer by the same factor shows the same pictures under
    forces larger by it, so that it needs no histories of its own.
    """
    coupling = _near_middle(rng, RANGES.coupling)
    return replace(
        nominal,
        membrane_stiffness=nominal.membrane_stiffness * _near_middle(rng, RANGES.membrane),
        damping_node=nominal.damping_node * by_factor(rng, RANGES.damping),
        poisson_tissue=min(nominal.poisson_tissue * coupling, 0.5),
        poisson_membrane=min(nominal.poisson_membrane * coupling, 0.5),
    )


def _near_middle(rng: np.random.Generator, limits: Range) -> float:
    """Normal deviate whose third standard deviation lies at the limits, within these."""
    low, high = limits
    value = rng.normal((low + high) / 2.0, (high - low) / 6.0)
    return float(np.clip(value, low, high))


def random_contact(rng: np.random.Generator, fingertip: Fingertip) -> Contact:
    """Object of any shape, from soft to stiff, from slippery to rough."""
    r = RANGES
    shape = str(rng.choice(list(SHAPES), p=list(SHAPES.values())))
    # Share of the objects whose µ, and whose k_c, is within the usual range.
    usual_shares = (0.65, 0.75)
    usual = rng.random(2) < usual_shares
    coulomb_share = 0.04  # share of the objects without a Dahl law
    coulomb = rng.random() < coulomb_share
    bristle = by_factor(rng, r.dahl_stiffness_n_per_m)
    material = ContactObject(
        stiffness=by_factor(rng, r.usual_stiffness_n_per_m if usual[1] else r.stiffness_n_per_m),
        friction=evenly(rng, r.usual_friction if usual[0] else r.friction),
        dahl_stiffness=r.coulomb_stiffness_n_per_m if coulomb else bristle,
        dahl_exponent=by_factor(rng, r.dahl_exponent),
        drag=by_factor(rng, r.drag_n_s_per_m),
    )
    room = _INDENTED * fingertip.radius
    half_width = 1.75  # half width of a profile, in radii of the fingertip
    point_distance = 0.2e-3  # distance of its points [m]
    hollowest = 0.5  # largest curvature of hollow objects, over that of the fingertip
    if shape in ("flat", "round", "hollow"):
        low, high = r.curvature_per_m
        low = max(low, -hollowest / fingertip.radius)
        limits = {"flat": (0.0, 0.0), "round": (0.0, high), "hollow": (low, 0.0)}[shape]
        curvature, tilt = evenly(rng, limits), 0.0
        obj = replace(material, curvature=curvature)
    else:
        surface, tilt, curvature, room = _surface(rng, shape, fingertip.radius)
        half = half_width * fingertip.radius
        x = np.linspace(-half, half, 1 + round(2 * half / point_distance))
        if shape == "tilted":
            x = np.array([-half, 0.0, half])
        obj = replace(material, profile=tuple(zip(x.tolist(), surface(x).tolist(), strict=True)))
    return Contact(obj, shape, tilt, largest_grip(fingertip, obj.stiffness, curvature, room))


class _Surface(NamedTuple):
    """Height at x [m], tilt [rad], largest curvature [1/m], and largest depth of a press [m]."""

    height: Callable[[Array], Array]
    tilt: float
    curvature: float
    room: float


def _surface(rng: np.random.Generator, shape: str, radius: float) -> _Surface:
    """Surface of an object that is not round, for a fingertip of that radius [m]."""
    r = RANGES
    tilt = np.deg2rad(evenly(rng, r.tilt_deg))
    if shape == "tilted":
        return _Surface(lambda x: np.tan(tilt) * x, tilt, 0.0, _INDENTED * radius)
    tilt *= rng.random() < 0.3  # else a bump is on a level surface
    two = shape == "two"
    height = 1e-3 * by_factor(rng, r.ridges_mm if two else r.height_mm)
    width = 1e-3 * by_factor(rng, r.width_mm)
    middle, room = rng.normal(0.0, 0.3e-3 if two else 1e-3), _INDENTED * radius
    tops = [middle]
    ridge_widths = (0.12, 0.35)  # width of two ridges, one standard deviation, over their distance
    if two:
        apart = 1e-3 * evenly(rng, r.contacts_apart_mm)
        tops = [middle - apart / 2, middle + apart / 2]
        width = apart * evenly(rng, ridge_widths)
    height = min(height, r.bump_curvature_per_m * width**2)
    two_places = 0.7  # share of such objects that are touched at two places only
    least_room = 0.15e-3  # least depth to which they are pressed [m]
    if two and rng.random() < two_places:  # what is between the ridges is not reached
        room = max(height - (apart / 2) ** 2 / (2.0 * radius), least_room)
    heights = height * (rng.uniform(0.85, 1.0, len(tops)) if two else np.ones(1))
    side = 1.0 if shape == "groove" else -1.0

    def surface(x: Array) -> Array:
        hills: Array = np.exp(-0.5 * ((x[:, None] - tops) / width) ** 2) @ heights
        return np.tan(tilt) * x + side * hills

    # What is sharper than any round object is lower than the skin gives way.
    curvature = 0.0 if shape == "groove" else min(height / width**2, r.curvature_per_m[1])
    return _Surface(surface, tilt, curvature, room)


def largest_grip(fingertip: Fingertip, stiffness: float, curvature: float, room: float) -> float:
    """Grip that an object carries before the fingertip is through it, or half indented [N].

    Object and tissue are springs in series, over the width in which the two circles overlap.
    """
    tissue = fingertip.tissue_stiffness
    # Largest depth, of fingertip and object together, as a share of the radius of a round object:
    # soft ones are pierced at .58, stiff ones later.
    deepest = 0.45
    depth = min(room, deepest / curvature) if curvature > 0.0 else room
    half_width = np.sqrt(2.0 * depth / (1.0 / fingertip.radius + curvature))
    nodes = 2.0 * half_width * (REFERENCE_NODES - 1) / fingertip.arc_lengths()[-1]
    in_series = tissue * stiffness / (tissue + stiffness)
    return float(min(2.0 / 3.0 * nodes * depth * in_series, RANGES.grip_n[1]))
