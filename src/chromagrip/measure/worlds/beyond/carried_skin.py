"""Markers on a skin that moves otherwise than the map of the renderers says.

Where the chain's plane cuts the skin its displacement is the chain's, so that the true forces stay
what they are. Elsewhere, and about the axis, the skin may move as no estimator was told. Everything
is worked out with points in space: nothing here is shared with `render.harmonics`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....render import Membrane, SensorDesign, outline_axes

Array = NDArray[np.float64]

#: Decay of a twist outside the contact: its angle falls with this power of the distance, as that of
#: a half space under a turned disc does far from it.
_TWIST_DECAY = 3.0


@dataclass(frozen=True, kw_only=True)
class Motion:
    """How the skin moves beside the chain's plane, and how the camera sits.

    Attributes
    ----------
    azimuth: of the load's plane from the layout's x axis [rad]
    roll: of the camera about its axis, so that the picture turns the other way [rad]
    shear: factor on the mirror-odd part at right angles to the load's plane; 1 in it
    radial: relative growth there of the mirror-even part's radial displacement; 0 in the plane
    contraction: share of the shear by which points between the two move towards the plane
    twist: angle by which the contact turns about the axis [rad]
    """

    azimuth: float = 0.0
    roll: float = 0.0
    shear: float = 1.0
    radial: float = 0.0
    contraction: float = 0.0
    twist: float = 0.0


class CarriedSkin:
    """Maps node displacements to the membrane of a dome with stiff discs as markers.

    Parameters
    ----------
    sensor: design
    nodes: number of evenly spaced nodes of the chain
    motion: of the skin
    """

    def __init__(self, sensor: SensorDesign, nodes: int, motion: Motion) -> None:
        assert sensor.markers.form == "disc"
        assert not sensor.markers.swell_mm
        self._sensor, self._motion = sensor, motion
        self._stations = np.linspace(-np.pi / 2, np.pi / 2, nodes)
        self._radius = sensor.shape.radius
        self._rest = sensor.shape.points(sensor.places, 0.0) / self._radius
        self._along = np.stack(sensor.shape.tangents(sensor.places), axis=-1)
        self._roll = turned(-motion.roll)
        self._azimuth = turned(motion.azimuth)

    def __call__(self, displacement: Array) -> Membrane:
        """Membrane for node displacements relative to the rigid part (N, 2) [m]."""
        sensor, rest, along = self._sensor, self._rest, self._along
        moved = self._moved(rest, displacement)
        # As far as from one node to the next: between them the chain is straight.
        step = self._stations[1] - self._stations[0]
        sides = [
            self._moved(_unit(rest + side * np.tan(step) * along[..., j]), displacement)
            for j in (0, 1)
            for side in (-1.0, 1.0)
        ]
        slope = np.stack([sides[1] - sides[0], sides[3] - sides[2]], axis=-1) / (2.0 * step)
        centres, axes = np.empty((2, *rest.shape)), np.empty((2, *along.shape))
        for layer, (depth, follow) in enumerate(zip(sensor.depths, sensor.follow, strict=True)):
            radius = self._radius - depth
            centres[layer] = (radius * rest + follow * moved) @ self._roll.T
            carried = self._roll @ (along + follow / radius * slope)
            axes[layer] = sensor.half_sizes[layer] * outline_axes(carried, sensor.markers.stretch)
        return Membrane(centres=centres, axes=axes)

    def _moved(self, rest: Array, displacement: Array) -> Array:
        """Displacement of points of the outer skin at unit vectors (M, 3) [m], (M, 3)."""
        motion = self._motion
        there = rest @ self._azimuth  # as the load's plane sees them
        moved = self._of_plane(there, displacement)
        if motion.twist:
            angle = motion.twist * self._turning(there, displacement)
            point = self._radius * there + moved
            cos, sin = np.cos(angle) - 1.0, np.sin(angle)
            moved[:, 0] += cos * point[:, 0] - sin * point[:, 1]
            moved[:, 1] += sin * point[:, 0] + cos * point[:, 1]
        return moved @ self._azimuth.T

    def _of_plane(self, rest: Array, displacement: Array) -> Array:
        """Displacement of points where the load acts along x."""
        across = np.hypot(rest[:, 0], rest[:, 1])
        inside = across > 1e-9
        cos = np.where(inside, rest[:, 0], 1.0) / np.where(inside, across, 1.0)
        sin = np.where(inside, rest[:, 1], 0.0) / np.where(inside, across, 1.0)
        angle = np.arctan2(across, rest[:, 2])
        ahead, behind = (
            np.stack([np.interp(a, self._stations, displacement[:, k]) for k in (0, 1)])
            for a in (angle, -angle)
        )
        # Even: the same outwards and upwards on both sides. Odd: along x, up here and down there.
        outwards, shift = (ahead[0] - behind[0]) / 2.0, (ahead[0] + behind[0]) / 2.0
        upwards, tilt = (ahead[1] + behind[1]) / 2.0, (ahead[1] - behind[1]) / 2.0
        outwards = outwards * (1.0 + self._motion.radial * sin**2)
        odd = 1.0 + (self._motion.shear - 1.0) * sin**2
        drawn_in = self._motion.contraction * shift * sin * cos
        return np.stack(
            [outwards * cos + odd * shift, outwards * sin - drawn_in, upwards + odd * tilt * cos],
            axis=-1,
        )

    def _turning(self, rest: Array, displacement: Array) -> Array:
        """Share of the twist at points: 1 where a flat object would have flattened the dome."""
        indentation = max(-float(np.interp(0.0, self._stations, displacement[:, 1])), 0.0)
        edge = np.arccos(max(1.0 - indentation / self._radius, 0.0))
        angle = np.arccos(np.clip(rest[:, 2], -1.0, 1.0))
        return (edge / np.maximum(np.maximum(angle, edge), 1e-9)) ** _TWIST_DECAY


def turned(angle: float) -> Array:
    """Rotation about z by an angle [rad], shape (3, 3)."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def _unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
