"""Silicone body of a fingertip, a dome or a flat pad: shape, material and nodes of the skin."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray

from ..checks import finite, within

Array = NDArray[np.float64]

#: The golden angle [rad]; each ring of nodes is turned by it, so that no two rings line up.
GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))


@dataclass(frozen=True, kw_only=True)
class Dome:
    """Half sphere of silicone that is bonded to a rigid core and to a base below it.

    Attributes
    ----------
    radius: radius of the skin [m]
    core: radius of the rigid core [m]
    young, poisson: Young's modulus [Pa] and Poisson's ratio of the silicone
    pitch: distance between neighbouring nodes of the skin [m] (default: a twentieth of the radius)
    reach: angle from the apex up to which the skin has nodes, and can touch an object [rad]
    relaxation: time constant of Kelvin–Voigt viscosity [s]; 0: elastic
    stiffening: whether the skin stiffens as it is pressed towards the core
    """

    radius: float = 8e-3
    core: float = 6e-3
    young: float = 0.4e6
    poisson: float = 0.48
    pitch: float | None = None
    reach: float = math.radians(80.0)
    relaxation: float = 0.0
    stiffening: bool = True

    #: Name of the kind of body, and whether its elasticity is known in closed form.
    kind: ClassVar[Literal["dome"]] = "dome"
    closed_form: ClassVar[bool] = False

    def __post_init__(self) -> None:
        finite("dome radius", self.radius, "m", above=0.0, below=1.0)
        finite("Young's modulus of the dome", self.young, "Pa", above=0.0)
        within("Poisson's ratio of the dome", self.poisson, "", 0.0, 0.495)
        within("dome core", self.core / self.radius, "of the radius", 0.05, 0.97)
        within("dome reach", math.degrees(self.reach), "°", 20.0, 85.0)
        within("dome relaxation", self.relaxation, "s", 0.0, 10.0)
        if self.pitch is not None:
            within("dome pitch", self.pitch / self.radius, "of the radius", 1 / 60, 1 / 8)

    @property
    def thickness(self) -> float:
        """Thickness of the silicone [m]."""
        return self.radius - self.core

    @property
    def spacing(self) -> float:
        """Distance between neighbouring nodes [m]."""
        pitch_share = 1 / 20  # default pitch as a share of the radius
        return self.radius * pitch_share if self.pitch is None else self.pitch

    @property
    def stride(self) -> float:
        """Longest step of a free object: a longer one could pass through the silicone [m]."""
        stride_share = 0.2  # longest allowed step of a free object, as a share of a dome's radius
        return stride_share * self.radius

    @property
    def slenderness(self) -> float:
        """Thickness over radius, for the law of stiffening."""
        return self.thickness / self.radius

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return len(lattice(self).ring)

    def with_thickness(self, thickness: float) -> Self:
        """Copy with another thickness of the silicone [m]."""
        within("thickness of the dome", thickness / self.radius, "of the radius", 0.03, 0.95)
        return replace(self, core=self.radius - thickness)

    @property
    def end(self) -> float:
        """Angle from the apex at which the skin is fixed: the equator [rad]."""
        return math.pi / 2

    def places(self, pitch: float) -> Array:
        """Points of the skin one pitch [m] apart: angle from the apex and azimuth [rad], (N, 2)."""
        return lattice(replace(self, pitch=pitch)).places

    def onto(self, points: Array) -> Array:
        """Project points (P, 3) near the skin onto it, along its normal."""
        return points * (self.radius / np.linalg.norm(points, axis=1, keepdims=True))

    def new_lattice(self) -> "Lattice":
        """Nodes of the skin, on the sphere."""
        step = self.spacing / self.radius
        angles = _middles(self.reach, step)
        ring, azimuth = _around(np.sin(angles), step)
        theta = angles[ring]
        directions = np.stack(
            [np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)],
            axis=1,
        )
        zones = 2.0 * np.pi * (np.cos(angles - step / 2) - np.cos(angles + step / 2))
        points = self.radius * directions
        return Lattice(
            angles=angles,
            ring=ring,
            azimuth=azimuth,
            points=points,
            outwards=points / self.radius,
            areas=(self.radius**2 * zones / np.bincount(ring))[ring],
        )


@dataclass(frozen=True, kw_only=True)
class Pad:
    """Flat layer of silicone that is bonded to a rigid base, its skin in the plane z = 0.

    The modelled silicone continues outside the sides of the pad. This hardly changes a contact four
    thicknesses from a side or farther.

    Attributes
    ----------
    radius: half of the side, and radius of the disc on which the skin has nodes and can touch [m]
    thickness: thickness of the silicone [m]
    young, poisson, relaxation, stiffening: see `Dome`
    pitch: distance between neighbouring nodes of the skin [m] (default: a 32nd of `radius`)
    """

    radius: float = 18e-3
    thickness: float = 2.2e-3
    young: float = 0.4e6
    poisson: float = 0.48
    pitch: float | None = None
    relaxation: float = 0.0
    stiffening: bool = True

    kind: ClassVar[Literal["pad"]] = "pad"
    closed_form: ClassVar[bool] = True

    def __post_init__(self) -> None:
        finite("half of the pad's side", self.radius, "m", above=0.0, below=1.0)
        finite("Young's modulus of the pad", self.young, "Pa", above=0.0)
        within("Poisson's ratio of the pad", self.poisson, "", 0.0, 0.495)
        within("thickness of the pad", self.thickness / self.radius, "of half its side", 0.02, 1.0)
        within("pad relaxation", self.relaxation, "s", 0.0, 10.0)
        if self.pitch is not None:
            within("pad pitch", self.pitch / self.radius, "of half its side", 1 / 60, 1 / 8)

    @property
    def spacing(self) -> float:
        """Distance between neighbouring nodes [m]."""
        pitch_share = 1 / 32  # default pitch as a share of the radius
        return self.radius * pitch_share if self.pitch is None else self.pitch

    @property
    def stride(self) -> float:
        """Longest step of a free object, see `Dome` [m]."""
        return 0.8 * self.thickness

    @property
    def slenderness(self) -> float:
        """Thickness over radius of a thin dome, whose law of stiffening is used for a pad."""
        flat = 0.05  # thickness over radius of the dome whose law of stiffening is used for a pad
        return flat

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return len(lattice(self).ring)

    def with_thickness(self, thickness: float) -> Self:
        """Copy with another thickness of the silicone [m]."""
        return replace(self, thickness=thickness)

    @property
    def end(self) -> float:
        """Radius from which on the skin is assumed fixed: a circle outside the corners [m]."""
        # Radius of the circle around a pad outside of which the skin does not move, over half its
        # side.
        far = 2.0
        return far * self.radius

    def places(self, pitch: float) -> Array:
        """Points one pitch [m] apart: distance from the middle [m] and azimuth [rad], (N, 2).

        They extend to the corners, where the skin has no nodes.
        """
        rings = _middles(math.sqrt(2.0) * self.radius + pitch, pitch)
        ring, azimuth = _around(rings, pitch)
        way = rings[ring]
        plane = way[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
        inside = (abs(plane) < self.radius + pitch).all(axis=1)
        return np.column_stack([way, azimuth])[inside]

    def onto(self, points: Array) -> Array:
        """Project points (P, 3) onto the disc of nodes."""
        off = np.linalg.norm(points[:, :2], axis=1, keepdims=True)
        return points * (np.minimum(1.0, self.radius / np.maximum(off, 1e-12)) * [1.0, 1.0, 0.0])

    def new_lattice(self) -> "Lattice":
        """Nodes of the skin, on a disc."""
        rings = _middles(self.radius, self.spacing)
        ring, azimuth = _around(rings, self.spacing)
        rho = rings[ring]
        return Lattice(
            angles=rings,
            ring=ring,
            azimuth=azimuth,
            points=np.stack([rho * np.cos(azimuth), rho * np.sin(azimuth), 0.0 * rho], axis=1),
            outwards=np.tile([0.0, 0.0, 1.0], (len(ring), 1)),
            areas=(2.0 * np.pi * rings * self.spacing / np.bincount(ring))[ring],
        )


#: Silicone in three dimensions.
SoftBody = Dome | Pad


@dataclass(frozen=True, kw_only=True)
class Lattice:
    """N nodes of the skin on K rings about the axis, with threefold rotational symmetry.

    Attributes
    ----------
    angles: coordinate of each ring, shape (K,): its angle from the apex of a dome [rad], or its
        distance from the middle of a pad [m]
    ring: index of each node's ring, shape (N,)
    azimuth: azimuth of each node [rad], shape (N,)
    points: positions of the nodes relative to the centre of the sphere or the middle of the pad's
        skin [m], shape (N, 3)
    outwards: outward unit normals of the skin, shape (N, 3)
    areas: area of the skin that belongs to each node [m²], shape (N,)
    """

    angles: Array
    ring: NDArray[np.int64]
    azimuth: Array
    points: Array
    outwards: Array
    areas: Array

    @property
    def places(self) -> Array:
        """Coordinates of the nodes on the skin: that of the ring, and azimuth [rad], (N, 2)."""
        return np.column_stack([self.angles[self.ring], self.azimuth])


@lru_cache(maxsize=8)
def lattice(body: SoftBody) -> Lattice:
    """Nodes of a body, about one pitch apart; cached and read-only."""
    values = body.new_lattice()
    for array in vars(values).values():
        array.setflags(write=False)
    return values


def _middles(reach: float, step: float) -> Array:
    """Coordinates of rings one step apart, the first half a step from the middle."""
    return np.asarray((np.arange(int(reach / step)) + 0.5) * step, np.float64)


def _around(lengths: Array, step: float) -> tuple[NDArray[np.int64], Array]:
    """Ring and azimuth of nodes about one step apart, on rings with circumferences 2π·lengths."""
    counts = 3 * np.maximum(1, np.rint(2.0 * np.pi * lengths / (3.0 * step))).astype(int)
    azimuth = np.concatenate(
        [(GOLDEN_ANGLE * k + 2.0 * np.pi * np.arange(n) / n) for k, n in enumerate(counts)]
    ) % (2.0 * np.pi)
    return np.repeat(np.arange(len(lengths)), counts), azimuth
