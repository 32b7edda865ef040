"""Markers of both layers in the rest frame."""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ..render import LAYERS, SensorDesign
from ..render.ground import inside_rim, pixel_places
from .unmixing import dye_densities, estimate_ground, unmixing_matrix

Array = NDArray[np.float64]


class DetectionError(ValueError):
    """The rest frame does not show the sensor's markers."""


def detect_markers(linear: Array, sensor: SensorDesign) -> tuple[Array, Array]:
    """Marker pairs of a rest frame and the ground between them.

    Parameters
    ----------
    linear: linear-light image of the unloaded sensor, shape (H, W, 3)
    sensor: calibration

    Returns
    -------
    pairs: centres [px] of magenta and yellow markers that sit on each other, shape (2, M, 2)
    ground: linear light of the unmarked skin, shape (H, W, 3)

    Raises
    ------
    DetectionError
        When fewer than nine tenths of the sensor's markers are found as pairs.
    """
    view = sensor.view
    if linear.shape != (view.height, view.width, 3):
        raise DetectionError(
            f"rest frame has shape {linear.shape}, the sensor's camera gives "
            f"{(view.height, view.width, 3)}"
        )
    skin = inside_rim(sensor, pixel_places(sensor)) > 2.0 * sensor.camera.blur_px
    middle = [sensor.shape.points(np.array([[1e-6, 0.0]]), depth) for depth in sensor.depths]
    gain = np.array([np.sqrt(np.linalg.det(view.jacobian(p)[0, :, :2])) for p in middle])
    size = gain * sensor.half_sizes
    expected = len(sensor.places)
    pitch = np.sqrt(skin.sum() / expected)
    ground = estimate_ground(linear, skin, pitch)
    densities = dye_densities(linear, ground, unmixing_matrix(sensor.transmittance))
    layers = [
        _blobs(np.where(skin, density, 0.0), area=np.pi * radius**2)
        for density, radius in zip(densities, size, strict=True)
    ]
    pairs = _pair(layers[0], layers[1], reach=float(size.max()))
    if pairs.shape[1] < 0.9 * expected:
        counts = ", ".join(f"{len(p)} {name}" for p, name in zip(layers, LAYERS, strict=True))
        raise DetectionError(
            f"rest frame shows {counts} markers, {pairs.shape[1]} of them as pairs; "
            f"the sensor has {expected}"
        )
    return pairs, ground


def _blobs(density: Array, area: float) -> Array:
    """Centres [px] of connected regions above half density and of plausible area, (n, 2)."""
    mask = (density > 0.5).astype(np.uint8)
    _, _, stats, centroids = cv2.connectedComponentsWithStats(mask)
    found = stats[:, cv2.CC_STAT_AREA]
    # The fisheye stretches markers at the rim by up to π/2.
    plausible = (found > 0.4 * area) & (found < 2.5 * area)
    plausible[0] = False  # the background
    return np.asarray(centroids[plausible], dtype=float)


def _pair(magenta: Array, yellow: Array, reach: float) -> Array:
    """Mutual nearest neighbours within `reach`, in a stable order, shape (2, M, 2)."""
    if len(magenta) == 0 or len(yellow) == 0:
        return np.empty((2, 0, 2))
    distance, partner = KDTree(yellow).query(magenta)
    partner = np.asarray(partner)
    back = np.asarray(KDTree(magenta).query(yellow)[1])
    mutual = (np.asarray(distance) < reach) & (back[partner] == np.arange(len(magenta)))
    return np.stack([magenta[mutual], yellow[partner[mutual]]])
