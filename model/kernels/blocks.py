"""Compiled elimination in block-tridiagonal systems of 2×2 blocks."""

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit

Array = NDArray[np.float64]


@njit()
def inverse(a: Array, out: Array) -> None:
    """Inverse of a 2×2 matrix."""
    scale = 1.0 / (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0])
    a00, a11 = a[0, 0], a[1, 1]
    out[0, 1] = -a[0, 1] * scale
    out[1, 0] = -a[1, 0] * scale
    out[0, 0] = a11 * scale
    out[1, 1] = a00 * scale


@njit()
def solve_block_tridiagonal(lower: Array, diagonal: Array, upper: Array, rhs: Array) -> None:
    """Solve in place for several right-hand sides: blocks (n, 2, 2), rhs (n, 2, m)."""
    n, _, m = rhs.shape
    inv = np.empty((2, 2))
    factor = np.empty((2, 2))
    for i in range(n):
        if i > 0:
            for r in range(2):
                for col in range(2):
                    factor[r, col] = lower[i, r, 0] * inv[0, col] + lower[i, r, 1] * inv[1, col]
            for r in range(2):
                for col in range(2):
                    diagonal[i, r, col] -= (
                        factor[r, 0] * upper[i - 1, 0, col] + factor[r, 1] * upper[i - 1, 1, col]
                    )
                for k in range(m):
                    rhs[i, r, k] -= (
                        factor[r, 0] * rhs[i - 1, 0, k] + factor[r, 1] * rhs[i - 1, 1, k]
                    )
        inverse(diagonal[i], inv)
        diagonal[i] = inv
    for i in range(n - 1, -1, -1):
        for k in range(m):
            b0, b1 = rhs[i, 0, k], rhs[i, 1, k]
            if i < n - 1:
                b0 -= upper[i, 0, 0] * rhs[i + 1, 0, k] + upper[i, 0, 1] * rhs[i + 1, 1, k]
                b1 -= upper[i, 1, 0] * rhs[i + 1, 0, k] + upper[i, 1, 1] * rhs[i + 1, 1, k]
            rhs[i, 0, k] = diagonal[i, 0, 0] * b0 + diagonal[i, 0, 1] * b1
            rhs[i, 1, k] = diagonal[i, 1, 0] * b0 + diagonal[i, 1, 1] * b1
