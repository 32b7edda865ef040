"""Cameras: the only place where metres become pixels."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class FisheyeCamera:
    """Equidistant fisheye at the sphere centre, looking along +z: r = f·θ.

    Attributes
    ----------
    width, height: image size [px]
    focal: pixels per radian
    centre: pixel (x, y) on the optical axis; pixel centres lie at integers
    """

    width: int
    height: int
    focal: float
    centre: tuple[float, float]

    def project(self, points: Array) -> Array:
        """Pixels (…, 2) of points (…, 3) in the sensor frame [m]."""
        rho = np.hypot(points[..., 0], points[..., 1])
        angle = np.arctan2(rho, points[..., 2])
        # angle/rho → 1/z on the axis.
        aside = rho > 1e-12
        scale = np.where(aside, angle, 1.0) / np.where(aside, rho, points[..., 2])
        return np.asarray(self.centre) + self.focal * scale[..., None] * points[..., :2]

    def jacobian(self, points: Array) -> Array:
        """Derivative of `project` [px/m], shape (…, 2, 3)."""
        x, y, z = np.moveaxis(points, -1, 0)
        rho = np.hypot(x, y)
        range2 = rho**2 + z * z
        # On the axis every direction is radial; any unit vector will do.
        off_axis = rho > 1e-12
        along = np.where(off_axis, x / np.maximum(rho, 1e-12), 1.0)
        across = np.where(off_axis, y / np.maximum(rho, 1e-12), 0.0)
        # Image point = f·angle·(x, y)/rho; ∂angle = (z ∂rho − rho ∂z)/range².
        radial = z / range2
        swing = np.where(off_axis, np.arctan2(rho, z) / np.maximum(rho, 1e-12), 1.0 / z)
        out = np.empty((*points.shape[:-1], 2, 3))
        out[..., 0, 0] = radial * along**2 + swing * across**2
        out[..., 0, 1] = out[..., 1, 0] = (radial - swing) * along * across
        out[..., 1, 1] = radial * across**2 + swing * along**2
        out[..., 0, 2] = -x / range2
        out[..., 1, 2] = -y / range2
        return self.focal * out

    def directions(self, pixels: Array) -> Array:
        """Directions (θ, φ) [rad] seen at pixels (…, 2); the inverse of `project`."""
        offset = (pixels - np.asarray(self.centre)) / self.focal
        return np.stack(
            [np.hypot(offset[..., 0], offset[..., 1]), np.arctan2(offset[..., 1], offset[..., 0])],
            axis=-1,
        )
