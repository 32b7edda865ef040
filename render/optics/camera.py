"""Cameras in OpenCV's parameters: the only place where directions become pixels."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from .projection_kernels import NO_PORT, Distortion, Lens, Port, project_points

Array = NDArray[np.float64]

#: Newton steps that invert a lens distortion.
_ROUNDS = 12


class Camera(Protocol):
    """Projects points of the camera's frame: x right, y down, z into the scene."""

    @property
    def width(self) -> int:
        """Image width [px]."""

    @property
    def height(self) -> int:
        """Image height [px]."""

    @property
    def lens(self) -> Lens:
        """Parameters of the compiled projection."""

    def project(self, points: Array) -> Array:
        """Project points (…, 3) [m] to pixels (…, 2); NaN where a point is not visible."""

    def jacobian(self, points: Array) -> Array:
        """Derivative of `project` with respect to the point [px/m], shape (…, 2, 3)."""

    def rays(self, pixels: Array) -> Array:
        """Unit directions (…, 3) of the rays that reach pixels (…, 2); inverse of `project`."""


@dataclass(frozen=True, kw_only=True)
class FisheyeCamera:
    """Equidistant fisheye, r = f·θd with θd = θ·(1 + k₁θ² + k₂θ⁴ + k₃θ⁶ + k₄θ⁸).

    Attributes
    ----------
    width, height: image size [px]
    focal: pixels per radian along x and y
    centre: pixel (x, y) on the optical axis; pixel centres lie at integers
    distortion: Kannala and Brandt's k₁…k₄, as in OpenCV
    """

    width: int
    height: int
    focal: tuple[float, float]
    centre: tuple[float, float]
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not (self._slope(np.linspace(0.0, np.pi / 2, 64)) > 0.0).all():
            raise UserError(
                f"distortion {list(self.distortion)} folds the fisheye's image within 90°"
            )

    def _bent(self, angle: Array) -> Array:
        """Distorted angle θd of an angle θ from the optical axis [rad]."""
        if not any(self.distortion):
            return angle
        k, t = self.distortion, angle * angle
        return angle * (1.0 + t * (k[0] + t * (k[1] + t * (k[2] + t * k[3]))))

    def _slope(self, angle: Array) -> Array:
        """Derivative dθd/dθ."""
        k, t = self.distortion, angle * angle
        return 1.0 + t * (3 * k[0] + t * (5 * k[1] + t * (7 * k[2] + t * 9 * k[3])))

    @cached_property
    def lens(self) -> Lens:
        """Parameters of the compiled projection."""
        return _lens(True, self.focal, self.centre, (*self.distortion, 0.0))

    def project(self, points: Array) -> Array:
        """Project points (…, 3) [m] to pixels (…, 2)."""
        return projected(points, NO_PORT, self.lens)

    def jacobian(self, points: Array) -> Array:
        """Derivative of `project` [px/m], shape (…, 2, 3)."""
        x, y, z = np.moveaxis(points, -1, 0)
        rho = np.hypot(x, y)
        angle = np.arctan2(rho, z)
        slope = self._slope(angle) / (rho**2 + z * z)
        # On the axis every direction is radial: any unit vector is right.
        off_axis = rho > 1e-12
        along = np.where(off_axis, x / np.maximum(rho, 1e-12), 1.0)
        across = np.where(off_axis, y / np.maximum(rho, 1e-12), 0.0)
        # Image point = f·bent·(x, y)/rho; ∂angle = (z ∂rho − rho ∂z)/range².
        radial = z * slope
        swing = np.where(off_axis, self._bent(angle), 1.0) / np.where(off_axis, rho, z)
        out = np.empty((*points.shape[:-1], 2, 3))
        out[..., 0, 0] = radial * along**2 + swing * across**2
        out[..., 0, 1] = out[..., 1, 0] = (radial - swing) * along * across
        out[..., 1, 1] = radial * across**2 + swing * along**2
        out[..., 0, 2] = -x * slope
        out[..., 1, 2] = -y * slope
        return np.asarray(self.focal)[:, None] * out

    def rays(self, pixels: Array) -> Array:
        """Unit directions (…, 3) seen at pixels (…, 2)."""
        offset = (pixels - np.asarray(self.centre)) / np.asarray(self.focal)
        bent = np.hypot(offset[..., 0], offset[..., 1])
        angle = bent
        if any(self.distortion):
            for _ in range(_ROUNDS):
                angle = np.clip(
                    angle - (self._bent(angle) - bent) / self._slope(angle), 0.0, np.pi / 2 + 0.2
                )
        scale = np.sin(angle) / np.where(bent > 0.0, bent, 1.0)
        return np.concatenate([scale[..., None] * offset, np.cos(angle)[..., None]], axis=-1)


