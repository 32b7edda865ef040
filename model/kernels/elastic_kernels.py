"""Compiled elasticity of the chain alone: nodal forces and their derivative. See `stiffness.py`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit
from .springs import spring

Array = NDArray[np.float64]


@njit()
def chain_tangent(
    ch: Any,
    u: Array,
    blunt: float,
    forces: Array,
    lower: Array,
    diagonal: Array,
    upper: Array,
) -> None:
    """Nodal forces K(u)·u (N, 2) and the blocks of their derivative at the N − 2 inner nodes.

    Displacements are relative to the rigid part. Blocks as in `solve_block_tridiagonal`; `blunt` as
    in `spring`.
    """
    n = ch.rest.shape[0]
    forces[:] = 0.0
    diagonal[:] = 0.0
    for i in range(1, n - 1):
        f_x, f_z, xx, xz, zx, zz = spring(
            ch.law, ch.rest[i, 0] + u[i, 0], ch.rest[i, 1] + u[i, 1], u[i, 0], u[i, 1],
            ch.tissue[i], ch.cross_tissue[i], 1.0, blunt,
        )  # fmt: skip
        forces[i, 0] += f_x
        forces[i, 1] += f_z
        _add(diagonal[i - 1], 1.0, xx, xz, zx, zz)
    for i in range(n - 1):
        dx, dz = u[i + 1, 0] - u[i, 0], u[i + 1, 1] - u[i, 1]
        f_x, f_z, xx, xz, zx, zz = spring(
            ch.law, ch.rest[i + 1, 0] - ch.rest[i, 0] + dx, ch.rest[i + 1, 1] - ch.rest[i, 1] + dz,
            dx, dz, ch.membrane[i], ch.cross_membrane[i], 1.0, blunt,
        )  # fmt: skip
        forces[i, 0] -= f_x
        forces[i, 1] -= f_z
        forces[i + 1, 0] += f_x
        forces[i + 1, 1] += f_z
        if i > 0:
            _add(diagonal[i - 1], 1.0, xx, xz, zx, zz)
        if i < n - 2:
            _add(diagonal[i], 1.0, xx, xz, zx, zz)
        if 0 < i < n - 2:
            upper[i - 1] = 0.0
            lower[i] = 0.0
            _add(upper[i - 1], -1.0, xx, xz, zx, zz)
            _add(lower[i], -1.0, xx, xz, zx, zz)


@njit()
def _add(block: Array, sign: float, xx: float, xz: float, zx: float, zz: float) -> None:
    block[0, 0] += sign * xx
    block[0, 1] += sign * xz
    block[1, 0] += sign * zx
    block[1, 1] += sign * zz
