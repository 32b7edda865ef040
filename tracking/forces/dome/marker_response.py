"""Shifts of the markers of a dome due to forces on its nodes, and their derivatives."""

import numpy as np
from numpy.typing import NDArray

from ....model import Dome
from ....model.dome import lattice
from ....render import DomeMap, Membrane, SensorDesign, areas, centroids, outlines

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class DomeResponse:
    """Predicts (x, y, log size) of both layers of every marker pair of one sensor.

    Parameters
    ----------
    sensor: calibrated design
    dome: body that contains the markers
    places: places of the markers at rest, from the rest frame, shape (2, P, 2)
    """

    def __init__(self, sensor: SensorDesign, dome: Dome, places: Array) -> None:
        self._sensor = sensor
        self._map = DomeMap(sensor, dome, places)
        self._square = sensor.markers.form == "square"
        nodes = len(lattice(dome).ring)
        self._rest = self._measured(self._map(np.zeros((nodes, 3))))
        self._slopes = self._at_rest(places.shape[1])
        self._forces = np.zeros((nodes, 3))
        self._made = np.zeros(nodes, np.bool_)
        self._columns = np.zeros((nodes, 3, self._rest.size), np.float32)

    def __call__(self, nodes: Index, linear: Array) -> Array:
        """Shifts since rest [px, px, 1] of both layers, (P, 6), for forces on the linear skin.

        Parameters
        ----------
        nodes: indices of all loaded nodes, shape (n,)
        linear: forces on them [N], shape (n, 3)
        """
        self._forces[nodes] = linear
        shifts = self._measured(self._map(self._forces)) - self._rest
        self._forces[nodes] = 0.0
        return shifts

    def along(self, nodes: Index, linear: Array) -> Array:
        """Linearised change of the shifts, (C, P, 6), for C small changes of the forces.

        Parameters
        ----------
        nodes: indices of the loaded nodes, shape (n,)
        linear: changes of forces [N], shape (C, n, 3)
        """
        loaded = np.flatnonzero(linear.any(axis=(0, 2)))
        if not len(loaded):
            return np.zeros((len(linear), *self._rest.shape))
        columns = self.of_nodes(nodes[loaded]).reshape(3 * len(loaded), -1)
        changes = linear[:, loaded].reshape(len(linear), -1).astype(np.float32)
        return (changes @ columns).astype(np.float64).reshape(len(linear), *self._rest.shape)

    def of_nodes(self, nodes: Index) -> NDArray[np.float32]:
        """Derivatives of the shifts by forces on n nodes, shape (n, 3, 6·P)."""
        missing = nodes[~self._made[nodes]]
        if len(missing):
            field = self._map.field.of_nodes(missing)
            self._columns[missing] = np.einsum(
                "nalmk,lmjk->namlj", field, self._slopes, optimize=True
            ).reshape(len(missing), 3, -1)
            self._made[missing] = True
        return self._columns[nodes]

    def _at_rest(self, count: int) -> Array:
        """Derivatives (2, P, 3, 9) of (x, y, log size) by displacement and slopes, at rest."""
        out = np.empty((2, count, 3, 9))
        for k in range(9):
            moved, slope = np.zeros((2, count, 3)), np.zeros((2, count, 3, 2))
            step = 1e-6 if k < 3 else 1e-3
            (moved if k < 3 else slope).reshape(2, count, -1)[..., k if k < 3 else k - 3] = step
            change = (self._measured(self._map.of_field(moved, slope)) - self._rest) / step
            out[..., k] = change.reshape(count, 2, 3).swapaxes(0, 1)
        return out

    def _measured(self, membrane: Membrane) -> Array:
        """Measurements (x, y, log size) of both layers of each pair, shape (P, 6)."""
        image = outlines(membrane, self._sensor.view)
        size = 0.5 * np.log(areas(image, self._square))
        values = np.concatenate([centroids(image, self._square), size[..., None]], axis=-1)
        return values.swapaxes(0, 1).reshape(-1, 6)
