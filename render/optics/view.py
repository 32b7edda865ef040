"""A camera at its place in the sensor, looking through the surface of the clear silicone."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .camera import Camera, projected
from .projection_kernels import Port, apparent_points

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class View:
    """Camera on the sensor's axis, in air; markers and skin lie in silicone behind its port.

    A camera at the centre of a spherical port sees no refraction, whatever the index.

    Attributes
    ----------
    camera: camera, which looks along +z
    position: height of the camera on the axis of the sensor frame [m]
    port: radius of the spherical hollow around the origin, or height of a flat port [m]
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

    @cached_property
    def surface(self) -> Port:
        """Parameters of the compiled projection."""
        return Port(
            position=float(self.position),
            size=float(self.port),
            flat=self.flat,
            refraction=float(self.index),
            bends=self.bends,
        )

    def project(self, points: Array) -> Array:
        """Project points (…, 3) of the sensor frame [m] to pixels (…, 2)."""
        return projected(points, self.surface, self.camera.lens)

    def jacobian(self, points: Array) -> Array:
        """Derivative of `project` with respect to the point [px/m], shape (…, 2, 3)."""
        if not self.bends:
            return self.camera.jacobian(self._apparent(points))
        nudge = 1e-7  # half the distance over which refraction is differentiated [m]
        slope = [
            (self._apparent(points + h) - self._apparent(points - h)) / (2 * nudge)
            for h in nudge * np.eye(3)
        ]
        return self.camera.jacobian(self._apparent(points)) @ np.stack(slope, axis=-1)

    def trace(self, pixels: Array) -> tuple[Array, Array]:
        """Trace pixels (…, 2) into the silicone: a point of each ray, its unit direction (…, 3)."""
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
        """Apparent positions (…, 3) of points relative to the camera [m], see `apparent`."""
        flat = np.ascontiguousarray(points, dtype=float).reshape(-1, 3)
        out = np.empty_like(flat)
        apparent_points(flat, self.surface, out)
        return out.reshape(np.shape(points))


def sphere_distance(start: Array, ray: Array, radius: float) -> Array:
    """Distance to a sphere around the origin, along unit rays from points inside it [m], (…)."""
    half = (start * ray).sum(axis=-1)
    return np.sqrt(half**2 + radius**2 - (start**2).sum(axis=-1)) - half
