"""Compiled placing of markers: in space, as the skin carries them, and in the image."""

import math

import numpy as np
from numpy.typing import NDArray

from ..compiled import njit
from .optics.projection_kernels import Lens, Port, apparent, pixel

Array = NDArray[np.float64]

#: Least and largest thickness of pressed silicone, as a share of that at rest.
THINNEST, THICKEST = 0.2, 5.0


@njit()
def carry_markers(
    chain: Array,
    azimuth: Array,
    ring: Array,
    tangents: Array,
    rest: Array,
    follow: Array,
    share: Array,
    half_sizes: Array,
    stretch: float,
    swell: float,
    centres: Array,
    axes: Array,
) -> None:
    """Centres and semi-axes of markers on a deformed skin; see `harmonics` for the displacement.

    Parameters
    ----------
    chain: (x, z) of the chain at +θ and −θ [m] and both derivatives by θ, shape (4, P, M, 2), of
        each layer or, with P = 1, of both
    azimuth: (cos φ, sin φ), shape (P, M, 2)
    ring: length of a unit of φ over that of θ, shape (P, M)
    tangents: unit vectors along θ and φ as columns, shape (P, M, 3, 2)
    rest: centres at rest [m], shape (2, M, 3)
    follow: share of the skin's displacement made by each layer, shape (2,)
    share: of the skin's slope made by each layer [1/m], shape (2,)
    half_sizes: of each layer's markers [m], shape (2,)
    stretch: share of the skin's stretch that an outline takes
    swell: thickness of the silicone that takes up a press [m]; 0 is none
    centres, axes: results, shapes (2, M, 3) and (2, M, 3, 2)
    """
    carried, slope = np.empty((3, 2)), np.empty((3, 2))
    moved = np.empty(3)
    for layer in range(2):
        p = min(layer, chain.shape[1] - 1)
        for m in range(rest.shape[1]):
            cos, sin = azimuth[p, m, 0], azimuth[p, m, 1]
            u_r, shift, u_z, tilt = _harmonics(chain[0, p, m], chain[1, p, m])
            moved[0], moved[1], moved[2] = u_r * cos + shift, u_r * sin, u_z + tilt * cos
            slope[0, 1], slope[1, 1] = -u_r * sin / ring[p, m], u_r * cos / ring[p, m]
            slope[2, 1] = -tilt * sin / ring[p, m]
            u_r, shift, u_z, tilt = _harmonics(chain[2, p, m], chain[3, p, m])
            slope[0, 0], slope[1, 0] = u_r * cos + shift, u_r * sin
            slope[2, 0] = u_z + tilt * cos
            along = tangents[p, m]
            for i in range(3):
                centres[layer, m, i] = rest[layer, m, i] + follow[layer] * moved[i]
                for j in range(2):
                    carried[i, j] = along[i, j] + share[layer] * slope[i, j]
            unit_axes(carried, stretch, axes[layer, m])
            size = half_sizes[layer]
            if swell > 0.0:
                size *= 1.0 + follow[layer] * (_swelling(moved, along, swell) - 1.0)
            for i in range(3):  # squares lie along the sensor's x and y, discs anyhow
                first, second = axes[layer, m, i, 0], axes[layer, m, i, 1]
                axes[layer, m, i, 0] = size * (first * cos - second * sin)
                axes[layer, m, i, 1] = size * (first * sin + second * cos)


@njit()
def _harmonics(right: Array, left: Array) -> tuple[float, float, float, float]:
    """Radial u_r, shift a, mean u_z and tilt c, from (x, z) at ±θ."""
    return (
        (right[0] - left[0]) / 2.0,
        (right[0] + left[0]) / 2.0,
        (right[1] + left[1]) / 2.0,
        (right[1] - left[1]) / 2.0,
    )


@njit()
def _swelling(moved: Array, along: Array, swell: float) -> float:
    """Growth of an outline where incompressible silicone gets thinner."""
    thinning = 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        thinning += moved[i] * (along[j, 0] * along[k, 1] - along[k, 0] * along[j, 1])
    return 1.0 / math.sqrt(min(max(1.0 + thinning / swell, THINNEST), THICKEST))


