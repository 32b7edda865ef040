"""Weighted centroids of what each dye covers, against the ground around each marker.

Only a window around each marker is looked at. Its light counts as a share of the ground's around
it, and coverage as a share of the marker's own, so that shading, gain and contrast drop out.
Weights rise with coverage between two thresholds: ground and middles, which say nothing of the
place, are free of noise.
"""

import numpy as np
from numpy.typing import NDArray

from ...render.colour import decode_srgb, decoding_table, encode_srgb
from ..detection import RestFrame
from .centroid_kernels import Windows, weigh_markers
from .follower import Follower, Image, Measured

Array = NDArray[np.float64]

#: Discs of a window over the marker's radius, and more for its blur [px].
_CORE, _REACH, _BLUR = 0.5, 1.1, 1.5
#: Ground around that [px]; and how far layers may be apart, in pitches.
_MARGIN, _SHEAR = 1, 0.5
#: The sensor's field is brighter than this share of its brightest ground.
_LIT = 0.2


class WeightedCentroid(Follower):
    """Centroids and sizes, with the covariance that the pixels' noise gives them."""

    def _prepare(self, rest: RestFrame, image: Image) -> None:
        shape = rest.position.shape[:2]
        self._area = np.full(shape, np.nan)
        radius = rest.radius
        # The first look tells how large markers are, the second how large each of them is.
        for _ in range(2):
            self._state["cover"] = np.ones(shape)
            self._windows = self._lay(rest, radius)
            place, area, _ = self._weigh(image, rest.position)
            if not np.isfinite(place[..., 0]).any(axis=1).all():
                break
            radius = np.sqrt(np.array([np.median(a[np.isfinite(a)]) for a in area]) / np.pi)
        self._area = np.where(np.isfinite(place[..., 0]), area, np.nan)

    def _lay(self, rest: RestFrame, radius: Array) -> Windows:
        """Windows for markers of a radius [px], shape (L,)."""
        linear = decoding_table()
        reach = _REACH * radius + _BLUR
        # Outside the field it may be anything.
        ground = np.maximum(rest.ground, _LIT * np.percentile(rest.ground, 95, axis=(0, 1)))
        noise = np.gradient(linear) ** 2 * (self._noise**2 + 1.0 / 12.0)
        transmittance = self._palette.transmittance
        unmixing = _unmixing(transmittance, np.median(ground, axis=(0, 1)))
        return Windows(
            linear=linear.astype(np.float32),
            noise=noise.astype(np.float32),
            ground=(1.0 / ground).astype(np.float32),
            unmixing=unmixing.astype(np.float32),
            crossing=(unmixing @ np.prod(1.0 - transmittance, axis=0)).astype(np.float32),
            radius=radius,
            bright=self._palette.bright,
            core=np.maximum(_CORE * radius, 1.0),
            reach=reach,
            margin=_MARGIN,
            side=int(2.0 * (reach.max() + _MARGIN) + _SHEAR * rest.pitch) + 3,
            near=self._near,
        )

    def _find(self, image: Image, expected: Array) -> Measured:
        place, area, covariance = self._weigh(image, expected)
        size = 0.5 * np.log(np.where(np.isfinite(place[..., 0]), area, np.nan) / self._area)
        return Measured(place, log_size=size, covariance=covariance)

    def _weigh(self, image: Image, expected: Array) -> tuple[Array, Array, Array]:
        """Places (L, M, 2), areas (L, M) and covariances (M, 3L, 3L)."""
        layers, count, _ = expected.shape
        place, area = np.empty_like(expected), np.full((layers, count), np.nan)
        covariance = np.empty((count, 3 * layers, 3 * layers))
        cover = self._state["cover"]
        weigh_markers(image, self._windows, self._area, cover, expected, place, area, covariance)
        return place, area, covariance


def _unmixing(transmittance: Array, ground: Array) -> Array:
    """Coverage of both layers by 1 − light, where the first covers less and where more, (2, 2, 3).

    Least squares, channels weighted by the noise that a level has where markers cover a half.
    Without a second layer its coverage is 0.
    """
    matrices = np.zeros((2, 2, 3))
    half = ground * np.prod(0.5 + 0.5 * transmittance, axis=0)
    level = encode_srgb(half)
    spread = (decode_srgb(level + 0.5) - decode_srgb(level - 0.5)) / ground
    absorbed = 1.0 - transmittance
    for case, outer in enumerate((1, 0)):
        seen = absorbed.copy()
        if len(absorbed) == 2:
            # The smaller one lies on the larger one.
            seen[1 - outer] *= transmittance[outer]
        matrices[case, : len(seen)] = np.linalg.pinv((seen / spread).T) / spread
    return matrices
