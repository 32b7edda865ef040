"""From an image to the densities of the two dyes (Beer–Lambert), free of shading and crosstalk."""

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Skin, even where the rim tints it, keeps its channels within this share of each other …
_PLAIN_CHROMA = 0.35
#: … and lies this close to the shading; wide enough for noise, too narrow for a marker's edge.
_PLAIN_RATIO = 0.08


def unmixing_matrix(transmittance: Array) -> Array:
    """Least-squares map from log attenuation (R, G, B) to dye densities, shape (2, 3).

    A density is 1 inside a marker of that dye and 0 outside, whatever the other layer does.
    """
    return np.linalg.pinv(-np.log(transmittance).T)


def estimate_ground(linear: Array, skin: NDArray[np.bool_], scale: float) -> Array:
    """Linear light of the unmarked skin, from the pixels between the markers.

    A polynomial in (x, y) takes out the shading of the dome; what is left is smoothed locally.

    Parameters
    ----------
    linear: linear-light image, shape (H, W, 3)
    skin: pixels that show the dome, shape (H, W)
    scale: smoothing, about the distance between markers [px]

    Returns
    -------
    Ground under every pixel, shape (H, W, 3).
    """
    # A dye takes one channel away: unmarked skin is the part that has kept its colours together.
    chroma = 1.0 - linear.min(axis=2) / np.maximum(linear.max(axis=2), 1e-6)
    plain = skin & (chroma < _PLAIN_CHROMA)
    # Blurred edges of markers are almost plain; stay clear of them.
    plain = cv2.erode(plain.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
    shading = np.ones_like(linear)
    for _ in range(3):
        shading = _polynomial_shading(linear, plain)
        ratio = linear / shading
        plain &= (abs(ratio - 1.0) < _PLAIN_RATIO).all(axis=2)
    weight = cv2.GaussianBlur(plain.astype(np.float64), (0, 0), scale)
    total = cv2.GaussianBlur(ratio * plain[..., None], (0, 0), scale)
    # Where no plain pixel is near, the polynomial alone stands.
    return shading * (total + 1e-3) / (weight + 1e-3)[..., None]


def _polynomial_shading(linear: Array, plain: NDArray[np.bool_]) -> Array:
    """Log-polynomial through the plain pixels, per channel, shape (H, W, 3)."""
    height, width = plain.shape
    y, x = np.mgrid[:height, :width] / (height / 2) - np.array([1.0, width / height])[:, None, None]
    powers = [(i, j) for i in range(7) for j in range(7 - i)]
    sample = np.zeros_like(plain)
    sample[::2, ::2] = plain[::2, ::2]
    design = np.stack([x[sample] ** i * y[sample] ** j for i, j in powers], axis=1)
    target = np.log(np.maximum(linear[sample], 1e-4))
    coefficients = np.linalg.lstsq(design, target, rcond=None)[0]
    out = np.zeros_like(linear)
    for (i, j), row in zip(powers, coefficients, strict=True):
        out += (x**i * y**j)[..., None] * row
    # Outside the dome the polynomial runs away; nothing reads it there.
    return np.exp(np.clip(out, -6.0, 1.0))


def dye_densities(linear: Array, ground: Array, matrix: Array) -> Array:
    """Density of each dye per pixel, shape (2, H, W)."""
    attenuation = -np.log(np.maximum(linear, 1e-4) / np.maximum(ground, 1e-4))
    return np.einsum("kc,ijc->kij", matrix, attenuation)
