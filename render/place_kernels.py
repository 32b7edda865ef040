"""Compiled placing of markers: in space on the deformed skin, and in the image."""

import math

import numpy as np
from numpy.typing import NDArray

from ..compiled import njit
from .optics.projection_kernels import Lens, Port, project_lanes

Array = NDArray[np.float64]

#: Smallest and largest thickness of deformed silicone, as a share of that at rest.
THINNEST, THICKEST = 0.2, 5.0
#: Number of markers that are projected together, so that their values stay in the cache.
_TOGETHER = 64


@njit()
def carry_markers(
    displacement: Array,
    before: NDArray[np.int64],
    weight: Array,
    slope_weights: Array,
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
    """Compute centres and semi-axes of markers on a deformed skin; see `harmonics`.

    M is the number of markers of a layer. P is 2 if each layer has its own places, 1 if they are
    the same.

    Parameters
    ----------
    displacement: displacement (x, z) of the chain's nodes [m], shape (N, 2)
    before: index of the node before a marker's θ, and before its −θ, shape (P, M, 2)
    weight: weight of the next node, shape (P, M, 2)
    slope_weights: weights of the derivative at each node, see `slope_weights`, shape (N, 3)
    azimuth: (cos φ, sin φ) of the markers, shape (P, M, 2)
    ring: length of a unit of φ over that of θ, shape (P, M)
    tangents: unit vectors along θ and φ as columns, shape (P, M, 3, 2)
    rest: centres at rest [m], shape (2, M, 3)
    follow: share of the skin's displacement that each layer follows, shape (2,)
    share: factor from the derivative with respect to θ to each layer's strain [1/m], shape (2,)
    half_sizes: half size of each layer's markers [m], shape (2,)
    stretch: share of the skin's stretch that an outline follows
    swell: thickness of the silicone that is compressed [m]; 0: markers do not swell
    centres, axes: results [m], shapes (2, M, 3) and (2, M, 3, 2)
    """
    carried, slope, moved = np.empty((3, 2)), np.empty((3, 2)), np.empty(3)
    slopes = np.zeros_like(displacement)
    for n in range(1, len(displacement) - 1):
        for c in range(2):
            for j in range(3):
                slopes[n, c] += slope_weights[n, j] * displacement[n - 1 + j, c]
    for layer in range(2):
        p = min(layer, before.shape[0] - 1)
        for m in range(rest.shape[1]):
            cos, sin = azimuth[p, m, 0], azimuth[p, m, 1]
            u_r, shift, u_z, tilt = _harmonics(displacement, 1.0, before[p, m], weight[p, m])
            moved[0], moved[1], moved[2] = u_r * cos + shift, u_r * sin, u_z + tilt * cos
            slope[0, 1], slope[1, 1] = -u_r * sin / ring[p, m], u_r * cos / ring[p, m]
            slope[2, 1] = -tilt * sin / ring[p, m]
            # d/dθ of f(−θ) is −f′(−θ).
            u_r, shift, u_z, tilt = _harmonics(slopes, -1.0, before[p, m], weight[p, m])
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
            for i in range(3):  # squares are aligned with the sensor's x and y
                first, second = axes[layer, m, i, 0], axes[layer, m, i, 1]
                axes[layer, m, i, 0] = size * (first * cos - second * sin)
                axes[layer, m, i, 1] = size * (first * sin + second * cos)


@njit()
def _harmonics(
    nodal: Array, sign: float, before: NDArray[np.int64], weight: Array
) -> tuple[float, float, float, float]:
    """Radial u_r, shift a, mean u_z, tilt c of nodal (x, z); `sign` multiplies values at −θ."""
    i, j, w, v = before[0], before[1], weight[0], weight[1]
    right_x = (1.0 - w) * nodal[i, 0] + w * nodal[i + 1, 0]
    right_z = (1.0 - w) * nodal[i, 1] + w * nodal[i + 1, 1]
    left_x = sign * ((1.0 - v) * nodal[j, 0] + v * nodal[j + 1, 0])
    left_z = sign * ((1.0 - v) * nodal[j, 1] + v * nodal[j + 1, 1])
    return (
        (right_x - left_x) / 2.0,
        (right_x + left_x) / 2.0,
        (right_z + left_z) / 2.0,
        (right_z - left_z) / 2.0,
    )


@njit()
def _swelling(moved: Array, along: Array, swell: float) -> float:
    """Factor by which an outline grows where incompressible silicone gets thinner."""
    thinning = 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        thinning += moved[i] * (along[j, 0] * along[k, 1] - along[k, 0] * along[j, 1])
    return 1.0 / math.sqrt(min(max(1.0 + thinning / swell, THINNEST), THICKEST))


@njit()
def unit_axes(carried: Array, stretch: float, out: Array) -> None:
    """Compute the axes of a unit outline on a skin with deformation gradient F = R·U.

    Parameters
    ----------
    carried: F, the deformed unit tangents as columns, shape (3, 2)
    stretch: share of U that the outline follows, from 0 for a stiff dot to 1 for ink
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
    """Apply `unit_axes` to K deformation gradients, shape (K, 3, 2)."""
    for k in range(len(carried)):
        unit_axes(carried[k], stretch, out[k])


@njit()
def unit_normals(axes: Array, out: Array) -> None:
    """Compute unit normals (K, 3) of outlines from their semi-axes as columns, (K, 3, 2)."""
    for k in range(len(axes)):
        for i in range(3):
            j, m = (i + 1) % 3, (i + 2) % 3
            out[k, i] = axes[k, j, 0] * axes[k, m, 1] - axes[k, m, 0] * axes[k, j, 1]
        length = math.sqrt(out[k, 0] ** 2 + out[k, 1] ** 2 + out[k, 2] ** 2)
        for i in range(3):
            out[k, i] /= length


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
    """Compute centres and semi-axes of K markers that move with the silicone.

    Parameters
    ----------
    moved: displacement of the markers [m], shape (K, 3)
    slopes: derivatives of the displacement per length along θ and φ, shape (K, 3, 2)
    rest: centres at rest [m], shape (K, 3)
    tangents: unit vectors along θ and φ as columns, shape (K, 3, 2)
    upright: semi-axes at rest in the tangent plane, as columns [m], shape (K, 2, 2)
    stretch: share of the silicone's stretch that an outline follows
    centres, axes: results [m], shapes (K, 3) and (K, 3, 2)
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
    """Compute projected centres and outlines of K markers; see `outlines`.

    Parameters
    ----------
    centres, axes: markers in the sensor frame [m], shapes (K, 3) and (K, 3, 2)
    probes: P points q of the unit outline, the first its centre, shape (P, 2)
    fit: matrix from the probes' pixels to the coefficients of an outline, shape (6, P)
    port, lens: surface of the silicone and lens of the camera
    pixels, coefficients: results [px], shapes (K, 2) and (K, 6, 2)
    """
    places = len(probes)
    room, total = np.empty((3, places * _TOGETHER)), np.empty(_TOGETHER)
    for begin in range(0, len(centres), _TOGETHER):
        count = min(_TOGETHER, len(centres) - begin)
        x, y, z = room[0, : places * count], room[1, : places * count], room[2, : places * count]
        for j in range(places):
            q, r = probes[j, 0], probes[j, 1]
            for i in range(count):
                k, at = begin + i, j * count + i
                x[at] = centres[k, 0] + (axes[k, 0, 0] * q + axes[k, 0, 1] * r)
                y[at] = centres[k, 1] + (axes[k, 1, 0] * q + axes[k, 1, 1] * r)
                z[at] = centres[k, 2] + (axes[k, 2, 0] * q + axes[k, 2, 1] * r)
        project_lanes(x, y, z, port, lens)
        for i in range(count):
            pixels[begin + i, 0], pixels[begin + i, 1] = x[i], y[i]
        for axis in range(2):
            values = x if axis == 0 else y
            for n in range(fit.shape[0]):
                for i in range(count):
                    total[i] = 0.0
                for j in range(places):
                    factor, part = fit[n, j], values[j * count : (j + 1) * count]
                    for i in range(count):
                        total[i] += factor * part[i]
                for i in range(count):
                    coefficients[begin + i, n, axis] = total[i]


@njit()
def outline_centroids(coefficients: Array, second: float, out: Array) -> None:
    """Compute centroids (K, 2) of outlines (K, 6, 2); see `outlines.centroids`.

    Parameters
    ----------
    second: mean of q₁² over the unit outline
    """
    for k in range(len(coefficients)):
        own = coefficients[k]
        c, a1, a2, b11, b12, b22 = own[0], own[1], own[2], own[3], own[4], own[5]
        # det ∂p/∂q = D·(1 + g·q) to first order.
        area = _cross(a1, a2)
        g1 = (2.0 * _cross(b11, a2) + _cross(a1, b12)) / area
        g2 = (_cross(b12, a2) + 2.0 * _cross(a1, b22)) / area
        for i in range(2):
            out[k, i] = c[i] + second * (b11[i] + b22[i] + g1 * a1[i] + g2 * a2[i])


@njit()
def _cross(u: Array, v: Array) -> float:
    """Cross product of two vectors in the plane."""
    return float(u[0] * v[1] - u[1] * v[0])
