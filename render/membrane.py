"""Markers of both layers in space, on the deformed skin."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .design.sensor import Markers, SensorDesign
from .harmonics import node_before, slope_weights, stations_of
from .place_kernels import THICKEST, THINNEST, carry_markers, unit_axes_each, unit_normals

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Membrane:
    """M markers of each layer in the sensor frame; layer 0 is magenta, 1 yellow.

    Membranes are compared by identity.

    Attributes
    ----------
    centres: centres of the markers [m], shape (2, M, 3)
    axes: two semi-axes of each marker, as columns [m], shape (2, M, 3, 2); perpendicular on an
        unstretched marker, the first along x for squares
    """

    centres: Array
    axes: Array

    @property
    def normals(self) -> Array:
        """Outward unit normals of the markers, shape (2, M, 3)."""
        normals = np.empty(self.centres.shape)
        unit_normals(self.axes.reshape(-1, 3, 2), normals.reshape(-1, 3))
        return normals


class MembraneMap:
    """Maps node displacements to the membrane of one sensor; built once, called every frame.

    Parameters
    ----------
    sensor: design of the sensor
    nodes: number of the chain's nodes, or their places; see `harmonic_map`
    places: places of the markers of each layer, shape (2, M, 2); None: as designed
    """

    def __init__(
        self, sensor: SensorDesign, nodes: int | Array, places: Array | None = None
    ) -> None:
        self.sensor = sensor
        skin = sensor.shape
        # As designed, both layers have the same places and share one map.
        own = sensor.places[None] if places is None else places
        count = own.shape[1]
        stations = np.ascontiguousarray(stations_of(skin, nodes), dtype=float)
        # Coordinates of each marker, and of its mirror image.
        sides = np.stack([own[..., 0], -own[..., 0]], axis=-1)
        layers = zip(np.broadcast_to(own, (2, count, 2)), sensor.depths, strict=True)
        self._rest = np.stack([skin.points(place, depth) for place, depth in layers])
        markers = sensor.markers
        self._places = (
            *node_before(sides, stations),
            slope_weights(stations),
            np.stack([np.cos(own[..., 1]), np.sin(own[..., 1])], axis=-1),
            np.array(skin.ring(own[..., 0])),
            np.stack(skin.tangents(own), axis=-1),
            self._rest,
            sensor.follow,
            sensor.follow / [skin.metric(depth) for depth in sensor.depths],
            sensor.half_sizes,
            float(markers.stretch),
            1e-3 * float(markers.swell_mm),
        )

    def __call__(self, displacement: Array) -> Membrane:
        """Membrane for node displacements (x, z) relative to the rigid part [m], shape (N, 2)."""
        seen = np.ascontiguousarray(displacement, dtype=float)
        centres, axes = np.empty(self._rest.shape), np.empty((*self._rest.shape, 2))
        carry_markers(seen, *self._places, centres, axes)
        return Membrane(centres=centres, axes=axes)


def rest_membrane(sensor: SensorDesign, places: Array | None = None) -> Membrane:
    """Membrane of the unloaded sensor.

    Parameters
    ----------
    sensor: design of the sensor
    places: places of the markers of each layer, shape (2, M, 2); None: as designed
    """
    return MembraneMap(sensor, 11, places)(np.zeros((11, 2)))


def carried_axes(
    markers: Markers,
    half_size: float,
    tangents: Array,
    strain: Array,
    moved: Array,
    follow: float | Array,
) -> Array:
    """Semi-axes of discs that a skin carries, as columns [m], shape (…, M, 3, 2).

    Parameters
    ----------
    markers: how the discs follow the skin
    half_size: their radius [m]
    tangents: unit vectors along θ and φ at rest as columns, shape (M, 3, 2)
    strain: derivatives of the discs' displacement along these, shape (…, M, 3, 2)
    moved: displacement of the skin [m], shape (…, M, 3)
    follow: share of it that the discs follow, of one shape with (…, M)
    """
    axes = half_size * outline_axes(tangents + strain, markers.stretch)
    if markers.swell_mm:
        # Outlines grow where incompressible silicone gets thinner.
        raised = (moved * np.cross(tangents[..., 0], tangents[..., 1])).sum(axis=-1)
        thickness = np.clip(1.0 + raised / (1e-3 * markers.swell_mm), THINNEST, THICKEST)
        axes *= (1.0 + follow * (1.0 / np.sqrt(thickness) - 1.0))[..., None, None]
    return np.asarray(axes)


def outline_axes(carried: Array, stretch: float) -> Array:
    """Axes of unit outlines on a skin with deformation gradient F = R·U, shape (…, 3, 2).

    An outline follows the whole rotation R, and the share `stretch` of the stretch U.

    Parameters
    ----------
    carried: F of each marker: the deformed unit tangents as columns, shape (…, 3, 2)
    stretch: share of the skin's stretch that an outline follows
    """
    flat = np.ascontiguousarray(carried, dtype=float).reshape(-1, 3, 2)
    out = np.empty_like(flat)
    unit_axes_each(flat, stretch, out)
    return out.reshape(carried.shape)
