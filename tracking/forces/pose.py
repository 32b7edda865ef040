"""Pose of a camera relative to the design, and conversion of its pixels to the design's camera.

All rays pass the camera's centre, with or without refraction. So a camera that is rotated about its
centre, or has another lens scale, sees the same rays at other pixels.
"""

import math
from dataclasses import dataclass
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from ...render import Camera
from ..tracks import Tracks
from .pose_kernels import polynomials

Array = NDArray[np.float64]

#: Smallest differences from the design that are reported: roll and tilt [°], shift [px], scale.
_NOTABLE = (0.3, 0.5, 3.0, 0.01)
#: Degrees of the polynomial to try; the last one is accepted in any case.
_DEGREES = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14)
#: Golden angle, the step of an even spiral of points over a disc [rad].
_SPIRAL = math.pi * (3.0 - math.sqrt(5.0))


class PoseTable(TypedDict):
    """A camera's pose in a summary, see `CameraPose`."""

    roll_deg: float
    roll_deviation_deg: float
    shift_px: list[float]
    shift_deviation_px: list[float]
    scale: float
    scale_deviation: float
    tilt_deg: list[float]
    tilt_deviation_deg: list[float]
    error_px: float
    ambiguous: bool
    notable: bool


def pose_words(pose: PoseTable) -> str:
    """Describe a pose of a summary in words."""
    x, y = pose["shift_px"]
    words = (
        f"rolled by {pose['roll_deg']:.2f}°, shifted by ({x:.1f}, {y:.1f}) px, scaled by "
        f"{pose['scale']:.3f}, tilted by {math.hypot(*pose['tilt_deg']):.2f}°"
    )
    if pose["ambiguous"]:
        words += ", or further by a symmetry of the layout"
    return words


@dataclass(frozen=True, kw_only=True)
class CameraPose:
    """Pose of a camera relative to the design's camera, as estimated from the rest frame.

    The design's frame is that of the outer layer: if layers are misaligned, the inner one counts as
    misplaced.

    Attributes
    ----------
    roll: rotation about the optical axis, from x to y of the image: clockwise on a screen [rad]
    tilt: rotation about the image's x and y, before the roll, as a rotation vector [rad]; 0 on a
        flat pad, where it looks like a shift
    shift: shift of the pixel on the optical axis [px]
    scale: factor on the focal lengths
    error: RMS distance of the markers from the positions that this pose predicts [px]
    roll_deviation, tilt_deviation, shift_deviation, scale_deviation: standard deviations
    ambiguous: whether a larger rotation or shift explains the rest frame equally well, by a
        symmetry of the layout
    """

    roll: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)
    shift: tuple[float, float] = (0.0, 0.0)
    scale: float = 1.0
    error: float = 0.0
    roll_deviation: float = 0.0
    tilt_deviation: tuple[float, float] = (0.0, 0.0)
    shift_deviation: tuple[float, float] = (0.0, 0.0)
    scale_deviation: float = 0.0
    ambiguous: bool = False

    @property
    def turn(self) -> Array:
        """Rotation matrix from the axes of the design's camera to those of this one, (3, 3)."""
        return turn_matrix(self.roll, self.tilt)

    @property
    def notable(self) -> bool:
        """Whether it differs from the design by more than mounting tolerances."""
        roll, tilt, shift, scale = _NOTABLE
        return (
            abs(self.roll) > math.radians(roll)
            or math.hypot(*self.tilt) > math.radians(tilt)
            or math.hypot(*self.shift) > shift
            or abs(self.scale - 1.0) > scale
        )

    def table(self) -> PoseTable:
        """Values for a summary."""
        return {
            "roll_deg": math.degrees(self.roll),
            "roll_deviation_deg": math.degrees(self.roll_deviation),
            "shift_px": list(self.shift),
            "shift_deviation_px": list(self.shift_deviation),
            "scale": self.scale,
            "scale_deviation": self.scale_deviation,
            "tilt_deg": [math.degrees(t) for t in self.tilt],
            "tilt_deviation_deg": [math.degrees(t) for t in self.tilt_deviation],
            "error_px": self.error,
            "ambiguous": self.ambiguous,
            "notable": self.notable,
        }

    def __str__(self) -> str:
        return pose_words(self.table())


def turn_matrix(roll: float, tilt: tuple[float, float]) -> Array:
    """Rotation by a tilt, then by a roll, shape (3, 3)."""
    cos, sin = math.cos(roll), math.sin(roll)
    about_axis = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    # By Rodrigues' formula; scipy's Rotation takes longer than the rest of `seen_by`.
    x, y = tilt
    angle = math.hypot(x, y)
    lean = np.array([[0.0, 0.0, y], [0.0, 0.0, -x], [-y, x, 0.0]])
    sine, half_sine = np.sinc(angle / math.pi), np.sinc(0.5 * angle / math.pi)  # over the angle
    return np.asarray(about_axis @ (np.eye(3) + sine * lean + 0.5 * half_sine**2 * lean @ lean))


def seen_by(pose: CameraPose, camera: Camera, pixels: Array) -> Array:
    """Convert pixels (…, 2) of the design's `camera` to pixels of a camera in a pose."""
    centre = np.array([camera.lens.centre_x, camera.lens.centre_y])
    turned = camera.project(camera.rays(pixels) @ pose.turn.T)
    return centre + np.asarray(pose.shift) + pose.scale * (turned - centre)


