"""Images by brute force: outlines are projected point by point, pixels are sampled many times.

This is slow and shares no coverage code with the other renderers: it is their reference.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from ...extras import need
from ..colour import encode_srgb
from ..design.sensor import SensorDesign
from ..ground import ground_image
from ..membrane import Membrane
from ..outlines import outline_points

Array = NDArray[np.float64]

#: Number of corners of an outline.
CORNERS = 180
#: Number of samples along a pixel's side.
SAMPLES = 9


def projected_outlines(sensor: SensorDesign, membrane: Membrane) -> Array:
    """Corners of every marker's outline [px], shape (2, M, CORNERS, 2)."""
    angle = 2 * np.pi * np.arange(CORNERS) / CORNERS
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    if sensor.markers.form == "square":
        circle /= abs(circle).max(axis=-1, keepdims=True)
    return sensor.view.project(outline_points(membrane, circle))


def polygon_centroids(corners: Array) -> Array:
    """Centroids of the areas of polygons, shape (…, 2), from their K corners, (…, K, 2)."""
    # Far from the origin the formula loses digits.
    start = corners[..., :1, :]
    x, y = np.moveaxis(corners - start, -1, 0)
    x1, y1 = np.roll(x, -1, axis=-1), np.roll(y, -1, axis=-1)
    cross = x * y1 - x1 * y
    sums = np.stack([(x + x1) * cross, (y + y1) * cross], axis=-1).sum(axis=-2)
    return start[..., 0, :] + sums / (3.0 * cross.sum(axis=-1)[..., None])


def supersampled_image(sensor: SensorDesign, membrane: Membrane) -> NDArray[np.uint8]:
    """Noise-free sRGB image of the membrane, shape (H, W, 3).

    Light passes both dyes before the lens blurs it.
    """
    masks = [_fine_mask(sensor, corners) for corners in projected_outlines(sensor, membrane)]
    magenta, yellow = sensor.transmittance
    parts = [
        (_blurred(sensor, masks[0]), -(1.0 - magenta)),
        (_blurred(sensor, masks[1]), -(1.0 - yellow)),
        (_blurred(sensor, masks[0] & masks[1]), (1.0 - magenta) * (1.0 - yellow)),
    ]
    linear = ground_image(sensor) * (1.0 + sum(c[..., None] * dye for c, dye in parts))
    return np.rint(encode_srgb(linear)).astype(np.uint8)


def _fine_mask(sensor: SensorDesign, corners: Array) -> NDArray[np.uint8]:
    """Rasterise K polygons [px], (K, CORNERS, 2), on the samples: 255 if covered, else 0."""
    polygon = need("skimage.draw", "images").polygon
    shape = (sensor.view.height * SAMPLES, sensor.view.width * SAMPLES)
    fine = np.zeros(shape, dtype=np.uint8)
    for outline in corners:
        if np.isfinite(outline).all():
            # Fine pixel centres lie at integers too.
            x, y = ((outline + 0.5) * SAMPLES - 0.5).T
            fine[polygon(y, x, shape)] = 255
    return fine


def _blurred(sensor: SensorDesign, fine: NDArray[np.uint8]) -> Array:
    """Blur the samples by the lens, and average them over each pixel, shape (H, W)."""
    image = cv2.GaussianBlur(
        fine.astype(np.float32) / 255.0, (0, 0), SAMPLES * sensor.camera.blur_px
    )
    size = (sensor.view.width, sensor.view.height)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=float)
