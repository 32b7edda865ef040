"""Optical flow from the rest image to each frame, on density images of each dye.

Flow from frame to frame would accumulate errors; flow from the rest image cannot drift.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..detection import RestFrame
from .density_images import density_images, density_tables, markers_there
from .follower import Follower, Image, Measured

Array = NDArray[np.float64]


class LucasKanade(Follower):
    """Pyramidal Lucas–Kanade flow of each marker's window, from rest to the frame and back."""

    def _prepare(self, rest: RestFrame, image: Image) -> None:
        self._radii = rest.radii
        self._tables = density_tables(rest, self._palette)
        self._rest = density_images(image, self._tables)

    def _find(self, image: Image, expected: Array) -> Measured:
        position = np.full_like(expected, np.nan)
        for k, density in enumerate(density_images(image, self._tables)):
            known = np.isfinite(expected[k]).all(axis=-1)
            if known.any():
                position[k, known] = self._flow(k, density, known, expected[k, known])
        return Measured(position)

    def _flow(self, k: int, density: Image, known: NDArray[np.bool_], guess: Array) -> Array:
        """Positions (n, 2) of the n `known` markers of layer k; NaN where they are lost."""
        start = self._origin[k, known].astype(np.float32)
        margin, back_px = 3, 0.3  # margin around a marker, largest error of the way back [px]
        side = 2 * (int(np.ceil(self._radii[k].max())) + margin) + 1
        settings: dict[str, Any] = {
            "winSize": (side, side),
            "maxLevel": 2,  # number of coarser levels; each doubles the search range
            "flags": cv2.OPTFLOW_USE_INITIAL_FLOW,
        }
        flow = cv2.calcOpticalFlowPyrLK
        to, there, _ = flow(self._rest[k], density, start, guess.astype(np.float32), **settings)
        back, back_there, _ = flow(density, self._rest[k], to, start.copy(), **settings)
        good = (there[:, 0] == 1) & (back_there[:, 0] == 1)
        good &= np.linalg.norm(back - start, axis=-1) < back_px
        good &= markers_there(density, np.asarray(to, dtype=float), self._radii[k, known])
        return np.where(good[:, None], to, np.nan)
