"""A picture of solids in space from one side, by ray marching along the shapes' distances."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...model.shapes import Shape
from .scene_picture_kernels import draw_solid

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Colour = tuple[int, int, int]


@dataclass(frozen=True, kw_only=True)
class Body:
    """A solid in space.

    Attributes
    ----------
    shape: shape in its own frame
    place, rotation: place [m] and rotation of that frame in the world, shapes (3,) and (3, 3)
    colour: colour, RGB
    above, other: direction in the shape's own frame, shape (3,), and colour of the half of the
        shape on that side of its origin, which shows a turn (default: one colour)
    """

    shape: Shape
    place: Array
    rotation: Array
    colour: Colour
    above: Array | None = None
    other: Colour = (0, 0, 0)

    @property
    def corners(self) -> Array:
        """Corners of the box around the shape, in the world [m], shape (8, 3)."""
        low, high = self.shape.bounds
        choice = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1]), axis=-1).reshape(-1, 3)
        return np.asarray(self.place + np.where(choice == 1, high, low) @ self.rotation.T)


@dataclass(frozen=True, kw_only=True)
class Viewpoint:
    """Parallel projection of the world.

    Attributes
    ----------
    middle: point in the middle of the picture [m], shape (3,)
    right, up: unit vectors of the world along the picture, shape (3,)
    width, height: size of the picture [px]
    pixel: side of a pixel [m]
    """

    middle: Array
    right: Array
    up: Array
    width: int
    height: int
    pixel: float

    @property
    def towards(self) -> Array:
        """Unit vector from the world to the eye, shape (3,)."""
        return np.cross(self.right, self.up)

    def project(self, points: Array) -> Array:
        """Pixels (…, 2) of points (…, 3)."""
        off = (points - self.middle) / self.pixel
        across, above = off @ self.right, off @ self.up
        return np.stack([0.5 * (self.width - 1) + across, 0.5 * (self.height - 1) - above], axis=-1)


def look_from(
    middle: Array, right: Array, up: Array, *, above: float, size: tuple[int, int], span: float
) -> Viewpoint:
    """Viewpoint in front of a plane, raised by an angle.

    Parameters
    ----------
    middle: see `Viewpoint`
    right, up: unit vectors of the plane, perpendicular to each other
    above: angle of the view downwards [rad]
    size: width and height of the picture [px]
    span: width of the drawn part of the world [m]
    """
    out = np.cross(right, up)
    return Viewpoint(
        middle=middle,
        right=right,
        up=np.cos(above) * up - np.sin(above) * out,
        width=size[0],
        height=size[1],
        pixel=span / size[0],
    )


def draw_bodies(bodies: Sequence[Body], view: Viewpoint) -> Image:
    """Picture of bodies, RGB, shape (height, width, 3).

    Raises
    ------
    UserError
        For a body of infinite size.
    """
    light = 0.35 * view.up + 0.25 * view.right + view.towards
    light /= np.linalg.norm(light)
    nearest = np.full((view.height, view.width), -np.inf)
    paper = 255  # background, RGB
    picture = np.full((view.height, view.width, 3), paper, np.uint8)
    left, top = -0.5 * (view.width - 1), 0.5 * (view.height - 1)
    corner = view.middle + view.pixel * (left * view.right + top * view.up)
    met = 0.2  # distance at which a ray has met a shape [px]
    dark = 0.45  # brightness of a surface that the light does not reach
    for body in bodies:
        shape, own = body.shape, body.rotation.T
        above = np.zeros(3) if body.above is None else np.ascontiguousarray(body.above, float)
        reach = float(np.linalg.norm(np.abs(shape.bounds).max(axis=0)))
        if not np.isfinite(reach):
            raise UserError(f"a {shape.name} of infinite size cannot be drawn")
        draw_solid(
            shape.kind, shape.numbers, shape.grid, shape.origin, shape.cells, reach,
            own @ (corner - body.place), own @ (view.pixel * view.right),
            own @ (-view.pixel * view.up), own @ view.towards, met * view.pixel, own @ light,
            dark, np.array(body.colour, float), above, np.array(body.other, float),
            _window(body, view), nearest, picture,
        )  # fmt: skip
    return picture


def _window(body: Body, view: Viewpoint) -> NDArray[np.int64]:
    """First row, row after the last, and the same for columns, of a body, shape (4,)."""
    x, y = view.project(body.corners).T
    rows = np.clip([np.floor(y.min()), np.ceil(y.max()) + 1.0], 0, view.height)
    columns = np.clip([np.floor(x.min()), np.ceil(x.max()) + 1.0], 0, view.width)
    return np.concatenate([rows, columns]).astype(np.int64)
