"""Pictures by brute force: every outline projected point by point, every pixel sampled many times.

Slow, and shares no code with the other renderers' coverage: it is what they are judged by.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage.draw import polygon

from .colour import encode_srgb
from .ground import ground_image
from .membrane import Membrane
from .outlines import outline_points
from .sensor import SensorDesign

Array = NDArray[np.float64]

#: Corners of an outline, and samples along a pixel's side.
CORNERS, SAMPLES = 180, 9


def projected_outlines(sensor: SensorDesign, membrane: Membrane) -> Array:
    """Corners of every marker's outline [px], shape (2, M, CORNERS, 2)."""
    angle = 2 * np.pi * np.arange(CORNERS) / CORNERS
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    if sensor.markers.form == "square":
        circle /= abs(circle).max(axis=-1, keepdims=True)
    return sensor.view.project(outline_points(membrane, circle))


def polygon_centroids(corners: Array) -> Array:
    """Centroids of polygons' areas, shape (…, 2), from corners (…, K, 2)."""
    # Far from the origin the formula loses digits.
    start = corners[..., :1, :]
    x, y = np.moveaxis(corners - start, -1, 0)
    x1, y1 = np.roll(x, -1, axis=-1), np.roll(y, -1, axis=-1)
    cross = x * y1 - x1 * y
    sums = np.stack([(x + x1) * cross, (y + y1) * cross], axis=-1).sum(axis=-2)
    return start[..., 0, :] + sums / (3.0 * cross.sum(axis=-1)[..., None])


def supersampled_coverage(sensor: SensorDesign, corners: Array) -> NDArray[np.float32]:
    """Share of each pixel covered by polygons (K, CORNERS, 2), blurred as the lens does, (H, W)."""
    height, width = sensor.view.height, sensor.view.width
    fine = np.zeros((height * SAMPLES, width * SAMPLES), dtype=np.uint8)
    for outline in corners:
        if np.isfinite(outline).all():
            # Fine pixel centres lie at integers too.
            x, y = ((outline + 0.5) * SAMPLES - 0.5).T
            fine[polygon(y, x, fine.shape)] = 255
    covered = cv2.resize(
        fine.astype(np.float32) / 255.0, (width, height), interpolation=cv2.INTER_AREA
    )
    return np.asarray(cv2.GaussianBlur(covered, (0, 0), sensor.camera.blur_px))


def supersampled_image(sensor: SensorDesign, membrane: Membrane) -> NDArray[np.uint8]:
    """Noise-free sRGB image of the membrane, shape (H, W, 3)."""
    linear = ground_image(sensor).astype(float)
    for corners, dye in zip(
        projected_outlines(sensor, membrane), sensor.transmittance, strict=True
    ):
        covered = supersampled_coverage(sensor, corners).astype(float)
        linear *= 1.0 - covered[..., None] * (1.0 - dye)
    return np.rint(encode_srgb(linear)).astype(np.uint8)