def seen_by_design(pose: CameraPose, camera: Camera, pixels: Array) -> Array:
    """Convert pixels (…, 2) of a camera in a pose to pixels of the design's `camera`."""
    centre = np.array([camera.lens.centre_x, camera.lens.centre_y])
    rays = camera.rays(centre + (pixels - centre - np.asarray(pose.shift)) / pose.scale)
    return camera.project(rays @ pose.turn)


def slope(pose: CameraPose, camera: Camera, pixels: Array) -> Array:
    """Jacobian of `seen_by_design` with respect to the pixel, shape (…, 2, 2)."""
    half = 1e-3  # step of the central differences [px]
    columns = [
        seen_by_design(pose, camera, pixels + h) - seen_by_design(pose, camera, pixels - h)
        for h in half * np.eye(2)
    ]
    return np.stack(columns, axis=-1) / (2 * half)


@dataclass(frozen=True, kw_only=True)
class Alignment:
    """Fast `seen_by_design`, as polynomials of the pixel.

    Attributes
    ----------
    pose: pose of the camera
    camera: camera of the design
    middle, radius: disc of pixels in which the polynomials hold [px]
    coefficients: C coefficients of the converted x and y and the change of log size, shape (3, C)
    degree: degree of the polynomials
    """

    pose: CameraPose
    camera: Camera
    middle: Array
    radius: float
    coefficients: Array
    degree: int

    def __call__(self, pixels: Array) -> Array:
        """Converted x, y and change of log size, (…, 3), for pixels (…, 2)."""
        at = np.ascontiguousarray(pixels).reshape(-1, 2)
        values = np.empty((len(at), 3))
        polynomials(at, self.middle, self.radius, self.coefficients, self.degree, values)
        return values.reshape(*pixels.shape[:-1], 3)


def alignment(pose: CameraPose, camera: Camera, pixels: Array) -> Alignment:
    """Fit an alignment that is exact to 1e-4 px where markers are at rest, and around.

    Parameters
    ----------
    pose: pose of the camera
    camera: camera of the design
    pixels: pixels of the markers at rest, shape (…, 2); NaN is ignored
    """
    pixels = pixels[np.isfinite(pixels).all(axis=-1)]
    middle = 0.5 * (pixels.min(axis=0) + pixels.max(axis=0))
    # Markers move by a tenth of the disc at most.
    radius = 1.1 * float(np.linalg.norm(pixels - middle, axis=-1).max()) + 1.0
    step = np.arange(2 * 900)  # every other point checks the polynomial
    reach, angle = np.sqrt((step + 0.5) / len(step)), _SPIRAL * step
    unit = np.stack([reach * np.cos(angle), reach * np.sin(angle)])
    points = middle + radius * unit.T
    slopes = slope(pose, camera, points)
    size = 0.5 * np.log(abs(np.linalg.det(slopes)))
    wanted = np.column_stack([seen_by_design(pose, camera, points), size])
    fitted = np.zeros((3, 3))
    for degree in _DEGREES:
        basis = _basis(unit.T, degree)
        fitted = np.linalg.lstsq(basis[::2], wanted[::2], rcond=None)[0]
        if abs(basis @ fitted - wanted)[1::2].max() < 1e-4:  # [px]
            break
    return Alignment(
        pose=pose,
        camera=camera,
        middle=middle,
        radius=radius,
        coefficients=np.ascontiguousarray(fitted.T),
        degree=degree,
    )


def _basis(points: Array, degree: int) -> Array:
    """Terms of `polynomials` at n points (n, 2), shape (n, C)."""
    count = (degree + 1) * (degree + 2) // 2
    terms = np.empty((len(points), count))
    polynomials(np.ascontiguousarray(points), np.zeros(2), 1.0, np.eye(count), degree, terms)
    return terms


def aligned(align: Alignment, tracks: Tracks) -> Tracks:
    """Convert the positions, sizes and covariances of tracks to the design's camera."""
    seen = align(tracks.position)
    covariance = carried(blocks(align, tracks.position), tracks.covariance)
    changed = {
        "position": np.ascontiguousarray(seen[..., :2]),
        "log_size": tracks.log_size + seen[..., 2],
        "covariance": covariance,
    }
    # Not `dataclasses.replace`, which would measure the hue.
    return Tracks(**{**vars(tracks), **changed})


def blocks(align: Alignment, position: Array) -> Array:
    """Jacobian of the converted (x, y, log size) of all L layers, shape (M, 3L, 3L).

    The small dependence of sizes on the position is neglected.

    Parameters
    ----------
    align: alignment
    position: positions of the markers [px], shape (L, M, 2); NaN means the middle of the image
    """
    known = np.where(np.isfinite(position), position, align.middle)
    slopes = slope(align.pose, align.camera, known)
    layers, markers = position.shape[:2]
    out = np.tile(np.eye(3 * layers), (markers, 1, 1))
    for layer in range(layers):
        out[:, 3 * layer : 3 * layer + 2, 3 * layer : 3 * layer + 2] = slopes[layer]
    return out


def carried(by: Array, covariance: Array) -> Array:
    """Transform covariances (M, K, K) of K values by matrices (M, K, K)."""
    return np.asarray(by @ covariance @ np.swapaxes(by, 1, 2))
