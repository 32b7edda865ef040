"""Images of markers: each outline as a quadratic map from the unit disc or square to pixels.

p(q) = c + A·q + b₁₁q₁² + b₁₂q₁q₂ + b₂₂q₂². The linear part is the image of a small marker. The
second order is perspective, which moves the centroid of a tilted marker off its projected centre.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .membrane import Membrane
from .optics.view import View
from .place_kernels import outline_centroids, project_markers

Array = NDArray[np.float64]

_ANGLES = np.pi / 3 * np.arange(6)
#: Points q to project: the centre and six points of the unit circle, so that the third harmonic
#: does not leak into harmonics 0 to 2.
PROBES = np.concatenate([[[0.0, 0.0]], np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])])
_TERMS = np.column_stack(
    [
        np.ones(7),
        PROBES,
        PROBES[:, 0] ** 2,
        PROBES[:, 0] * PROBES[:, 1],
        PROBES[:, 1] ** 2,
    ]
)
#: Matrix from the pixels of the probes to the six coefficients of an outline (least squares).
_FIT = np.ascontiguousarray(np.linalg.pinv(_TERMS))


@lru_cache(maxsize=1)
def place_markers(membrane: Membrane, view: View) -> tuple[Array, Array]:
    """Projected centres (2, M, 2) and `outlines` (2, M, 6, 2) of every marker [px].

    The result for the last membrane is cached, read-only, as picture and labels share a membrane.
    """
    shape = membrane.centres.shape[:-1]
    pixels, coefficients = np.empty((*shape, 2)), np.empty((*shape, 6, 2))
    project_markers(
        np.ascontiguousarray(membrane.centres).reshape(-1, 3),
        np.ascontiguousarray(membrane.axes).reshape(-1, 3, 2),
        PROBES,
        _FIT,
        view.surface,
        view.camera.lens,
        pixels.reshape(-1, 2),
        coefficients.reshape(-1, 6, 2),
    )
    pixels.flags.writeable = coefficients.flags.writeable = False
    return pixels, coefficients


def outlines(membrane: Membrane, view: View) -> Array:
    """Coefficients (c, a₁, a₂, b₁₁, b₁₂, b₂₂) of every marker [px], shape (2, M, 6, 2)."""
    return place_markers(membrane, view)[1]


def outline_points(membrane: Membrane, q: Array) -> Array:
    """Points of every marker in the sensor frame [m], shape (2, M, K, 3).

    Parameters
    ----------
    membrane: markers in space
    q: coordinates of K points of the unit disc or square, shape (K, 2)
    """
    # One product of matrices instead of one for each marker.
    offsets = (membrane.axes.reshape(-1, 2) @ q.T).reshape(*membrane.axes.shape[:-1], len(q))
    return np.swapaxes(membrane.centres[..., None] + offsets, -1, -2)


def centroids(coefficients: Array, square: bool) -> Array:
    """Centroids of the outlines' areas in the image [px], shape (…, 2).

    They are ∫ p·|∂p/∂q| to second order, with a mean q₁² of 1/4 on the disc and 1/3 on the square.

    Parameters
    ----------
    coefficients: outlines, see `outlines` [px], shape (…, 6, 2)
    square: whether markers are squares, else discs
    """
    flat = np.ascontiguousarray(coefficients, dtype=float).reshape(-1, 6, 2)
    out = np.empty((len(flat), 2))
    outline_centroids(flat, 1.0 / 3.0 if square else 0.25, out)
    return out.reshape(*coefficients.shape[:-2], 2)


def areas(coefficients: Array, square: bool) -> Array:
    """Areas of the outlines in the image [px²], shape (…).

    Parameters
    ----------
    coefficients: outlines, see `outlines` [px], shape (…, 6, 2)
    square: whether markers are squares, else discs
    """
    return (4.0 if square else np.pi) * abs(
        _cross(coefficients[..., 1, :], coefficients[..., 2, :])
    )


def _cross(u: Array, v: Array) -> Array:
    """Cross product of vectors in the plane, (…, 2)."""
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
