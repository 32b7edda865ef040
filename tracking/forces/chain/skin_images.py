"""Shifts of marker pairs for displacements of many chains at once."""

import math

import numpy as np
from numpy.typing import NDArray

from ....model import Ensemble, Fingertip
from ....render import Membrane, MembraneMap, SensorDesign, areas, centroids, outlines

Array = NDArray[np.float64]


class SkinImages:
    """Maps chains of one sensor to the shifts of its marker pairs.

    Parameters
    ----------
    fingertip, sensor: as calibrated
    places: places of the marker pairs at rest, shape (2, P, 2)
    azimuth: azimuth of the load's plane [rad]

    Attributes
    ----------
    pairs: number of pairs P
    lag: shifts by uniform displacements of the whole skin along x and z, of 1 px root mean square,
        shape (2, P, 6)
    """

    def __init__(
        self, fingertip: Fingertip, sensor: SensorDesign, places: Array, azimuth: float
    ) -> None:
        cos, sin = math.cos(azimuth), math.sin(azimuth)
        self._turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        self._view, self.pairs = sensor.view, places.shape[1]
        self._map = MembraneMap(sensor, fingertip.angles(), places - [0.0, azimuth])
        self._rest = np.zeros((self.pairs, 6))
        nodes = fingertip.nodes
        self._rest = self._shifts(np.zeros((1, nodes, 2)))[0]
        lag = np.zeros((2, nodes, 2))
        lag[0, :, 0] = lag[1, :, 1] = 1e-5
        lag = self._shifts(lag)
        self.lag = lag / np.sqrt((lag[..., [0, 1, 3, 4]] ** 2).mean(axis=(1, 2)))[:, None, None]

    def __call__(self, ensemble: Ensemble) -> Array:
        """Shifts (x, y, log size) of both layers of every pair, shape (B, P, 6)."""
        seen = ensemble.nodes.copy()
        seen[:, :, 1] -= ensemble.pose[:, :1]
        return self._shifts(seen)

    def _shifts(self, seen: Array) -> Array:
        """Shifts for displacements (B, N, 2) relative to the rigid part [m], shape (B, P, 6)."""
        membrane = self._map.many(seen)
        centres, axes = membrane.centres @ self._turn.T, self._turn @ membrane.axes
        image = outlines(Membrane(centres=centres, axes=axes), self._view)
        with np.errstate(divide="ignore"):
            size = 0.5 * np.log(areas(image, square=False))
        each = np.concatenate([centroids(image, square=False), size[..., None]], axis=-1)
        pairs = each.reshape(len(seen), 2, self.pairs, 3).swapaxes(1, 2)
        return pairs.reshape(len(seen), self.pairs, 6) - self._rest
