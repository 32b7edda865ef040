"""Optical flow from the rest image, on pictures of each dye's density, warm started.

Flow from frame to frame would add its errors up; from the rest image it cannot drift.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..detection import RestFrame
from .density_images import density_images, density_tables, markers_there, sample
from .follower import Follower, Image, Measured

Array = NDArray[np.float64]

#: Flow there and back again ends this near to its start [px].
_BACK = 0.3
#: Of the window around a marker [px].
_MARGIN = 3
#: Pyramid levels above the image itself: each doubles the reach.
_LEVELS = 2


class LucasKanade(Follower):
    """Pyramidal Lucas–Kanade on each marker's window, there and back."""

    def _prepare(self, rest: RestFrame, image: Image) -> None:
        self._radius = rest.radius
        self._tables = density_tables(rest, self._palette)
        self._rest = density_images(image, self._tables)

    def _find(self, image: Image, expected: Array) -> Measured:
        position = np.full_like(expected, np.nan)
        for k, density in enumerate(density_images(image, self._tables)):
            there = np.isfinite(expected[k]).all(axis=-1)
            if there.any():
                position[k, there] = self._flow(k, density, there, expected[k, there])
        return Measured(position)

    def _flow(self, k: int, density: Image, there: NDArray[np.bool_], guess: Array) -> Array:
        """Positions (n, 2) of the markers `there` of layer k, NaN where they are lost."""
        start = self._origin[k, there].astype(np.float32)
        side = 2 * (int(np.ceil(self._radius[k])) + _MARGIN) + 1
        settings: dict[str, Any] = {
            "winSize": (side, side),
            "maxLevel": _LEVELS,
            "flags": cv2.OPTFLOW_USE_INITIAL_FLOW,
        }
        flow = cv2.calcOpticalFlowPyrLK
        to, found, _ = flow(self._rest[k], density, start, guess.astype(np.float32), **settings)
        back, found_back, _ = flow(density, self._rest[k], to, start.copy(), **settings)
        good = (found[:, 0] == 1) & (found_back[:, 0] == 1)
        good &= np.linalg.norm(back - start, axis=-1) < _BACK
        good &= markers_there(density, np.asarray(to, dtype=float), self._radius[k])
        return np.where(good[:, None], to, np.nan)


class DenseFlow(Follower):
    """Base of the trackers that read each marker's shift from a flow of every pixel.

    A subclass gives `_flow`, which goes on from the flow of the frame before.
    """

    def _flow(self, rest: Image, now: Image, before: NDArray[np.float32]) -> NDArray[np.float32]:
        """Flow (H, W, 2) between two density images."""
        raise NotImplementedError

    def _prepare(self, rest: RestFrame, image: Image) -> None:
        self._radius = rest.radius
        self._tables = density_tables(rest, self._palette)
        self._rest = density_images(image, self._tables)
        self._state["flow"] = np.zeros((*self._rest.shape, 2), dtype=np.float32)

    def _find(self, image: Image, expected: Array) -> Measured:
        position = np.full_like(expected, np.nan)
        for k, density in enumerate(density_images(image, self._tables)):
            flow = self._flow(self._rest[k], density, self._state["flow"][k])
            self._state["flow"][k] = flow
            at = self._origin[k]
            to = at + np.stack([sample(flow[..., i], at) for i in range(2)], axis=-1)
            there = markers_there(density, to, self._radius[k])
            position[k] = np.where(there[:, None], to, np.nan)
        return Measured(position)


class DenseInverseSearch(DenseFlow):
    """DIS (Kroeger 2016) of OpenCV."""

    def _flow(self, rest: Image, now: Image, before: NDArray[np.float32]) -> NDArray[np.float32]:
        search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        return np.asarray(search.calc(rest, now, before.copy()), dtype=np.float32)


class Farneback(DenseFlow):
    """Polynomial expansion (Farnebäck 2003) of OpenCV."""

    def _flow(self, rest: Image, now: Image, before: NDArray[np.float32]) -> NDArray[np.float32]:
        found = cv2.calcOpticalFlowFarneback(
            rest,
            now,
            before.copy(),
            pyr_scale=0.5,
            levels=3,
            winsize=15,
            iterations=3,
            poly_n=5,
            poly_sigma=1.1,
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        )
        return np.asarray(found, dtype=np.float32)