@dataclass(frozen=True, kw_only=True)
class PinholeCamera:
    """Pinhole with Brown's distortion.

    Attributes
    ----------
    width, height: image size [px]
    focal: focal lengths along x and y [px]
    centre: pixel (x, y) on the optical axis; pixel centres lie at integers
    distortion: Brown's k₁, k₂, p₁, p₂, k₃, in OpenCV's order
    """

    width: int
    height: int
    focal: tuple[float, float]
    centre: tuple[float, float]
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        edge = np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [0.0, 0.5], [1.0, 0.5]])
        edge = np.concatenate([edge, 1.0 - edge]) * [self.width - 1.0, self.height - 1.0]
        with np.errstate(all="ignore"):
            back = self.project(self.rays(edge))
        if not np.nan_to_num(abs(back - edge), nan=np.inf).max() < 0.1:
            raise UserError(f"distortion {list(self.distortion)} folds the pinhole's image")

    def _distort(self, flat: Array) -> tuple[Array, Array]:
        """Distort image-plane points (…, 2); also return the Jacobian (…, 2, 2)."""
        k1, k2, p1, p2, k3 = self.distortion
        x, y = flat[..., 0], flat[..., 1]
        t = x * x + y * y
        scale = 1.0 + t * (k1 + t * (k2 + t * k3))
        slope = k1 + t * (2 * k2 + t * 3 * k3)  # d scale / dt
        bent = np.stack(
            [
                x * scale + 2 * p1 * x * y + p2 * (t + 2 * x * x),
                y * scale + p1 * (t + 2 * y * y) + 2 * p2 * x * y,
            ],
            axis=-1,
        )
        out = np.empty((*flat.shape, 2))
        out[..., 0, 0] = scale + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
        out[..., 0, 1] = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
        out[..., 1, 0] = out[..., 0, 1]
        out[..., 1, 1] = scale + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
        return bent, out

    @cached_property
    def lens(self) -> Lens:
        """Parameters of the compiled projection."""
        return _lens(False, self.focal, self.centre, self.distortion)

    def project(self, points: Array) -> Array:
        """Project points (…, 3) [m] to pixels (…, 2); NaN behind the camera."""
        return projected(points, NO_PORT, self.lens)

    def jacobian(self, points: Array) -> Array:
        """Derivative of `project` [px/m], shape (…, 2, 3)."""
        z = np.where(points[..., 2:] > 0.0, points[..., 2:], np.nan)
        flat = points[..., :2] / z
        _, slope = self._distort(flat)
        onto = np.zeros((*points.shape[:-1], 2, 3))
        onto[..., 0, 0] = onto[..., 1, 1] = 1.0 / z[..., 0]
        onto[..., :, 2] = -flat / z
        return np.asarray(self.focal)[:, None] * (slope @ onto)

    def rays(self, pixels: Array) -> Array:
        """Unit directions (…, 3) seen at pixels (…, 2)."""
        bent = (pixels - np.asarray(self.centre)) / np.asarray(self.focal)
        flat = bent
        if any(self.distortion):
            for _ in range(_ROUNDS):
                here, slope = self._distort(flat)
                off = here - bent
                a, b, c, d = slope[..., 0, 0], slope[..., 0, 1], slope[..., 1, 0], slope[..., 1, 1]
                step = np.stack(
                    [d * off[..., 0] - b * off[..., 1], a * off[..., 1] - c * off[..., 0]], axis=-1
                )
                flat = flat - step / (a * d - b * c)[..., None]
        ray = np.concatenate([flat, np.ones((*flat.shape[:-1], 1))], axis=-1)
        return ray / np.linalg.norm(ray, axis=-1, keepdims=True)


def projected(points: Array, port: Port, lens: Lens) -> Array:
    """Project points (…, 3) [m] behind a port to pixels (…, 2)."""
    flat = np.ascontiguousarray(points, dtype=float).reshape(-1, 3)
    out = np.empty((len(flat), 2))
    project_points(flat, port, lens, out)
    return out.reshape(*np.shape(points)[:-1], 2)


def _lens(
    fisheye: bool, focal: tuple[float, float], centre: tuple[float, float], distortion: Distortion
) -> Lens:
    """Parameters of the compiled projection, as floats: other types would compile it again."""
    first, second, third, fourth, fifth = map(float, distortion)
    return Lens(
        fisheye=fisheye,
        focal_x=float(focal[0]),
        focal_y=float(focal[1]),
        centre_x=float(centre[0]),
        centre_y=float(centre[1]),
        distortion=(first, second, third, fourth, fifth),
    )
