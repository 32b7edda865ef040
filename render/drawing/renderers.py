"""Renderers by name, one call: `render(membrane) -> image`."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ..design.sensor import SensorDesign
from ..membrane import Membrane
from .painter import Painter

#: Name and one line about each renderer.
RENDERERS = {
    "painter": "analytic anti-aliased ellipses, the fast default",
    "pyrender": "OpenGL meshes of both layers; needs the system's GL libraries",
}


class Renderer(Protocol):
    """Draws membranes of one sensor."""

    name: str

    def render(self, membrane: Membrane) -> NDArray[np.uint8]:
        """Noise-free sRGB image, shape (H, W, 3)."""

    def close(self) -> None:
        """Release what the renderer holds."""


def open_renderer(name: str, sensor: SensorDesign) -> Renderer:
    """Renderer of that name for one sensor; close it after the run.

    Raises
    ------
    UserError
        When there is no such renderer.
    UserError
        When pyrender is asked for where no OpenGL context can be made.
    """
    if name == "painter":
        return Painter(sensor)
    if name == "pyrender":
        from .mesh_renderer import MeshRenderer  # OpenGL is imported only where it is used

        return MeshRenderer(sensor)
    raise UserError(f"no renderer {name!r}; there is: {', '.join(RENDERERS)}")
