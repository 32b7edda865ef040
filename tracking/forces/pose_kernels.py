"""Compiled polynomials of a pixel. `pose.py` documents the use."""

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit

Array = NDArray[np.float64]


@njit()
def polynomials(
    pixels: Array, middle: Array, radius: float, coefficients: Array, degree: int, out: Array
) -> None:
    """Evaluate R polynomials of (pixel − middle)/radius.

    Parameters
    ----------
    pixels: pixels, shape (n, 2)
    middle, radius: centre and radius of the disc of pixels [px]
    coefficients: coefficients of 1, x, y, x², xy, y², …, shape (R, C)
    degree: degree of the polynomials
    out: result, shape (n, R)
    """
    terms = np.empty(coefficients.shape[1])
    for k in range(len(pixels)):
        x, y = (pixels[k, 0] - middle[0]) / radius, (pixels[k, 1] - middle[1]) / radius
        terms[0] = 1.0
        end = 1
        for power in range(1, degree + 1):
            begin = end - power  # first term of the previous power
            for j in range(power):
                terms[end + j] = terms[begin + j] * x
            terms[end + power] = terms[end - 1] * y
            end += power + 1
        for i in range(coefficients.shape[0]):
            total = 0.0
            for j in range(end):
                total += coefficients[i, j] * terms[j]
            out[k, i] = total
