"""The fast renderer: analytic anti-aliased ellipses, layers multiplied in linear light."""

import numpy as np
from numpy.typing import NDArray

from .colour import encoding_table
from .coverage import edge_table, edge_width, encode, paint_ellipses
from .ground import ground_image
from .membrane import Membrane
from .sensor import SensorDesign


class Painter:
    """Draws each marker as the ellipse that its disc projects to."""

    name = "painter"

    def __init__(self, sensor: SensorDesign) -> None:
        self._lens = sensor.lens()
        self._dyes = sensor.transmittance
        self._width = edge_width(sensor.camera.blur_px)
        self._ground = ground_image(sensor)
        self._linear = np.empty_like(self._ground)
        self._edge = edge_table()
        self._encoding = encoding_table()

    def render(self, membrane: Membrane) -> NDArray[np.uint8]:
        """Noise-free sRGB image of the membrane, shape (H, W, 3)."""
        centres = self._lens.project(membrane.centres)
        shapes = self._lens.jacobian(membrane.centres) @ membrane.axes()
        np.copyto(self._linear, self._ground)
        for layer, dye in enumerate(self._dyes):
            paint_ellipses(
                self._linear, centres[layer], shapes[layer], dye, self._width, self._edge
            )
        image = np.empty(self._linear.shape, dtype=np.uint8)
        encode(self._linear, self._encoding, image)
        return image

    def close(self) -> None:
        """Nothing to release."""
