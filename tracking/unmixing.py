"""From an image to the densities of the dyes (Beer–Lambert), free of shading and crosstalk."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Unmarked skin lies this close to the shading; wide enough for noise, too narrow for an edge.
_PLAIN_RATIO = 0.08
#: A density from which on a pixel is not plainly ground.
_TOUCHED = 0.2
#: Of the pixels that the shading is fitted to, along rows and columns.
_STRIDE = 4


def unmixing_matrix(transmittance: Array) -> Array:
    """Least-squares map from log attenuation (R, G, B) to dye densities, shape (L, 3).

    A density is 1 inside a marker of that dye and 0 outside, whatever the other layer does.
    """
    return np.linalg.pinv(-np.log(transmittance).T)


def dye_densities(linear: Array, ground: Array, matrix: Array) -> Array:
    """Density of each dye per pixel, shape (L, H, W)."""
    attenuation = -np.log(np.maximum(linear, 1e-4) / np.maximum(ground, 1e-4))
    return np.einsum("kc,ijc->kij", matrix, attenuation)


def rough_ground(linear: Array, size: int, bright: bool) -> Array:
    """Ground as the lightest light near each pixel; the darkest where markers are brighter.

    Parameters
    ----------
    linear: linear-light image, shape (H, W, 3)
    size: larger than a marker [px]
    bright: whether markers are brighter than the ground
    """
    small = min(4, max(1, size // 12))
    height, width = linear.shape[:2]
    # The median takes out noise, whose extremes morphology would find.
    image = np.ascontiguousarray(linear, dtype=np.float32)
    image = np.asarray(cv2.medianBlur(image, 5))
    reduced = cv2.resize(image, (width // small, height // small), interpolation=cv2.INTER_AREA)
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size // small | 1, size // small | 1))
    operation = cv2.MORPH_OPEN if bright else cv2.MORPH_CLOSE
    found = cv2.morphologyEx(reduced, operation, around, borderType=cv2.BORDER_REPLICATE)
    found = cv2.GaussianBlur(found, (0, 0), 0.15 * size / small)
    return np.asarray(cv2.resize(found, (width, height)), dtype=float)


def plain_pixels(densities: Array, field: NDArray[np.bool_], margin: int) -> NDArray[np.bool_]:
    """Pixels of a field that are clear of markers of any layer by a margin [px], shape (H, W)."""
    touched: Any = (abs(densities) > _TOUCHED).any(axis=0).astype(np.uint8)
    # A speck of noise is no marker.
    touched = cv2.morphologyEx(touched, cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * margin + 1, 2 * margin + 1))
    return field & ~cv2.dilate(touched, around).astype(bool)


def estimate_ground(linear: Array, plain: NDArray[np.bool_], scale: float) -> Array:
    """Linear light of the unmarked skin, from the pixels between the markers.

    A polynomial in (x, y) takes out the shading of the dome; what is left is smoothed locally.

    Parameters
    ----------
    linear: linear-light image, shape (H, W, 3)
    plain: pixels that show unmarked skin, shape (H, W)
    scale: smoothing, about the distance between markers [px]

    Returns
    -------
    Ground under every pixel, shape (H, W, 3).
    """
    shading = np.ones_like(linear)
    for _ in range(3):
        shading = _polynomial_shading(linear, plain)
        ratio = linear / shading
        plain = plain & (abs(ratio - 1.0) < _PLAIN_RATIO).all(axis=2)
    height, width = plain.shape
    small = (width // _STRIDE, height // _STRIDE)
    parts: Any = np.dstack([ratio * plain[..., None], plain]).astype(np.float32)
    parts = cv2.resize(parts, small, interpolation=cv2.INTER_AREA)
    parts = cv2.GaussianBlur(parts, (0, 0), scale / _STRIDE)
    # Where no plain pixel is near, the polynomial alone stands.
    local = (parts[..., :3] + 1e-3) / (parts[..., 3:] + 1e-3)
    return shading * cv2.resize(local, (width, height), interpolation=cv2.INTER_LINEAR)


def _polynomial_shading(linear: Array, plain: NDArray[np.bool_]) -> Array:
    """Log-polynomial through the plain pixels, per channel, shape (H, W, 3)."""
    height, width = plain.shape
    # So smooth that every fourth pixel tells it, and shows it.
    rows, cols = np.arange(0, height + 3, _STRIDE), np.arange(0, width + 3, _STRIDE)
    y, x = np.meshgrid(rows / (height / 2) - 1.0, (cols - width / 2) / (height / 2), indexing="ij")
    powers = [(i, j) for i in range(7) for j in range(7 - i)]
    x_powers, y_powers = (np.cumprod([np.ones_like(v)] + 6 * [v], axis=0) for v in (x, y))
    across = np.stack([x_powers[i] * y_powers[j] for i, j in powers], axis=-1)
    sample = np.zeros(x.shape, dtype=np.bool_)
    inside = plain[::_STRIDE, ::_STRIDE]
    sample[: inside.shape[0], : inside.shape[1]] = inside
    target = np.log(np.maximum(linear[::_STRIDE, ::_STRIDE][inside], 1e-4))
    coefficients = np.linalg.lstsq(across[sample], target, rcond=None)[0]
    # Outside the dome the polynomial runs away; nothing reads it there.
    shading = np.exp(np.clip(across @ coefficients, -6.0, 1.0)).astype(np.float32)
    at_x, at_y = np.meshgrid(np.arange(width) / _STRIDE, np.arange(height) / _STRIDE)
    return np.asarray(
        cv2.remap(shading, at_x.astype(np.float32), at_y.astype(np.float32), cv2.INTER_LINEAR),
        dtype=float,
    )
