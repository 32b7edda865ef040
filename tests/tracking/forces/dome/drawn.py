"""Tracks of a dome's markers as its silicone carries them, without a picture."""

import numpy as np
from numpy.typing import NDArray

from chromagrip.model import Dome
from chromagrip.model.dome import lattice
from chromagrip.render import DomeMap, SensorDesign, areas, centroids, outlines
from chromagrip.tracking import Tracks

Array = NDArray[np.float64]

#: Standard deviations of a place [px] and of a log size.
PLACE, SIZE = 0.01, 1e-3


class Drawn:
    """Draws tracks of one sensor, with noise.

    Parameters
    ----------
    sensor: design
    dome: its silicone
    seed: of the noise
    """

    def __init__(self, sensor: SensorDesign, dome: Dome, seed: int = 0) -> None:
        self._sensor, self._map = sensor, DomeMap(sensor, dome)
        self._random = np.random.default_rng(seed)
        self._sizes = self._measured(np.zeros((len(lattice(dome).ring), 3)))[1]
        self._time = 0.0

    def __call__(self, linear: Array) -> Tracks:
        """Tracks for forces on the linear skin (N, 3) [N]."""
        place, size = self._measured(linear)
        shape = size.shape
        self._time += 1 / 60
        covariance = np.diag([PLACE**2, PLACE**2, SIZE**2] * 2)
        return Tracks(
            time=self._time,
            position=place + PLACE * self._random.normal(size=place.shape),
            log_size=size - self._sizes + SIZE * self._random.normal(size=shape),
            hue=np.full(shape[1], np.nan),
            visible=np.ones(shape, bool),
            ambiguous=np.zeros(shape, bool),
            last_seen=np.full(shape, self._time),
            covariance=np.broadcast_to(covariance, (shape[1], 6, 6)),
        )

    def _measured(self, linear: Array) -> tuple[Array, Array]:
        image = outlines(self._map(linear), self._sensor.view)
        square = self._sensor.markers.form == "square"
        return centroids(image, square), 0.5 * np.log(areas(image, square))
