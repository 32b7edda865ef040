"""The sensor's resting shape: a dome or a flat pad, and the places of its points.

A place is (θ, φ) on a dome, θ from the apex and φ from the load [rad]; on a pad it is (ρ, φ), ρ the
distance from the middle [m]. A chain of nodes crosses the skin at signed first coordinates.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..optics.view import sphere_distance

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class DomeSkin:
    """Half ball around the origin, apex on +z.

    Attributes
    ----------
    radius: radius of the outer skin [m]
    rim: angle from the apex at which the housing begins [rad]
    """

    radius: float
    rim: float = np.pi / 2
    flat = False

    @property
    def half(self) -> float:
        """Place of the equator, where the skin ends [rad]."""
        return np.pi / 2

    def points(self, places: Array, depth: float) -> Array:
        """Points (…, 3) at places (…, 2), `depth` under the skin [m]."""
        theta, phi = places[..., 0], places[..., 1]
        sin = np.sin(theta)
        return (self.radius - depth) * np.stack(
            [sin * np.cos(phi), sin * np.sin(phi), np.cos(theta)], axis=-1
        )

    def tangents(self, places: Array) -> tuple[Array, Array]:
        """Unit vectors along the first coordinate and along φ, each (…, 3)."""
        theta, phi = places[..., 0], places[..., 1]
        cos, sin, zero = np.cos(phi), np.sin(phi), np.zeros_like(phi)
        along = np.stack([np.cos(theta) * cos, np.cos(theta) * sin, -np.sin(theta)], axis=-1)
        return along, np.stack([-sin, cos, zero], axis=-1)

    def metric(self, depth: float) -> float:
        """Length of a unit of the first coordinate [m]."""
        return self.radius - depth

    def ring(self, first: Array) -> Array:
        """Length of a unit of φ over that of the first coordinate."""
        return np.sin(first)

    def meet(self, start: Array, ray: Array, depth: float) -> Array:
        """Places (…, 2) at which rays from inside meet the layer; NaN if they do not."""
        return self.places_of(
            start + sphere_distance(start, ray, self.radius - depth)[..., None] * ray
        )

    def places_of(self, points: Array) -> Array:
        """Places (…, 2) of points (…, 3): those straight above them on the skin."""
        x, y, z = np.moveaxis(points, -1, 0)
        return np.stack([np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)], axis=-1)

    def rim_distance(self, places: Array) -> Array:
        """Distance from the edge of the skin along it, positive inside [m], (…)."""
        return (self.rim - places[..., 0]) * self.radius


@dataclass(frozen=True, kw_only=True)
class PadSkin:
    """Flat square pad, its skin in the plane z = 0, the camera below it.

    Attributes
    ----------
    radius: half of the pad's side [m]
    """

    radius: float
    flat = True

    @property
    def half(self) -> float:
        """Place of the edge's middle [m]."""
        return self.radius

    @property
    def rim(self) -> float:
        """Place of the edge's middle, because no housing covers the pad [m]."""
        return self.radius

    def points(self, places: Array, depth: float) -> Array:
        """Points (…, 3) at places (…, 2), `depth` under the skin [m]."""
        rho, phi = places[..., 0], places[..., 1]
        return np.stack([rho * np.cos(phi), rho * np.sin(phi), np.full_like(rho, -depth)], axis=-1)

    def tangents(self, places: Array) -> tuple[Array, Array]:
        """Unit vectors along the first coordinate and along φ, each (…, 3)."""
        cos, sin, zero = np.cos(places[..., 1]), np.sin(places[..., 1]), np.zeros(places.shape[:-1])
        return np.stack([cos, sin, zero], axis=-1), np.stack([-sin, cos, zero], axis=-1)

    def metric(self, depth: float) -> float:
        """Length of a unit of the first coordinate [m]."""
        return 1.0

    def ring(self, first: Array) -> Array:
        """Length of a unit of φ over that of the first coordinate."""
        return first

    def meet(self, start: Array, ray: Array, depth: float) -> Array:
        """Places (…, 2) at which rays from below meet the layer; NaN if they do not."""
        up = np.where(ray[..., 2] > 0.0, ray[..., 2], np.nan)
        return self.places_of(start + ((-depth - start[..., 2]) / up)[..., None] * ray)

    def places_of(self, points: Array) -> Array:
        """Places (…, 2) of points (…, 3): those straight above them on the skin."""
        x, y, _ = np.moveaxis(points, -1, 0)
        return np.stack([np.hypot(x, y), np.arctan2(y, x)], axis=-1)

    def rim_distance(self, places: Array) -> Array:
        """Distance from the edge of the skin along it, positive inside [m], (…)."""
        rho, phi = places[..., 0], places[..., 1]
        return self.radius - rho * np.maximum(abs(np.cos(phi)), abs(np.sin(phi)))


Skin = DomeSkin | PadSkin
