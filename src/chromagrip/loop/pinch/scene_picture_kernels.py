"""Compiled drawing of a solid by ray marching, for `scene_picture.py`."""

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit
from ...model.shapes import distance

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Index = NDArray[np.int64]

#: Largest number of steps of a ray.
_STEPS = 100


@njit()
def draw_solid(
    kind: int,
    numbers: Array,
    grid: Array,
    origin: Array,
    cells: float,
    reach: float,
    corner: Array,
    right: Array,
    down: Array,
    back: Array,
    met: float,
    light: Array,
    dark: float,
    colour: Array,
    above: Array,
    other: Array,
    window: Index,
    nearest: Array,
    picture: Image,
) -> None:
    """Draw a shape in front of farther ones; all vectors are in the shape's own frame.

    Parameters
    ----------
    kind, numbers, grid, origin, cells: shape, see `distance`
    reach: radius of a ball around the shape [m]
    corner: place of the picture's first pixel [m], (3,)
    right, down: steps to the next pixel along a row, and to the next row [m], (3,)
    back: unit vector from the picture to the eye, (3,)
    met: distance at which a ray has met the shape [m]
    light: unit vector to the light, (3,)
    dark: brightness of surfaces that the light does not reach
    colour: colour, RGB, (3,)
    above: direction of the half with the other colour, (3,); zeros: one colour
    other: colour of that half, RGB, (3,)
    window: first row, row after the last, and the same for columns, of the shape, (4,)
    nearest: height of the drawn surface above the picture's plane [m], (H, W) (changed)
    picture: picture, RGB, (H, W, 3) (changed)
    """
    start = np.empty(3)
    for row in range(window[0], window[1]):
        for column in range(window[2], window[3]):
            along, square = 0.0, 0.0
            for a in range(3):
                start[a] = corner[a] + column * right[a] + row * down[a]
                along += start[a] * back[a]
                square += start[a] * start[a]
            beside = square - along * along
            if beside >= reach * reach:
                continue
            half = np.sqrt(reach * reach - beside)
            height = half - along
            for _ in range(_STEPS):
                x = start[0] + height * back[0]
                y = start[1] + height * back[1]
                z = start[2] + height * back[2]
                gap, n_x, n_y, n_z = distance(kind, numbers, grid, origin, cells, x, y, z)
                if gap < met:
                    if height > nearest[row, column]:
                        nearest[row, column] = height
                        lit = max(0.0, n_x * light[0] + n_y * light[1] + n_z * light[2])
                        half_above = x * above[0] + y * above[1] + z * above[2] > 0.0
                        for a in range(3):
                            plain = other[a] if half_above else colour[a]
                            shade = plain * (dark + (1.0 - dark) * lit)
                            picture[row, column, a] = np.uint8(shade + 0.5)
                    break
                height -= gap
                if height + along < -half or height < nearest[row, column]:
                    break
