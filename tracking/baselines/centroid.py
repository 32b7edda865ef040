"""Weighted centroid of each marker in a window that follows it, one layer at a time."""

import numpy as np
from numpy.typing import NDArray

from ..detection import RestFrame, neighbours
from .density_images import density_images, density_tables, markers_there
from .density_kernels import UNIT, weigh_windows
from .follower import Follower, Image, Measured

Array = NDArray[np.float64]


class WeightedCentroid(Follower):
    """Centroid of a dye's density over the ground around it (Crocker and Grier 1996).

    The covariance is that of the camera's noise, at rest. Neighbours in the window, and the other
    dye where unmixing is not exact, shift the centroid too; that is not in it.
    """

    def _prepare(self, rest: RestFrame, image: Image) -> None:
        self._tables, self._radii = density_tables(rest, self._palette), rest.radii
        # A window has room for a marker's blurred edge [px], but not for its neighbours.
        blur, near = 1.5, neighbours(np.nanmean(rest.position, axis=0), 1)[:, 0]
        half = 0.5 * np.linalg.norm(rest.position - rest.position[:, near], axis=-1)
        self._window = np.fmin(rest.radii + blur, half)
        self._field = np.isfinite(self._tables.ground[::4, ::4, 0])
        self._mass, self._variance = self._window.copy(), np.empty_like(rest.position)
        # Rounding adds 1/12 to the noise.
        noise = (self._noise**2 + 1.0 / 12.0) * np.gradient(self._tables.dye, axis=2) ** 2
        for k, density in enumerate(density_images(image, self._tables)):
            at, self._mass[k] = self._followed(density, rest.position[k], k)
            spread = sum(noise[k, c][image[..., c]] for c in range(3))
            self._variance[k] = _variance(np.asarray(spread), at, self._window[k], self._mass[k])

    def _find(self, image: Image, expected: Array) -> Measured:
        position = np.full_like(expected, np.nan)
        smallest = 0.4  # mass of a marker over that at rest
        for k, density in enumerate(density_images(image, self._tables)):
            at, mass = self._followed(density, expected[k], k)
            good = np.linalg.norm(at - expected[k], axis=-1) < self._reach
            good &= (mass > smallest * self._mass[k]) & (mass * smallest < self._mass[k])
            good &= markers_there(density, at, self._radii[k])
            position[k, good] = at[good]
        return Measured(position, variance=self._variance)

    def _followed(self, density: Image, expected: Array, k: int) -> tuple[Array, Array]:
        """Centroids (M, 2) of layer k in windows that follow them, and masses (M,) [px²]."""
        # A change of the light shifts all densities; less than half of the field is dyed.
        ground = float(np.percentile(density[::4, ::4][self._field], 30.0))
        found = np.full((len(expected), 3), np.nan)
        weigh_windows(density, ground, expected, self._window[k], found)
        return found[:, :2], found[:, 2] / UNIT


def _variance(spread: Array, at: Array, window: Array, mass: Array) -> Array:
    """Variances (M, 2) of centroids, of those of a density's pixels, shape (H, W) [px²]."""
    reach = int(np.nanmax(window)) + 1
    along = np.arange(-reach, reach + 1)
    pixels = np.rint(np.nan_to_num(at)).astype(int)[:, None] + np.stack(
        np.meshgrid(along, along), axis=-1
    ).reshape(-1, 2)
    away = pixels - at[:, None]
    share = np.clip(window[:, None] + 0.5 - np.linalg.norm(away, axis=-1), 0.0, 1.0)
    x, y = np.moveaxis(np.clip(pixels, 0, np.array(spread.shape[::-1]) - 1), -1, 0)
    each = share**2 * spread[y, x]
    return np.asarray((each[..., None] * away**2).sum(axis=1) / mass[:, None] ** 2)
