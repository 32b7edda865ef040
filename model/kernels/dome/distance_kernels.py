"""Compiled signed distances of the shapes that `shapes` documents, each in its own frame.

What a shape's numbers mean is said where they are made, in `shapes/primitives.py`. Every normal is
of length one: where none is defined, as at a centre, one of the possible ones is taken.
"""

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit

Array = NDArray[np.float64]
#: Distance and outward normal.
Reading = tuple[float, float, float, float]

PLANE, BALL, CYLINDER, BOX, CAPSULE, TORUS, CONE, GRID, QUADRIC = range(9)

#: Shorter vectors have no direction; their squares would be lost below the smallest number [m].
TINY = 1e-140


@njit()
def distance(
    kind: int,
    numbers: Array,
    grid: Array,
    origin: Array,
    cells: float,
    x: float,
    y: float,
    z: float,
) -> Reading:
    """Signed distance of a point [m], negative inside, and the outward unit normal there.

    Parameters
    ----------
    kind: one of the constants above
    numbers: (8,) of the shape; lengths in m
    grid: (I, J, K) coefficients of the cubic B-spline [m]; (1, 1, 1) unless the kind is GRID
    origin: (3,) place of the grid's first coefficient [m]
    cells: of the grid per metre
    x, y, z: the point in the shape's own frame [m]
    """
    if kind == PLANE:
        return -z, 0.0, 0.0, -1.0
    if kind == BALL:
        return _off(x, y, z, numbers[0])
    if kind == CYLINDER:
        return _cylinder(numbers, x, y, z)
    if kind == BOX:
        return _box(numbers, x, y, z)
    if kind == CAPSULE:
        foot = min(max(y, -numbers[1]), numbers[1])
        return _off(x, y - foot, z, numbers[0])
    if kind == TORUS:
        return _torus(numbers, x, y, z)
    if kind == CONE:
        return _cone(numbers, x, y, z)
    if kind == QUADRIC:
        return _quadric(numbers, x, y, z)
    return _grid(grid, origin, cells, x, y, z)


@njit()
def distances(
    kind: int, numbers: Array, grid: Array, origin: Array, cells: float, points: Array
) -> tuple[Array, Array]:
    """Signed distances (N,) and normals (N, 3) of points (N, 3), as `distance`."""
    gap = np.empty(points.shape[0])
    normal = np.empty(points.shape)
    for i in range(points.shape[0]):
        gap[i], normal[i, 0], normal[i, 1], normal[i, 2] = distance(
            kind, numbers, grid, origin, cells, points[i, 0], points[i, 1], points[i, 2]
        )
    return gap, normal


@njit()
def _off(x: float, y: float, z: float, radius: float) -> Reading:
    """Distance from a ball around the point that (x, y, z) starts at, with its normal."""
    length = np.sqrt(x * x + y * y + z * z)
    if length < TINY:
        return length - radius, 0.0, 0.0, -1.0
    return length - radius, x / length, y / length, z / length


@njit()
def _direction(x: float, z: float) -> tuple[float, float, float]:
    """Length and direction of a vector; the direction is −z where it has none."""
    length = np.sqrt(x * x + z * z)
    if length < TINY:
        return length, 0.0, -1.0
    return length, x / length, z / length


@njit()
def _cylinder(numbers: Array, x: float, y: float, z: float) -> Reading:
    """Cylinder along y: a rectangle in distance from the axis and along it, with rounded rims."""
    rounding = numbers[2]
    rho, e_x, e_z = _direction(x, z)
    side = 1.0 if y >= 0.0 else -1.0
    out, beyond = rho - (numbers[0] - rounding), abs(y) - (numbers[1] - rounding)
    if out <= 0.0 or beyond <= 0.0:
        if out >= beyond:
            return out - rounding, e_x, 0.0, e_z
        return beyond - rounding, 0.0, side, 0.0
    length, n_rho, n_y = _direction(out, beyond)
    return length - rounding, n_rho * e_x, n_y * side, n_rho * e_z


@njit()
def _box(numbers: Array, x: float, y: float, z: float) -> Reading:
    """Box with rounded edges: an inner box of half edges, grown by the rounding."""
    rounding = numbers[3]
    out_x, out_y, out_z = abs(x) - numbers[0], abs(y) - numbers[1], abs(z) - numbers[2]
    side_x = 1.0 if x >= 0.0 else -1.0
    side_y = 1.0 if y >= 0.0 else -1.0
    side_z = 1.0 if z > 0.0 else -1.0
    largest = max(out_x, out_y, out_z)
    if largest > TINY:
        far_x, far_y, far_z = max(out_x, 0.0), max(out_y, 0.0), max(out_z, 0.0)
        gap, n_x, n_y, n_z = _off(far_x, far_y, far_z, rounding)
        return gap, n_x * side_x, n_y * side_y, n_z * side_z
    if out_z == largest:
        return out_z - rounding, 0.0, 0.0, side_z
    if out_x == largest:
        return out_x - rounding, side_x, 0.0, 0.0
    return out_y - rounding, 0.0, side_y, 0.0


@njit()
def _torus(numbers: Array, x: float, y: float, z: float) -> Reading:
    """Torus around the axis y."""
    rho, e_x, e_z = _direction(x, z)
    out = rho - numbers[0]
    length, n_rho, n_y = _direction(out, y)
    if length < TINY:
        n_rho, n_y = 1.0, 0.0
    return length - numbers[1], n_rho * e_x, n_y, n_rho * e_z


