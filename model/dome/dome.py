"""The fingertip as a dome of silicone on a rigid core: its shape, its material and its nodes."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..checks import finite, within

Array = NDArray[np.float64]

#: Pitch of the nodes as a share of the radius, where none is given.
PITCH = 1 / 20
#: The golden angle [rad]; each ring of nodes is turned by it, so that no two rings line up.
GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))


@dataclass(frozen=True, kw_only=True)
class Dome:
    """Half sphere of silicone that is bonded to a rigid core and to a base below it.

    Attributes
    ----------
    radius: of the skin [m]
    core: radius of the rigid core [m]
    young, poisson: Young's modulus [Pa] and Poisson's ratio of the silicone
    pitch: distance between neighbouring nodes of the skin [m]; None is a twentieth of the radius
    reach: angle from the apex up to which the skin has nodes, and may touch an object [rad]
    relaxation: time constant of Kelvin–Voigt viscosity [s]; 0 is elastic
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
        return self.radius * PITCH if self.pitch is None else self.pitch


@dataclass(frozen=True, kw_only=True)
class Lattice:
    """Nodes of the skin on rings about the axis; a third of a turn maps it on itself.

    Attributes
    ----------
    angles: angle of each ring from the apex [rad], shape (K,)
    ring: ring of each node, shape (N,)
    azimuth: of each node [rad], shape (N,)
    points: places of the nodes from the sphere's centre [m], shape (N, 3)
    areas: area of the skin that each node stands for [m²], shape (N,)
    """

    angles: Array
    ring: NDArray[np.int64]
    azimuth: Array
    points: Array
    areas: Array


@lru_cache(maxsize=8)
def lattice(dome: Dome) -> Lattice:
    """Nodes of a dome, about one pitch from each other."""
    step = dome.spacing / dome.radius
    angles = (np.arange(int(dome.reach / step)) + 0.5) * step
    counts = 3 * np.maximum(1, np.rint(2.0 * np.pi * np.sin(angles) / (3.0 * step))).astype(int)
    ring = np.repeat(np.arange(len(angles)), counts)
    azimuth = np.concatenate(
        [(GOLDEN_ANGLE * k + 2.0 * np.pi * np.arange(n) / n) for k, n in enumerate(counts)]
    ) % (2.0 * np.pi)
    theta = angles[ring]
    directions = np.stack(
        [np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], axis=1
    )
    zones = 2.0 * np.pi * (np.cos(angles - step / 2) - np.cos(angles + step / 2))
    values = Lattice(
        angles=np.asarray(angles, np.float64),
        ring=ring,
        azimuth=azimuth,
        points=dome.radius * directions,
        areas=(dome.radius**2 * zones / counts)[ring],
    )
    for array in vars(values).values():
        array.setflags(write=False)
    return values
