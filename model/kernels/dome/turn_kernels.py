"""Compiled turns of rigid bodies: rotation matrices, rotation vectors, quaternions."""

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit

Array = NDArray[np.float64]


@njit()
def turned(rotation: Array, vector: Array) -> Array:
    """Rotation after a further turn by a rotation vector [rad] in the world's axes."""
    angle = np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    out = rotation.copy()
    if angle == 0.0:
        return out
    x, y, z = vector[0] / angle, vector[1] / angle, vector[2] / angle
    c, s = np.cos(angle), np.sin(angle)
    for k in range(3):
        a, b, d = rotation[0, k], rotation[1, k], rotation[2, k]
        along = (x * a + y * b + z * d) * (1.0 - c)
        out[0, k] = a * c + (y * d - z * b) * s + x * along
        out[1, k] = b * c + (z * a - x * d) * s + y * along
        out[2, k] = d * c + (x * b - y * a) * s + z * along
    return out


@njit()
def rotation_vector(rotation: Array) -> Array:
    """Rotation vector [rad] of a rotation matrix, shape (3,); for half a turn its axis is unknown.

    It then has the right length.
    """
    out = np.empty(3)
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        out[a] = 0.5 * (rotation[c, b] - rotation[b, c])
    sine = np.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    angle = np.arctan2(sine, 0.5 * (rotation[0, 0] + rotation[1, 1] + rotation[2, 2] - 1.0))
    if sine < 1e-12:
        out[:] = 0.0
        out[2] = angle
        return out
    return out * (angle / sine)


@njit()
def rotation_of_quaternion(w: float, x: float, y: float, z: float) -> Array:
    """Rotation matrix of a quaternion, which need not have length 1, shape (3, 3)."""
    s = 2.0 / (w * w + x * x + y * y + z * z)
    return np.array(
        [
            [1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
            [s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)],
            [s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)],
        ]
    )
