"""The Cramér–Rao bound of marker positions: no unbiased tracker of single frames is better.

The levels of a frame are a function of the positions of both layers' markers, plus white noise.
The bound of a pair takes everything else as known: sizes, colours, light, and all other markers. It
is therefore the lowest bound.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...render import Membrane, SensorDesign, centroids, ground_image, outlines
from ...render.drawing import edge_width
from .kernels import fisher_information, pair_information

Array = NDArray[np.float64]


def position_limits(
    sensor: SensorDesign,
    membrane: Membrane,
    ground: Array,
    noise: float,
    *,
    defocus: float = 0.0,
    contrast: float = 1.0,
) -> Array:
    """Smallest standard deviation of (x, y) of each marker [px], NaN for absent ones, (2, M, 2).

    Parameters
    ----------
    sensor: design, with disc markers
    membrane: of the frame; absent markers have centres of NaN
    ground: linear light of the frame without its markers, shape (H, W, 3)
    noise: standard deviation of each sRGB level
    defocus: blur in addition to the lens [px]
    contrast: of the levels before noise
    """
    information = fisher_information(
        *marker_shapes(sensor, membrane),
        edge_width(float(np.hypot(sensor.camera.blur_px, defocus))),
        1.0 - sensor.transmittance,
        np.ascontiguousarray(ground, dtype=float),
        contrast,
    )
    return bounds(information, noise)


def pair_limits(sensor: SensorDesign, membrane: Membrane) -> Array:
    """Smallest covariance of (x, y, log size) of both layers' markers, (M, 6, 6), at noise 1 level.

    An invisible marker is infinitely uncertain.

    Parameters
    ----------
    sensor: design, with disc markers
    membrane: of the frame
    """
    information = pair_information(
        *marker_shapes(sensor, membrane),
        edge_width(sensor.camera.blur_px),
        1.0 - sensor.transmittance,
        _ground(sensor),
        1.0,
    )
    hidden = np.einsum("mii->mi", information) <= 0.0
    blank = np.einsum("mi,ij->mij", hidden, np.eye(6))
    return np.linalg.inv(information + blank) + 1e12 * blank


@lru_cache(maxsize=4)
def _ground(sensor: SensorDesign) -> Array:
    """Linear light without markers, shape (H, W, 3)."""
    return ground_image(sensor).astype(np.float64)


def marker_shapes(sensor: SensorDesign, membrane: Membrane) -> tuple[Array, Array]:
    """(c, a₁, a₂) of each marker [px], shape (2, M, 3, 2), and the inverses of (a₁, a₂) [1/px]."""
    coefficients = outlines(membrane, sensor.view)
    shapes = np.ascontiguousarray(coefficients[:, :, :3])
    shapes[:, :, 0] = centroids(coefficients, square=False)
    inverses = np.linalg.inv(np.swapaxes(shapes[:, :, 1:], -1, -2))
    return shapes, inverses.astype(np.float64)


def bounds(information: Array, noise: float) -> Array:
    """Standard deviations (2, M, 2) from information (M, 4, 4) at unit noise; NaN where none."""
    known = np.einsum("mii->mi", information) > 0.0
    # An absent marker takes no information from its partner.
    filled = information + np.einsum("mi,ij->mij", ~known, np.eye(4))
    variance = noise**2 * np.einsum("mii->mi", np.linalg.inv(filled))
    deviation = np.where(known, np.sqrt(variance), np.nan)
    return np.moveaxis(deviation.reshape(-1, 2, 2), 1, 0)
