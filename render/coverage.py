"""Coverage of a pixel by a blurred ellipse: the profile that is painted, as table and kernel."""

import math

import numpy as np
from numpy.typing import NDArray

from ..model.compiled import njit

Array = NDArray[np.float64]

#: The edge profile is tabulated over ± this many standard deviations of the blur.
EDGE_RANGE = 4.0
_EDGE_STEPS = 512


def edge_table() -> Array:
    """Normal distribution function Φ over ±EDGE_RANGE, for linear interpolation."""
    grid = np.linspace(-EDGE_RANGE, EDGE_RANGE, _EDGE_STEPS + 1)
    return np.array([0.5 * (1.0 + math.erf(v / math.sqrt(2.0))) for v in grid])


def edge_width(blur: float) -> float:
    """Standard deviation of an edge: lens blur [px] and the pixel's own box of variance 1/12."""
    return math.sqrt(blur**2 + 1.0 / 12.0)


@njit()
def edge(table: Array, distance: float) -> float:
    """Coverage at a signed distance inside the edge, in standard deviations."""
    place = (distance + EDGE_RANGE) * (_EDGE_STEPS / (2.0 * EDGE_RANGE))
    if place <= 0.0:
        return 0.0
    if place >= _EDGE_STEPS:
        return 1.0
    index = int(place)
    return table[index] + (place - index) * (table[index + 1] - table[index])


@njit()
def signed_distance(
    dx: float, dy: float, inverse: Array, correction: float
) -> tuple[float, float, float]:
    """First-order distance of an offset from its centre to an ellipse's edge, positive inside.

    Parameters
    ----------
    dx, dy: offset from the centre [px]
    inverse: inverse of the matrix whose columns are the semi-axes [1/px], shape (2, 2)
    correction: s²/2 [px²]; blurring a curved edge moves its half level inwards by that over R

    Returns
    -------
    distance [px] and its gradient (x, y).
    """
    qx = inverse[0, 0] * dx + inverse[0, 1] * dy
    qy = inverse[1, 0] * dx + inverse[1, 1] * dy
    radius = math.sqrt(qx * qx + qy * qy)
    if radius < 1e-9:
        return 1e9, 0.0, 0.0
    gx = (inverse[0, 0] * qx + inverse[1, 0] * qy) / radius
    gy = (inverse[0, 1] * qx + inverse[1, 1] * qy) / radius
    slope = math.sqrt(gx * gx + gy * gy)
    return (1.0 - radius) / slope - correction * slope, -gx / slope, -gy / slope


@njit()
def paint_ellipses(
    image: NDArray[np.float32],
    centres: Array,
    shapes: Array,
    transmittance: Array,
    width: float,
    table: Array,
) -> None:
    """Multiply ellipses of a dye into a linear-light image, in place.

    Parameters
    ----------
    image: linear light, shape (H, W, 3)
    centres: [px], shape (M, 2)
    shapes: matrices whose columns are the semi-axes [px], shape (M, 2, 2)
    transmittance: of the dye, shape (3,)
    width: standard deviation of the edge [px]
    table: `edge_table()`
    """
    height, breadth = image.shape[0], image.shape[1]
    inverse = np.empty((2, 2))
    reach = EDGE_RANGE * width
    for m in range(centres.shape[0]):
        cx, cy = centres[m, 0], centres[m, 1]
        a, b, c, d = shapes[m, 0, 0], shapes[m, 0, 1], shapes[m, 1, 0], shapes[m, 1, 1]
        det = a * d - b * c
        if not (math.isfinite(cx + cy) and abs(det) > 1e-6):
            continue
        inverse[0, 0], inverse[0, 1] = d / det, -b / det
        inverse[1, 0], inverse[1, 1] = -c / det, a / det
        half_x = math.sqrt(a * a + b * b) + reach
        half_y = math.sqrt(c * c + d * d) + reach
        for row in range(max(0, int(cy - half_y)), min(height, int(cy + half_y) + 2)):
            for col in range(max(0, int(cx - half_x)), min(breadth, int(cx + half_x) + 2)):
                distance, _, _ = signed_distance(col - cx, row - cy, inverse, 0.5 * width * width)
                covered = edge(table, distance / width)
                if covered > 0.0:
                    for k in range(3):
                        image[row, col, k] *= 1.0 - covered * (1.0 - transmittance[k])


@njit()
def encode(linear: NDArray[np.float32], table: NDArray[np.uint8], out: NDArray[np.uint8]) -> None:
    """SRGB image (H, W, 3) of a linear-light one, by `colour.encoding_table`."""
    flat, result = linear.reshape(-1), out.reshape(-1)
    top = table.shape[0] - 1
    for i in range(flat.shape[0]):
        value = flat[i]
        index = int(min(max(value, 0.0), 1.0) * top + 0.5)
        result[i] = table[index]
