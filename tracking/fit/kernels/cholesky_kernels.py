"""Compiled Cholesky factors and inverses of small positive definite matrices."""

import math

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit

Array = NDArray[np.float64]

#: Smallest pivot of a regular matrix, as a share of its diagonal entry.
_SINGULAR = 1e-9


@njit()
def factorise(matrix: Array, size: int) -> bool:
    """Factorise the first rows and columns in place (lower half); False if they are singular."""
    for i in range(size):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i > j:
                matrix[i, j] = total / matrix[j, j]
            elif total > _SINGULAR * matrix[i, i]:
                matrix[i, i] = math.sqrt(total)
            else:
                return False
    return True


@njit()
def invert_corner(factor: Array, first: int, half: Array, out: NDArray[np.floating]) -> None:
    """Compute the last corner of the inverse of a matrix from its Cholesky factor (N, N).

    Parameters
    ----------
    first: row and column at which the corner begins
    half: working memory, shape (N − first, N − first) or larger
    out: result, of that shape or larger
    """
    size = factor.shape[0] - first
    for j in range(size):
        half[j, j] = 1.0 / factor[first + j, first + j]
        for i in range(j + 1, size):
            total = 0.0
            for k in range(j, i):
                total -= factor[first + i, first + k] * half[k, j]
            half[i, j] = total / factor[first + i, first + i]
    for i in range(size):
        for j in range(i + 1):
            total = 0.0
            for k in range(i, size):
                total += half[k, i] * half[k, j]
            out[i, j] = out[j, i] = total
