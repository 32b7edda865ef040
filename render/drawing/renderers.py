"""Renderers by name: built-in ones, installed plug-ins, and any `module:Class`."""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...by_name import Choice, Registry, blaming, name_of
from ..design.sensor import SensorDesign
from ..membrane import Membrane


class Renderer(Protocol):
    """Draws the membranes of one sensor; constructed by `Class(sensor)`."""

    def render(self, membrane: Membrane) -> NDArray[np.uint8]:
        """Noise-free sRGB image, shape (H, W, 3).

        The image depends on the membrane alone. The caller may change the array.
        """
        ...

    def close(self) -> None:
        """Release the renderer's resources."""
        ...


#: Renderers by name.
RENDERERS = Registry(
    protocol=Renderer,
    package=__package__,
    given=1,
    entries={
        "painter": (".painter:Painter", "analytic anti-aliased ellipses, the fast default"),
        "pyrender": (
            ".mesh_renderer:MeshRenderer",
            "OpenGL meshes of both layers; needs the system's GL libraries",
        ),
    },
)


def open_renderer(
    choice: Choice, sensor: SensorDesign, arguments: Mapping[str, Any] | None = None
) -> Renderer:
    """Make a renderer for one sensor; close it after the run.

    Parameters
    ----------
    choice: name of a built-in renderer or of an entry point, `module:Class`, or a class or other
        factory
    sensor: sensor to draw
    arguments: further arguments of the class, by name

    Raises
    ------
    UserError
        When no renderer has that name, or it cannot be imported or made, such as pyrender without
        an OpenGL context.
    """
    factory = RENDERERS.load(choice, arguments)
    renderer: Renderer
    if choice in RENDERERS.entries:
        renderer = factory(sensor)
        return renderer
    with blaming(f"renderer {name_of(choice)!r} cannot be made", Exception, SystemExit):
        renderer = factory(sensor)
    return renderer
