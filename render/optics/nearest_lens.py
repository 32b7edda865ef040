"""The lens of five coefficients that is nearest to one of OpenCV's with 8, 12 or 14."""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ...errors import UserError
from .camera import projected
from .projection_kernels import NO_PORT, Lens

Array = NDArray[np.float64]

#: Largest distance of the images of both lenses [px].
ALLOWED_PX = 0.1
#: Columns and rows of the pixels at which they are compared, from edge to edge.
_GRID = (41, 31)
#: Newton steps from a pixel to its ray, and the distance in which they must end [px].
_ROUNDS, _CLOSE = 30, 1e-6


def nearest_lens(matrix: Array, distortion: Array, size: tuple[int, int]) -> tuple[Lens, float]:
    """Fit a pinhole with k₁, k₂, p₁, p₂, k₃ to a lens of more coefficients, over the image.

    Focal lengths and centre are fitted too.

    Parameters
    ----------
    matrix: camera matrix [px], shape (3, 3)
    distortion: coefficients in OpenCV's order, shape (8,), (12,) or (14,)
    size: width and height of the image [px]

    Returns
    -------
    the lens, and the largest distance of its image from that of the given one [px]

    Raises
    ------
    UserError
        When the distance is above ALLOWED_PX, or the given lens folds the image.
    """
    pixels = np.stack(
        np.meshgrid(*(np.linspace(0.0, n - 1.0, k) for n, k in zip(size, _GRID, strict=True))),
        axis=-1,
    ).reshape(-1, 2)
    rays = _rays(pixels, matrix, distortion)
    # Focal lengths and centre as shares of the width, so that all unknowns are of about one size.
    scale = np.array([size[0]] * 4 + [1.0] * 5)
    start = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *distortion[:5]]

    def off(values: Array) -> Array:
        return (projected(rays, NO_PORT, _lens(scale * values)) - pixels).ravel()

    found = least_squares(off, start / scale, x_scale="jac").x
    error = float(np.linalg.norm(off(found).reshape(-1, 2), axis=1).max())
    if not error <= ALLOWED_PX:
        raise UserError(
            f"the nearest lens with k1, k2, p1, p2, k3 is up to {error:.2g} px off its "
            f"{len(distortion)} coefficients; allowed: {ALLOWED_PX} px"
        )
    return _lens(scale * found), error


def _lens(values: Array) -> Lens:
    focal_x, focal_y, centre_x, centre_y, k1, k2, p1, p2, k3 = map(float, values)
    return Lens(False, focal_x, focal_y, centre_x, centre_y, (k1, k2, p1, p2, k3))


def _rays(pixels: Array, matrix: Array, distortion: Array) -> Array:
    """Directions (…, 3) whose image is at pixels (N, 2), by Newton's method."""
    zero = np.zeros(3)
    focal, centre = np.diag(matrix)[:2], matrix[:2, 2]
    rays = np.column_stack([(pixels - centre) / focal, np.ones(len(pixels))])
    off = np.full_like(pixels, np.inf)
    for _ in range(_ROUNDS):
        image, slope = cv2.projectPoints(rays, zero, zero, matrix, distortion)
        off = image.reshape(-1, 2) - pixels
        if not np.isfinite(off).all() or abs(off).max() < _CLOSE:
            break
        # A shift (columns 3, 4) of a point at depth 1 is one of its direction.
        jacobian = slope[:, 3:5].reshape(-1, 2, 2)
        singular = abs(np.linalg.det(jacobian)) < 1e-9
        jacobian[singular] = np.nan
        rays[:, :2] -= np.linalg.solve(jacobian, off[..., None])[..., 0]
    if not (np.isfinite(off).all() and abs(off).max() < _CLOSE):
        raise UserError(f"its {len(distortion)} coefficients fold the pinhole's image")
    return rays
