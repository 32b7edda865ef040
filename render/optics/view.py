"""A camera at its place in the sensor, looking through the surface of the clear silicone."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .camera import Camera

Array = NDArray[np.float64]

_ROUNDS = 12
_NUDGE = 1e-7


@dataclass(frozen=True, kw_only=True)
class View:
    """Camera on the sensor's axis, in air; markers and skin lie in silicone behind its port.

    Seen from the centre of a hollow ball the port bends no ray, whatever the index.

    Attributes
    ----------
    camera: looks along +z
    position: of the camera on the axis of the sensor frame [m]
    port: radius of the hollow around the origin; of a flat port its height on the axis [m]
    flat: whether the port is a plane
    index: refractive index of the silicone
    """

    camera: Camera
    position: float
    port: float
    flat: bool
    index: float

    @property
    def width(self) -> int:
        """Image width [px]."""
        return self.camera.width

    @property
    def height(self) -> int:
        """Image height [px]."""
        return self.camera.height

    @property
    def bends(self) -> bool:
        """Whether refraction changes the image."""
        return self.index != 1.0 and (self.flat or self.position != 0.0)

    def project(self, points: Array) -> Array:
        """Pixels (…, 2) of points (…, 3) in the sensor frame [m]."""
        return self.camera.project(self._apparent(points))

    def jacobian(self, points: Array) -> Array:
        """Derivative of `project` [px/m], shape (…, 2, 3)."""
        if not self.bends:
            return self.camera.jacobian(self._apparent(points))
        slope = [
            (self._apparent(points + h) - self._apparent(points - h)) / (2 * _NUDGE)
            for h in _NUDGE * np.eye(3)
        ]
        return self.camera.jacobian(self._apparent(points)) @ np.stack(slope, axis=-1)

    def trace(self, pixels: Array) -> tuple[Array, Array]:
        """Rays seen at pixels (…, 2), inside the silicone: a point and a unit direction, (…, 3)."""
        ray = self.camera.rays(pixels)
        start = np.broadcast_to([0.0, 0.0, self.position], ray.shape)
        if not self.bends:
            return start, ray
        if self.flat:
            reach = (self.port - self.position) / ray[..., 2]
            normal = np.broadcast_to([0.0, 0.0, 1.0], ray.shape)
        else:
            reach = sphere_distance(start, ray, self.port)
            normal = (start + reach[..., None] * ray) / self.port
        cos = (ray * normal).sum(axis=-1, keepdims=True)
        # Snell's law; from air into silicone no ray is turned back.
        inside = ray + (np.sqrt(self.index**2 - 1.0 + cos**2) - cos) * normal
        return start + reach[..., None] * ray, inside / self.index

    def _apparent(self, points: Array) -> Array:
        """Where the camera sees points (…, 3), from itself: bent rays drawn out straight [m]."""
        if self.position == 0.0 and not self.bends:
            return points
        straight = points - np.array([0.0, 0.0, self.position])
        if not self.bends:
            return straight
        # In the plane of the ray and the axis: Fermat's shortest path over the port's points q.
        rho, z = np.hypot(points[..., 0], points[..., 1]), points[..., 2]
        distance = np.hypot(rho, straight[..., 2])
        along, up = rho / distance, straight[..., 2] / distance
        if self.flat:
            place = along / up * (self.port - self.position)
        else:
            reach = sphere_distance(
                np.stack([np.zeros_like(z), np.full_like(z, self.position)], axis=-1),
                np.stack([along, up], axis=-1),
                self.port,
            )
            place = np.arctan2(reach * along, self.position + reach * up)
        for _ in range(_ROUNDS):
            q, tangent, curve = self._port(place)
            before = q - np.array([0.0, self.position])
            after = q - np.stack([rho, z], axis=-1)
            slope, bend = 0.0, 0.0
            for leg, n in ((before, 1.0), (after, self.index)):
                length = np.linalg.norm(leg, axis=-1)
                part = (leg * tangent).sum(axis=-1) / length
                slope = slope + n * part
                bend = bend + n * (
                    ((tangent**2).sum(axis=-1) - part**2 + (leg * curve).sum(axis=-1)) / length
                )
            place = place - slope / bend
        q, _, _ = self._port(place)
        seen = q - np.array([0.0, self.position])
        seen *= (distance / np.linalg.norm(seen, axis=-1))[..., None]
        share = seen[..., 0] / np.where(rho > 0.0, rho, 1.0)
        return np.concatenate([share[..., None] * points[..., :2], seen[..., 1:]], axis=-1)

    def _port(self, place: Array) -> tuple[Array, Array, Array]:
        """Point (ρ, z) of the port at a place along it, and its two derivatives, (…, 2)."""
        zero = np.zeros_like(place)
        if self.flat:
            ones = zero + 1.0
            return (
                np.stack([place, zero + self.port], axis=-1),
                np.stack([ones, zero], axis=-1),
                np.stack([zero, zero], axis=-1),
            )
        q = self.port * np.stack([np.sin(place), np.cos(place)], axis=-1)
        return q, np.stack([q[..., 1], -q[..., 0]], axis=-1), -q


def sphere_distance(start: Array, ray: Array, radius: float) -> Array:
    """Distance along unit rays from points inside a sphere around the origin to it [m], (…)."""
    half = (start * ray).sum(axis=-1)
    return np.sqrt(half**2 + radius**2 - (start**2).sum(axis=-1)) - half
