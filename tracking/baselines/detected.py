"""Detection of markers in every frame; each is assigned to the nearest expected one.

This is slower than fitting known shapes, but suits markers of any form: centroid, size and hue are
measured.
"""

import numpy as np
from numpy.typing import NDArray

from ..detection import RestFrame, detect_again
from .follower import Follower, Image, Measured, nearest

Array = NDArray[np.float64]


class DetectedMarkers(Follower):
    """Measures positions, sizes and hues of the markers that `detect_again` finds."""

    def _prepare(self, rest: RestFrame, image: Image) -> None:
        self._at_rest, self._area = rest, np.ones(rest.position.shape[:2])
        self._area = np.exp(2.0 * self._measure(image, rest.position)[1])

    def _find(self, image: Image, expected: Array) -> Measured:
        position, log_size, hue = self._measure(image, expected)
        return Measured(position, log_size=log_size, hue=hue)

    def _measure(self, image: Image, expected: Array) -> tuple[Array, Array, Array]:
        """Positions (L, M, 2), logarithms of size over size at rest (L, M), and hues (M,)."""
        position = np.full_like(expected, np.nan)
        area, hue = np.full((2, *expected.shape[:2]), np.nan)
        for k, markers in enumerate(detect_again(image, self._at_rest, self._palette)):
            number = nearest(markers.position, expected[k], self._reach, mutual=True)
            found = number >= 0
            position[k, found] = markers.position[number[found]]
            # Noise may make the area of a spot negative; its size is then unknown.
            sizes = np.where(markers.area > 0.0, markers.area, np.nan)
            area[k, found] = sizes[number[found]]
            hue[k, found] = markers.hue[number[found]]
        return position, 0.5 * np.log(area / self._area), hue[0]
