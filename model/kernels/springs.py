"""Compiled force laws of one spring, with their derivative. `fingertip.py` documents the laws."""

import numpy as np

from ...compiled import njit

SPLIT, INVERSE_POISSON, AXIAL = 0, 1, 2


@njit()
def _sign(value: float, width: float) -> float:
    """Sign of a value, without the jump at zero where a width is given."""
    if width == 0.0:
        return np.sign(value)
    return value / np.sqrt(value * value + width * width)


@njit()
def spring(
    law: int,
    reach_x: float,
    reach_z: float,
    dx: float,
    dz: float,
    stiffness: float,
    cross: float,
    turning: float,
    blunt: float,
) -> tuple[float, float, float, float, float, float]:
    """Force of one spring and its derivative.

    Parameters
    ----------
    law: SPLIT (thesis Eq. 3 with E6), INVERSE_POISSON (Eq. 17) or AXIAL (Eq. 14)
    reach_x, reach_z: vector between the spring's ends as deformed [m]
    dx, dz: displacement of one end relative to the other [m]
    stiffness: [N/m]
    cross: Poisson factor times the hard-coded sign of its half (E6)
    turning: share of the derivative that comes from the spring's turning: 1 is the true one; at 0
        the split laws are linear, as the thesis has them between two refreshes of the angles
    blunt: slope below which the jump of the derivative at an axis is smoothed; 0 is exact

    Returns
    -------
    force along x and z [N], ∂force_x/∂dx, ∂force_x/∂dz, ∂force_z/∂dx, ∂force_z/∂dz [N/m]
    """
    length = np.sqrt(reach_x * reach_x + reach_z * reach_z)
    if law == AXIAL:
        n_x, n_z = reach_x / length, reach_z / length
        rest_x, rest_z = reach_x - dx, reach_z - dz
        stretch = length - np.sqrt(rest_x * rest_x + rest_z * rest_z)
        side = turning * stiffness * stretch / length
        along = stiffness - side
        return (
            stiffness * stretch * n_x,
            stiffness * stretch * n_z,
            along * n_x * n_x + side,
            along * n_x * n_z,
            along * n_x * n_z,
            along * n_z * n_z + side,
        )
    sin, cos = abs(reach_x) / length, abs(reach_z) / length
    k_x, k_z = stiffness * sin, stiffness * cos
    # The Poisson term is driven by the other axis's stiffness, or (Eq. 17) by its own.
    if law == SPLIT:
        f_x, f_z = k_x * dx + cross * k_z * dz, k_z * dz - cross * k_x * dx
        t_xz, t_zx = cross * k_z, -cross * k_x
    else:
        f_x, f_z = k_x * (dx + cross * dz), k_z * (dz - cross * dx)
        t_xz, t_zx = cross * k_x, -cross * k_z
    if turning == 0.0:
        return f_x, f_z, k_x, t_xz, t_zx, k_z
    scale = turning * stiffness / (length * length * length)
    sin_x = scale * _sign(reach_x, blunt * length) * reach_z * reach_z
    sin_z = -scale * abs(reach_x) * reach_z
    cos_x = -scale * abs(reach_z) * reach_x
    cos_z = scale * _sign(reach_z, blunt * length) * reach_x * reach_x
    if law == SPLIT:
        return (
            f_x,
            f_z,
            k_x + sin_x * dx + cross * cos_x * dz,
            t_xz + sin_z * dx + cross * cos_z * dz,
            t_zx + cos_x * dz - cross * sin_x * dx,
            k_z + cos_z * dz - cross * sin_z * dx,
        )
    along_x, along_z = dx + cross * dz, dz - cross * dx
    return (
        f_x,
        f_z,
        k_x + sin_x * along_x,
        t_xz + sin_z * along_x,
        t_zx + cos_x * along_z,
        k_z + cos_z * along_z,
    )
