"""Both marker layers in space, as the deformed skin carries them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .design.sensor import SensorDesign
from .harmonics import HarmonicMap, harmonic_map

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Membrane:
    """Markers in the sensor frame, layer 0 magenta, layer 1 yellow; equal to itself alone.

    Attributes
    ----------
    centres: [m], shape (2, M, 3)
    axes: two semi-axes of each marker, as columns: perpendicular where the marker has not
        stretched, first along x for squares [m], shape (2, M, 3, 2)
    """

    centres: Array
    axes: Array

    @property
    def normals(self) -> Array:
        """Unit normals, outwards, shape (2, M, 3)."""
        normal = np.cross(self.axes[..., 0], self.axes[..., 1])
        return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


class MembraneMap:
    """Maps node displacements to the membrane of one sensor; built once, called every frame.

    Parameters
    ----------
    sensor: design
    nodes: of the chain, how many or where; see `harmonic_map`
    places: of the markers of each layer, shape (2, M, 2); None is as designed
    """

    def __init__(
        self, sensor: SensorDesign, nodes: int | Array, places: Array | None = None
    ) -> None:
        self.sensor = sensor
        skin, count = sensor.shape, len(sensor.places)
        # Layers that lie on each other share one map.
        one = sensor.places[None] if places is None else places
        self._map: HarmonicMap = harmonic_map(skin, one.reshape(-1, 2), nodes)
        layers = zip(np.broadcast_to(one, (2, count, 2)), sensor.depths, strict=True)
        self._rest = np.stack([skin.points(place, depth) for place, depth in layers])
        self._tangents = np.stack(skin.tangents(one), axis=-1)
        self._share = sensor.follow / [skin.metric(depth) for depth in sensor.depths]
        # Squares lie along the sensor's x and y, discs anyhow.
        cos, sin = np.cos(one[..., 1]), np.sin(one[..., 1])
        self._turn = np.moveaxis(np.stack([[cos, sin], [-sin, cos]]), (0, 1), (-2, -1))
        self._outwards = np.cross(*np.moveaxis(self._tangents, -1, 0))

    def __call__(self, seen: Array) -> Membrane:
        """Membrane for node displacements relative to the rigid part (N, 2) [m]."""
        sensor = self.sensor
        shape = (-1, *self._rest.shape[1:])
        moved = self._map.displacement(seen).reshape(shape)
        slope = np.stack(self._map.gradient(seen), axis=-1).reshape(*shape, 2)
        # How the skin maps its own tangent plane into space, per layer, shape (2, M, 3, 2).
        carried = self._tangents + self._share[:, None, None, None] * slope
        axes = outline_axes(carried, sensor.markers.stretch) @ self._turn
        axes *= sensor.half_sizes[:, None, None, None]
        if sensor.markers.swell_mm:
            axes *= self._swelling(moved)[..., None, None]
        return Membrane(
            centres=self._rest + sensor.follow[:, None, None] * moved,
            axes=axes,
        )

    def _swelling(self, moved: Array) -> Array:
        """Growth of outlines where incompressible silicone gets thinner, shape (2, M)."""
        thinning = np.einsum("lmk,lmk->lm", moved, self._outwards)
        thickness = 1.0 + thinning / (self.sensor.markers.swell_mm * 1e-3)
        # What does not move does not swell; no silicone is pressed to less than a fifth.
        strain = self.sensor.follow[:, None] * (np.clip(thickness, 0.2, 5.0) ** -0.5 - 1.0)
        return 1.0 + strain


def rest_membrane(sensor: SensorDesign, places: Array | None = None) -> Membrane:
    """Markers of the unloaded sensor, at their own places or as designed."""
    return MembraneMap(sensor, 11, places)(np.zeros((11, 2)))


def outline_axes(carried: Array, stretch: float) -> Array:
    """Axes of unit outlines on a skin carried by F = R·U: R and `stretch` of the U, (…, 3, 2)."""
    # The root of a 2×2 matrix C is (C + √det C)/√(tr C + 2√det C).
    a, b = carried[..., 0], carried[..., 1]
    aa, ab, bb = (np.einsum("...k,...k->...", p, q) for p, q in ((a, a), (a, b), (b, b)))
    area = np.sqrt(np.maximum(aa * bb - ab * ab, 1e-12))
    norm = np.sqrt(aa + bb + 2.0 * area)
    u = np.empty((*aa.shape, 2, 2))
    u[..., 0, 0], u[..., 1, 1] = (aa + area) / norm, (bb + area) / norm
    u[..., 0, 1] = u[..., 1, 0] = ab / norm
    inverse = np.empty_like(u)
    inverse[..., 0, 0], inverse[..., 1, 1] = u[..., 1, 1] / area, u[..., 0, 0] / area
    inverse[..., 0, 1] = inverse[..., 1, 0] = -u[..., 0, 1] / area
    rotated = carried @ inverse
    return rotated if stretch == 0.0 else rotated @ (np.eye(2) + stretch * (u - np.eye(2)))