@njit()
def _cone(numbers: Array, x: float, y: float, z: float) -> Reading:
    """Cone whose tip points to −z: an inner cone grown by the rounding."""
    tip, base, rim, rounding = numbers[0], numbers[1], numbers[2], numbers[3]
    rho = np.sqrt(x * x + y * y)
    e_x, e_y = (x / rho, y / rho) if rho > TINY else (1.0, 0.0)
    slant, t_rho, t_z = _direction(rim, base - tip)
    along = rho * t_rho + (z - tip) * t_z
    off, above = rho * t_z - (z - tip) * t_rho, z - base
    if off <= 0.0 and above <= 0.0:  # inside the inner cone
        if off >= above:
            gap, n_rho, n_z = off, t_z, -t_rho
        else:
            gap, n_rho, n_z = above, 0.0, 1.0
    elif rho <= rim and above > 0.0:
        gap, n_rho, n_z = above, 0.0, 1.0
    elif along < 0.0:
        gap, n_rho, n_z = _direction(rho, z - tip)
    elif along <= slant:
        gap, n_rho, n_z = off, t_z, -t_rho
    else:
        gap, n_rho, n_z = _direction(rho - rim, above)
    return gap - rounding, n_rho * e_x, n_rho * e_y, n_z


@njit()
def _quadric(numbers: Array, x: float, y: float, z: float) -> Reading:
    """Inside f = z − ½·(x, y, z)·K·(x, y, z) > 0: −2f/(1 + |∇f|), exact for ball, rod and plane."""
    a, b, c, d = numbers[0], numbers[1], numbers[2], numbers[3]
    s_x, s_y, s_z = a * x + b * y, b * x + c * y, d * z
    f = z - 0.5 * (x * s_x + y * s_y + z * s_z)
    n_x, n_y, n_z = s_x, s_y, s_z - 1.0
    length = np.sqrt(n_x * n_x + n_y * n_y + n_z * n_z)
    gap = -2.0 * f / (1.0 + length)
    if length < TINY:
        return gap, 0.0, 0.0, -1.0
    return gap, n_x / length, n_y / length, n_z / length


@njit()
def _weights(t: float) -> tuple[float, float, float, float]:
    """Cubic B-spline at the four coefficients around a place, t in 0…1 between the inner two."""
    s = 1.0 - t
    return (
        s * s * s / 6.0,
        (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0,
        (4.0 - 6.0 * s * s + 3.0 * s * s * s) / 6.0,
        t * t * t / 6.0,
    )


@njit()
def _slopes(t: float) -> tuple[float, float, float, float]:
    """Derivatives of `_weights` by t."""
    s = 1.0 - t
    return (
        -0.5 * s * s,
        -2.0 * t + 1.5 * t * t,
        2.0 * s - 1.5 * s * s,
        0.5 * t * t,
    )


@njit()
def _inner(place: float, size: int) -> tuple[int, float]:
    """First of the four coefficients around a place in cells, and how far beyond the second."""
    cell = min(max(int(np.floor(place)), 1), size - 3)
    return cell - 1, place - cell


@njit()
def _grid(grid: Array, origin: Array, cells: float, x: float, y: float, z: float) -> Reading:
    """Distance of a grid's spline inside the grid, and a lower bound outside.

    Outside, the nearest point of the grid's box has a distance g and lies e away. The shape is
    inside the box, so the angle there is obtuse and the distance is at least √(e² + g²).
    """
    a, b, c = (x - origin[0]) * cells, (y - origin[1]) * cells, (z - origin[2]) * cells
    size_a, size_b, size_c = grid.shape
    in_a = min(max(a, 1.0), size_a - 2.0)
    in_b = min(max(b, 1.0), size_b - 2.0)
    in_c = min(max(c, 1.0), size_c - 2.0)
    i, t_a = _inner(in_a, size_a)
    j, t_b = _inner(in_b, size_b)
    k, t_c = _inner(in_c, size_c)
    w_a, w_b, w_c = _weights(t_a), _weights(t_b), _weights(t_c)
    s_a, s_b, s_c = _slopes(t_a), _slopes(t_b), _slopes(t_c)
    gap = n_x = n_y = n_z = 0.0
    for p in range(4):
        value = slope_b = slope_c = 0.0
        for q in range(4):
            g0, g1 = grid[i + p, j + q, k], grid[i + p, j + q, k + 1]
            g2, g3 = grid[i + p, j + q, k + 2], grid[i + p, j + q, k + 3]
            row = w_c[0] * g0 + w_c[1] * g1 + w_c[2] * g2 + w_c[3] * g3
            value += w_b[q] * row
            slope_b += s_b[q] * row
            slope_c += w_b[q] * (s_c[0] * g0 + s_c[1] * g1 + s_c[2] * g2 + s_c[3] * g3)
        gap += w_a[p] * value
        n_x += s_a[p] * value
        n_y += w_a[p] * slope_b
        n_z += w_a[p] * slope_c
    # A slope is of the order of 1 per cell size; only at a ridge inside is it nearly zero.
    length = np.sqrt(n_x * n_x + n_y * n_y + n_z * n_z)
    if length * cells > 1e-9:
        n_x, n_y, n_z = n_x / length, n_y / length, n_z / length
    else:
        n_x, n_y, n_z = 0.0, 0.0, -1.0
    if a == in_a and b == in_b and c == in_c:
        return gap, n_x, n_y, n_z
    e_x, e_y, e_z = (a - in_a) / cells, (b - in_b) / cells, (c - in_c) / cells
    bound = np.sqrt(e_x * e_x + e_y * e_y + e_z * e_z + gap * gap)
    _, n_x, n_y, n_z = _off(e_x + gap * n_x, e_y + gap * n_y, e_z + gap * n_z, 0.0)
    return bound, n_x, n_y, n_z
