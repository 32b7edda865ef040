"""Response of a sensor's markers to a displacement of the chain, with its exact derivative."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ....render import (
    Membrane,
    SensorDesign,
    areas,
    carried_axes,
    centroids,
    harmonic_map,
    outlines,
)
from ..calibration import check_stiff

Array = NDArray[np.float64]


class MarkerResponse:
    """Predicts (x, y, log size) of both layers of every marker pair of one calibrated sensor.

    Parameters
    ----------
    sensor: calibrated design
    places: places of the markers at rest, from the rest frame, shape (2, M, 2)
    nodes: number of the chain's nodes, or their places
    azimuth: azimuth of the plane of the chain [rad]
    """

    def __init__(
        self, sensor: SensorDesign, places: Array, nodes: int | Array, azimuth: float = 0.0
    ) -> None:
        self._sensor, self._view, skin = sensor, sensor.view, sensor.shape
        self._layers = [
            (
                harmonic_map(skin, p, nodes, azimuth),
                skin.points(p, depth),
                skin.tangents(p),
                float(skin.metric(depth)),
                float(follow),
            )
            for p, depth, follow in zip(places, sensor.depths, sensor.follow, strict=True)
        ]

    def __call__(self, displacement: Array, cases: Array) -> tuple[Array, Array]:
        """Prediction at a displacement, and its derivatives along C directions.

        Parameters
        ----------
        displacement: displacements of the nodes relative to the rigid part [m], shape (N, 2)
        cases: directions of the derivatives [m], shape (N, 2, C)

        Returns
        -------
        prediction: (x, y, log size) of each layer [px, px, 1], shape (M, 6)
        derivative: derivative along each direction, shape (M, 6, C)

        Raises
        ------
        UserError
            When the markers are not stiff discs.
        """
        check_stiff(self._sensor)
        predictions, derivatives = [], []
        # Treat the displacement itself as the first direction.
        stacked = np.concatenate([displacement[:, :, None], cases], axis=2)
        for carry, rest, (along_theta, along_phi), radius, follow in self._layers:
            moved = follow * carry.displacement(stacked)
            d_theta, d_phi = (follow / radius * g for g in carry.gradient(stacked))
            centre = rest + moved[:, :, 0]
            side_theta = along_theta + d_theta[:, :, 0]
            side_phi = along_phi + d_phi[:, :, 0]
            # A disc of normal n seen by a lens of Jacobian rows J₁, J₂ has the area (J₁ × J₂)·n.
            upright = np.cross(side_theta, side_phi)
            face = self._face(centre)
            area = _dot(face, upright)
            length2 = _dot(upright, upright)
            to_upright = 0.5 * (face / area[:, None] - upright / length2[:, None])
            to_centre = 0.5 * self._face_gradient(centre, upright) / area[:, None]
            d_log = (
                np.einsum("mk,mkc->mc", to_centre, moved[:, :, 1:])
                + np.einsum("mk,mkc->mc", np.cross(side_phi, to_upright), d_theta[:, :, 1:])
                + np.einsum("mk,mkc->mc", np.cross(to_upright, side_theta), d_phi[:, :, 1:])
            )
            log_size = 0.5 * np.log(area / np.sqrt(length2))
            predictions += [self._view.project(centre), log_size[:, None]]
            derivatives += [self._view.jacobian(centre) @ moved[:, :, 1:], d_log[:, None]]
        return np.concatenate(predictions, axis=1), np.concatenate(derivatives, axis=1)

    def measured(self, displacement: Array) -> Array:
        """Absolute measurements (x, y, log size) with second order [px, px, 1], shape (…, M, 6).

        Parameters
        ----------
        displacement: displacements of the nodes relative to the rigid part [m], shape (…, N, 2)
        """
        parts = []
        for image in self._outlines(displacement.reshape(-1, *displacement.shape[-2:])):
            # Under a sharp object a disc may turn its back; its outline still has an area.
            log_size = 0.5 * np.log(areas(image, False))
            parts += [centroids(image, False), log_size[..., None]]
        values = np.concatenate(parts, axis=-1)
        return values.reshape(*displacement.shape[:-2], *values.shape[1:])

    def _outlines(self, displacement: Array) -> Iterator[Array]:
        """Yield the discs' outlines in the picture, by layer, shape (S, M, 6, 2)."""
        for half, (carry, rest, tangents, metric, follow) in zip(
            self._sensor.half_sizes, self._layers, strict=True
        ):
            moved, slope = carry.many(displacement)
            rigid, strain = np.stack(tangents, axis=-1), follow / metric * slope
            axes = carried_axes(self._sensor.markers, half, rigid, strain, moved, follow)
            yield outlines(Membrane(centres=rest + follow * moved, axes=axes), self._view)

    def _face(self, centre: Array) -> Array:
        """Cross product J₁ × J₂ of the rows of the lens' Jacobian [px²/m²], shape (M, 3)."""
        jacobian = self._view.jacobian(centre)
        return np.cross(jacobian[:, 0], jacobian[:, 1])

    def _face_gradient(self, centre: Array, upright: Array) -> Array:
        """Gradient of `_face`·`upright` by the centre; central differences suit any lens."""
        nudge = 1e-6 * np.eye(3)
        return np.stack(
            [_dot(self._face(centre + h) - self._face(centre - h), upright) / 2e-6 for h in nudge],
            axis=1,
        )


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("mk,mk->m", a, b)
