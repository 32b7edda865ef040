"""Both marker layers in space, as the deformed skin carries them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .dome import DomeMap, dome_map
from .layout import unit_vectors
from .sensor import SensorDesign

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Membrane:
    """Marker discs in the sensor frame, layer 0 magenta, layer 1 yellow.

    Attributes
    ----------
    centres: [m], shape (2, M, 3)
    normals: unit normals, outwards, shape (2, M, 3)
    radius: of every disc; markers tilt with the skin and do not stretch [m]
    """

    centres: Array
    normals: Array
    radius: float

    def axes(self) -> Array:
        """Two perpendicular semi-axes of each disc, as columns [m], shape (2, M, 3, 2)."""
        # Any direction in the disc's plane will do; no marker's normal comes near y.
        first = np.cross(np.array([0.0, 1.0, 0.0]), self.normals)
        first /= np.linalg.norm(first, axis=-1, keepdims=True)
        second = np.cross(self.normals, first)
        return self.radius * np.stack([first, second], axis=-1)


def tangents(directions: Array) -> tuple[Array, Array]:
    """Unit vectors along θ and along φ at directions (M, 2), each of shape (M, 3)."""
    theta, phi = directions.T
    cos, sin = np.cos(phi), np.sin(phi)
    along_theta = np.column_stack([np.cos(theta) * cos, np.cos(theta) * sin, -np.sin(theta)])
    return along_theta, np.column_stack([-sin, cos, np.zeros_like(phi)])


class MembraneMap:
    """Maps node displacements to the membrane of one sensor; built once, called every frame."""

    def __init__(self, sensor: SensorDesign, nodes: int) -> None:
        self.sensor = sensor
        directions = sensor.directions()
        self._dome: DomeMap = dome_map(directions, nodes)
        self._radial = unit_vectors(directions)
        self._tangents = tangents(directions)

    def __call__(self, seen: Array) -> Membrane:
        """Membrane for node displacements relative to the rigid part (N, 2) [m]."""
        moved = self._dome.displacement(seen)
        along_theta, along_phi = self._dome.gradient(seen)
        centres, normals = [], []
        for radius, follow in zip(self.sensor.layer_radii, self.sensor.follow, strict=True):
            centres.append(radius * self._radial + follow * moved)
            normal = np.cross(
                self._tangents[0] + follow / radius * along_theta,
                self._tangents[1] + follow / radius * along_phi,
            )
            normals.append(normal / np.linalg.norm(normal, axis=-1, keepdims=True))
        return Membrane(
            centres=np.stack(centres),
            normals=np.stack(normals),
            radius=self.sensor.marker_radius,
        )
