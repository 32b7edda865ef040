"""The unmarked sensor: diffusing skin, darker towards the rim, in a dark housing."""

import numpy as np
from numpy.typing import NDArray

from .colour import decode_srgb
from .sensor import SensorDesign


def ground_image(sensor: SensorDesign) -> NDArray[np.float32]:
    """Linear light of the sensor without markers, shape (H, W, 3)."""
    lens = sensor.lens()
    y, x = np.mgrid[: lens.height, : lens.width].astype(float)
    angle = lens.directions(np.stack([x, y], axis=-1))[..., 0]
    share = np.clip(angle / (np.pi / 2), 0.0, 1.0)[..., None] ** 4
    apex, rim, housing = (
        decode_srgb(np.array(level, dtype=float))
        for level in (sensor.ground.apex, sensor.ground.rim, sensor.ground.housing)
    )
    skin = apex + share * (rim - apex)
    # The dome's edge is as sharp as the lens: one blur width.
    edge = np.clip((np.pi / 2 - angle) * lens.focal / sensor.camera.blur_px + 0.5, 0.0, 1.0)
    return (housing + edge[..., None] * (skin - housing)).astype(np.float32)
