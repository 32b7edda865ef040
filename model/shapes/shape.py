"""The shape of an object: its signed distance, and how far it reaches down when it is turned."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import UserError
from ..kernels.dome import distance_kernels as kernels

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Shape:
    """A shape in its own frame, with what the kernel `distance` takes.

    A fingertip's apex points to +z and the object lies above it. A plane fills z > 0; a mesh has
    the origin of its file, every other shape its centre at the origin. The arrays cannot be
    written.

    Attributes
    ----------
    name: such as `ball`, or a mesh's file name
    kind: which of the kernel's shapes it is
    numbers: (8,) of the kind; lengths in m
    grid: (I, J, K) coefficients of a mesh's distance [m]; (1, 1, 1) for the others
    origin: (3,) place of the grid's first coefficient [m]
    cells: of the grid per metre
    bounds: (2, 3) lowest and highest corner of the axis-aligned box around the shape [m]; infinite
        where the shape has no end
    corners: (N, 3) points of a mesh's convex hull [m]; none for the others
    notes: one sentence about each thing that was mended in a mesh
    """

    name: str
    kind: int
    numbers: Array
    grid: Array
    origin: Array
    cells: float
    bounds: Array
    corners: Array
    notes: tuple[str, ...] = ()

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Make a copy whose arrays cannot be written either: kernels compile for both kinds."""
        for value in state.values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        self.__dict__.update(state)

    def reach_down(self, rotation: ArrayLike | None = None) -> float:
        """How far the turned shape reaches below its origin, as `reach_down`."""
        return reach_down(self, rotation)


def make_shape(
    name: str,
    kind: int,
    numbers: ArrayLike = (),
    *,
    grid: ArrayLike | None = None,
    origin: ArrayLike = (0.0, 0.0, 0.0),
    cells: float = 1.0,
    bounds: ArrayLike | None = None,
    corners: ArrayLike | None = None,
    notes: tuple[str, ...] = (),
) -> Shape:
    """A shape whose arrays are of the kernel's sizes and cannot be written; as `Shape`.

    Parameters
    ----------
    numbers: the first ones; the others are zero
    bounds: by default as far as the shape reaches along each axis
    """
    given = np.asarray(numbers, float)
    whole = np.zeros(8)
    whole[: given.size] = given
    shape = Shape(
        name=name,
        kind=kind,
        numbers=_kept(whole),
        grid=_kept(np.zeros((1, 1, 1)) if grid is None else grid),
        origin=_kept(origin),
        cells=float(cells),
        bounds=_kept(np.zeros((2, 3)) if bounds is None else bounds),
        corners=_kept(np.empty((0, 3)) if corners is None else corners),
        notes=notes,
    )
    if bounds is None:
        high = [support(shape, axis) for axis in np.eye(3)]
        low = [-support(shape, -axis) for axis in np.eye(3)]
        object.__setattr__(shape, "bounds", _kept([low, high]))
    return shape


def moved(shape: Shape, by: Array) -> Shape:
    """A mesh's shape whose origin is elsewhere: the shape is moved in its own frame by (3,) [m]."""
    return replace(
        shape,
        origin=_kept(shape.origin + by),
        bounds=_kept(shape.bounds + by),
        corners=_kept(shape.corners + by),
    )


def _kept(values: ArrayLike) -> Array:
    array = np.array(values, dtype=float, order="C")
    array.setflags(write=False)
    return array


def distances(shape: Shape, points: ArrayLike) -> tuple[Array, Array]:
    """Signed distances and outward normals of points.

    Near its surface a mesh's are exact to 0.03 cells where it is smooth; sharp edges are rounded by
    about a cell, by which a distance is up to 0.3 cells off. Farther than six cells a distance is
    up to two cells off. Beyond the grid it is nearly a lower bound.

    Parameters
    ----------
    points: (N, 3) in the shape's own frame [m]

    Returns
    -------
    Distances (N,) [m], negative inside, and unit normals (N, 3).
    """
    places = np.ascontiguousarray(points, dtype=float)
    gap, normal = kernels.distances(
        shape.kind, shape.numbers, shape.grid, shape.origin, shape.cells, places
    )
    return gap, normal


def reach_down(shape: Shape, rotation: ArrayLike | None = None) -> float:
    """How far a turned shape reaches below its own origin: to the highest plane z that is below it.

    Placed so much above a fingertip's apex, it cannot be in the fingertip. A plane, and a cylinder
    without ends that is tilted, reach down for ever; for these it is the distance to the surface
    straight below the origin.

    Parameters
    ----------
    rotation: (3, 3) from the shape's own frame to the world's; by default it is not turned

    Returns
    -------
    The distance [m].

    Raises
    ------
    UserError
        For a cylinder without ends that stands upright.
    """
    turn = np.eye(3) if rotation is None else np.asarray(rotation, float)
    down = -turn[2]
    if shape.kind in (kernels.PLANE, kernels.QUADRIC):
        return 0.0
    reach = support(shape, down)
    if np.isfinite(reach):
        return reach
    across = float(np.hypot(down[0], down[2]))
    if across < 1e-3:
        raise UserError("a cylinder without ends must not stand upright; give it a length")
    return float(shape.numbers[0]) / across


def support(shape: Shape, direction: ArrayLike) -> float:
    """How far a shape reaches from its origin along a direction [m]; infinite where it has no end.

    Parameters
    ----------
    direction: (3,) of length one, in the shape's own frame
    """
    x, y, z = (float(value) for value in np.asarray(direction, float))
    numbers = [float(value) for value in shape.numbers]
    if shape.kind == kernels.BALL:
        return numbers[0]
    if shape.kind == kernels.CYLINDER:
        radius, half, rounding = numbers[:3]
        end = abs(y) * (half - rounding) if abs(y) > 1e-12 else 0.0
        return end + np.hypot(x, z) * (radius - rounding) + rounding
    if shape.kind == kernels.BOX:
        return abs(x) * numbers[0] + abs(y) * numbers[1] + abs(z) * numbers[2] + numbers[3]
    if shape.kind == kernels.CAPSULE:
        return abs(y) * numbers[1] + numbers[0]
    if shape.kind == kernels.TORUS:
        return float(np.hypot(x, z)) * numbers[0] + numbers[1]
    if shape.kind == kernels.CONE:
        tip, base, rim, rounding = numbers[:4]
        return max(z * tip, z * base + float(np.hypot(x, y)) * rim) + rounding
    if shape.kind == kernels.GRID:
        return float((shape.corners @ [x, y, z]).max())
    return 0.0 if z <= -1.0 + 1e-12 else np.inf  # a plane or a quadric, which may have no end