@njit()
def unit_axes(carried: Array, stretch: float, out: Array) -> None:
    """Axes of a unit outline on a skin carried by F = R·U: R and `stretch` of the U.

    Parameters
    ----------
    carried: F, the skin's unit tangents after the deformation as columns, shape (3, 2)
    stretch: share of U, from 0 for a stiff dot to 1 for ink
    out: result, shape (3, 2)
    """
    aa = ab = bb = 0.0
    for i in range(3):
        aa += carried[i, 0] * carried[i, 0]
        ab += carried[i, 0] * carried[i, 1]
        bb += carried[i, 1] * carried[i, 1]
    # The root of a 2×2 matrix C is (C + √det C)/√(tr C + 2√det C).
    area = math.sqrt(max(aa * bb - ab * ab, 1e-12))
    norm = math.sqrt(aa + bb + 2.0 * area)
    u00, u01, u11 = (aa + area) / norm, ab / norm, (bb + area) / norm
    i00, i01, i11 = u11 / area, -u01 / area, u00 / area
    s00, s01, s11 = 1.0 + stretch * (u00 - 1.0), stretch * u01, 1.0 + stretch * (u11 - 1.0)
    for i in range(3):
        first = carried[i, 0] * i00 + carried[i, 1] * i01
        second = carried[i, 0] * i01 + carried[i, 1] * i11
        out[i, 0], out[i, 1] = first * s00 + second * s01, first * s01 + second * s11


@njit()
def unit_axes_each(carried: Array, stretch: float, out: Array) -> None:
    """`unit_axes` of each F, shape (K, 3, 2)."""
    for k in range(len(carried)):
        unit_axes(carried[k], stretch, out[k])


@njit()
def carry_in_silicone(
    moved: Array,
    slopes: Array,
    rest: Array,
    tangents: Array,
    upright: Array,
    stretch: float,
    centres: Array,
    axes: Array,
) -> None:
    """Centres and semi-axes of markers that move as silicone does.

    Parameters
    ----------
    moved, slopes: displacement [m], and of each of its components the slopes along θ and φ, shapes
        (K, 3) and (K, 3, 2)
    rest: centres at rest [m], shape (K, 3)
    tangents: unit vectors along θ and φ as columns, shape (K, 3, 2)
    upright: sizes and turn in the plane of the marker [m], shape (K, 2, 2)
    stretch: share of the silicone's stretch that an outline takes
    centres, axes: results, shapes (K, 3) and (K, 3, 2)
    """
    carried, unit = np.empty((3, 2)), np.empty((3, 2))
    for k in range(rest.shape[0]):
        for i in range(3):
            centres[k, i] = rest[k, i] + moved[k, i]
            for j in range(2):
                carried[i, j] = tangents[k, i, j] + slopes[k, i, j]
        unit_axes(carried, stretch, unit)
        for i in range(3):
            for j in range(2):
                axes[k, i, j] = unit[i, 0] * upright[k, 0, j] + unit[i, 1] * upright[k, 1, j]


@njit()
def project_markers(
    centres: Array,
    axes: Array,
    probes: Array,
    fit: Array,
    port: Port,
    lens: Lens,
    pixels: Array,
    coefficients: Array,
) -> None:
    """Projected centres and outlines of markers; see `outlines`.

    Parameters
    ----------
    centres, axes: in the sensor frame [m], shapes (K, 3) and (K, 3, 2)
    probes: points q of a marker's own coordinates, the first its centre, shape (P, 2)
    fit: coefficients of the outline from the probes' pixels, shape (6, P)
    port, lens: of the camera
    pixels, coefficients: results [px], shapes (K, 2) and (K, 6, 2)
    """
    for k in range(len(centres)):
        centre, first, second = centres[k], axes[k, :, 0], axes[k, :, 1]
        coefficients[k] = 0.0
        for j in range(len(probes)):
            q, r = probes[j, 0], probes[j, 1]
            x, y, z = apparent(
                centre[0] + (first[0] * q + second[0] * r),
                centre[1] + (first[1] * q + second[1] * r),
                centre[2] + (first[2] * q + second[2] * r),
                port,
            )
            u, v = pixel(x, y, z, lens)
            if j == 0:
                pixels[k, 0], pixels[k, 1] = u, v
            for i in range(6):
                coefficients[k, i, 0] += fit[i, j] * u
                coefficients[k, i, 1] += fit[i, j] * v
