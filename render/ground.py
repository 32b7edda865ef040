"""The unmarked sensor: diffusing skin, darker towards the rim, in a dark housing."""

import numpy as np
from numpy.typing import NDArray

from .colour import decode_srgb
from .design.sensor import SensorDesign

Array = NDArray[np.float64]


def pixel_grid(sensor: SensorDesign) -> Array:
    """Coordinates (x, y) of every pixel [px], shape (H, W, 2)."""
    y, x = np.mgrid[: sensor.view.height, : sensor.view.width].astype(float)
    return np.stack([x, y], axis=-1)


def pixel_places(sensor: SensorDesign) -> Array:
    """Place on the resting skin that each pixel shows, NaN off the skin, shape (H, W, 2)."""
    return sensor.shape.meet(*sensor.view.trace(pixel_grid(sensor)), 0.0)


def inside_rim(sensor: SensorDesign, places: Array) -> Array:
    """Distance in the image from the edge of the skin, positive inside [px], shape (H, W).

    Parameters
    ----------
    sensor: design of the sensor
    places: places on the resting skin, from `pixel_places`, shape (H, W, 2)
    """
    distance = sensor.shape.rim_distance(places)
    slope = np.hypot(*np.gradient(distance))
    return np.where(np.isfinite(distance), distance, -1.0) / np.maximum(
        np.nan_to_num(slope, nan=1e-9), 1e-9
    )


def ground_image(sensor: SensorDesign) -> NDArray[np.float32]:
    """Linear-light image of the sensor without markers, float32, shape (H, W, 3)."""
    places = pixel_places(sensor)
    share = np.nan_to_num(np.clip(places[..., 0] / sensor.shape.rim, 0.0, 1.0), nan=1.0)
    apex, rim, housing = (
        decode_srgb(np.array(level, dtype=float))
        for level in (sensor.ground.apex, sensor.ground.rim, sensor.ground.housing)
    )
    skin = apex + share[..., None] ** 4 * (rim - apex)
    if sensor.seams is not None:
        skin *= 1.0 - seam_cover(sensor, places)[..., None] * (
            1.0 - decode_srgb(np.array(sensor.seams.colour, dtype=float)) / apex
        )
    # The skin's edge is as sharp as the lens: one blur width.
    edge = np.clip(inside_rim(sensor, places) / sensor.camera.blur_px + 0.5, 0.0, 1.0)
    return (housing + edge[..., None] * (skin - housing)).astype(np.float32)


def seam_cover(sensor: SensorDesign, places: Array) -> Array:
    """Share of each pixel covered by a seam, shape (H, W): soft edges, uneven width like glue."""
    assert sensor.seams is not None
    first, phi = np.nan_to_num(places[..., 0]), np.nan_to_num(places[..., 1])
    metric = sensor.shape.metric(0.0)
    gap = 2 * np.pi / sensor.seams.count
    number = np.rint(phi / gap)
    aside = abs(np.sin(phi - number * gap)) * sensor.shape.ring(first) * metric
    along = first * metric * 1e3  # [mm]
    wave = np.sin(0.9 * along + 2.1 * number) + 0.6 * np.sin(2.3 * along + 5.3 * number)
    half = 0.5e-3 * sensor.seams.width_mm * (1.0 + 0.3 * wave)
    faint = 0.75 + 0.25 * np.sin(1.3 * along + 3.7 * number)
    return faint * np.exp(-((aside / half) ** 2))
