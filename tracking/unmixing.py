"""Densities and coverages of the dyes in an image, corrected for shading.

By Beer and Lambert's law the light of a pixel is that of the ground times Π Tₖ^dₖ, with the
transmittance Tₖ of dye k and its density dₖ.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..render import decode_srgb, decoding_table
from ..render.drawing import shared_coverage

Array = NDArray[np.float64]
Single = NDArray[np.float32]
#: Linear light, in either precision.
Light = NDArray[np.floating[Any]]

#: Smallest linear light, so that its logarithm is finite.
_BLACK = 1e-4
#: Size of the window in which ground is searched [pitches of the markers].
AROUND = 2.2
#: Smallest difference between the channels of a colour image [grey levels].
COLOURED = 12.0
#: Linear light that is certainly not black; three grey levels are 1e-3.
DARKEST = 3e-3
#: Spacing of the pixels to which the shading is fitted [px].
_STRIDE = 4


def linear_light(levels: NDArray[np.uint8] | Array) -> Single:
    """Linear light of sRGB levels, in their shape; those of a picture are looked up in a table."""
    if levels.dtype == np.uint8:
        return np.asarray(cv2.LUT(levels, decoding_table().astype(np.float32)))
    return decode_srgb(np.asarray(levels, dtype=float)).astype(np.float32)


def unmixing_matrix(transmittance: Array) -> Array:
    """Least-squares matrix from log attenuation (R, G, B) to the densities of L dyes, (L, 3).

    A density is 1 inside a marker of that dye and 0 outside, with or without the other dyes.

    Parameters
    ----------
    transmittance: share of the ground's light that each dye transmits, shape (L, 3)
    """
    return np.linalg.pinv(-np.log(transmittance).T)


def dye_densities(linear: Light, ground: Light, matrix: Array) -> Light:
    """Density of each of L dyes at each pixel, shape (L, H, W), in the dtype of `linear`.

    Parameters
    ----------
    linear: linear light of the picture, shape (H, W, 3)
    ground: linear light of the sensor without markers, shape (H, W, 3)
    matrix: unmixing matrix, see `unmixing_matrix`, shape (L, 3)
    """
    attenuation = np.log(np.maximum(ground, _BLACK)) - np.log(np.maximum(linear, _BLACK))
    mixed = cv2.transform(attenuation, matrix).reshape(*attenuation.shape[:2], -1)
    return np.ascontiguousarray(np.moveaxis(mixed, 2, 0))


def dye_coverages(
    ratio: Single,
    transmittance: Array,
    *,
    noise_power: float = 0.6,
    calming: float = 0.6,
    alone: float = 0.04,
) -> Single:
    """Share of each blurred pixel that markers of each of L layers cover, shape (L, H, W).

    A lens blurs light, which is linear in coverages but not in densities. Light over the ground's
    is 1 − a₀C₀ − a₁C₁ + a₀a₁C₀₁, with the share a that a dye absorbs, the coverage C by a layer and
    C₀₁ by both. C₀₁ is about the smaller of C₀ and C₁, because the edges of a pair run side by
    side; where they cross it is smaller by an amount that is estimated first. So light is linear in
    C₀ and C₁ once the smaller one is known.

    Parameters
    ----------
    ratio: linear light over that of the ground, shape (H, W, 3)
    transmittance: share of the ground's linear light that each dye transmits, shape (L, 3)
    noise_power: exponent p of the noise of linear light, which is proportional to light to the p
    calming: blur of the image in which the smaller coverage is chosen [px]
    alone: smaller coverage below which a pixel shows only one layer, or none
    """
    absorbed = 1.0 - transmittance
    weight = np.prod(0.5 + 0.5 * transmittance, axis=0) ** -noise_power
    lost = 1.0 - ratio
    if len(absorbed) == 1:
        return _solve(lost, absorbed, weight)
    first, second = absorbed
    first_inside = np.stack([first * transmittance[1], second])
    second_inside = np.stack([first, second * transmittance[0]])
    # From a blurred image: otherwise the smaller one would be biased by its noise.
    calm: Any = cv2.GaussianBlur(lost, (0, 0), calming)
    smaller = _solve(calm, first_inside, weight)
    first_is_inside = smaller[0] <= smaller[1]
    rough = np.where(first_is_inside, smaller, _solve(calm, second_inside, weight))
    lost = lost - _too_much(rough)[..., None] * (first * second).astype(np.float32)
    coverages = np.where(
        first_is_inside,
        _solve(lost, first_inside, weight),
        _solve(lost, second_inside, weight),
    )
    return np.where(rough.min(axis=0) < alone, _solve(lost, absorbed, weight), coverages)


def _too_much(coverages: Single) -> Single:
    """Smaller coverage minus coverage by both layers, shape (H, W).

    The latter depends on the angle between the edges, see `covered_by_both`.
    """
    first, second = np.clip(coverages, 0.0, 1.0)
    x0, x1 = (cv2.Sobel(c, cv2.CV_32F, 1, 0) for c in (first, second))
    y0, y1 = (cv2.Sobel(c, cv2.CV_32F, 0, 1) for c in (first, second))
    # Edges of opposite directions are noise.
    along, across = np.maximum(x0 * x1 + y0 * y1, 0.0), np.abs(x0 * y1 - y0 * x1)
    angle: Any = np.arctan2(across, along + np.float32(1e-6))
    return np.minimum(first, second) - shared_coverage(first, second, angle)


def _solve(lost: Single, absorbed: Array, weight: Array) -> Single:
    """Coverages (L, H, W) from absorbed over ground light (H, W, 3), by weighted least squares."""
    matrix = np.linalg.pinv((absorbed * weight).T) * weight
    coverages: Any = cv2.transform(lost, matrix)
    return np.moveaxis(coverages.reshape(*lost.shape[:2], -1), 2, 0)


def rough_ground(
    smooth: Single, size: int, seen: NDArray[np.bool_], bright: bool
) -> tuple[Single, NDArray[np.bool_]]:
    """Estimate the ground by the brightest light near each pixel, and a mask of the lit field.

    If markers are brighter than the ground, it is the darkest light.

    Parameters
    ----------
    smooth: linear light, smoothed so that extremes of noise are not taken, shape (H, W, 3)
    size: size of the window, larger than a marker [px]
    seen: mask of pixels that may show the sensor, shape (H, W)
    bright: whether markers are brighter than the ground
    """
    small = min(8, max(1, size // 12))
    height, width = smooth.shape[:2]
    reduced = cv2.resize(smooth, (width // small, height // small), interpolation=cv2.INTER_AREA)
    # The outside of the image counts as dark, like a housing. Otherwise a narrow strip of housing
    # in the image would be closed like a marker.
    pad = size // small
    border = cv2.BORDER_REPLICATE if bright else cv2.BORDER_CONSTANT
    padded: Any = cv2.copyMakeBorder(reduced, pad, pad, pad, pad, border, value=(0.0, 0.0, 0.0))
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (pad | 1, pad | 1))
    padded = cv2.morphologyEx(padded, cv2.MORPH_OPEN if bright else cv2.MORPH_CLOSE, around)
    reduced = padded[pad:-pad, pad:-pad]
    known: Any = cv2.resize(
        seen.astype(np.float32), (width // small, height // small), interpolation=cv2.INTER_AREA
    )
    lit = _lit(reduced, known > 0.5)
    # Smooth within the lit field only, so that the housing does not darken the rim.
    parts: Any = np.dstack([reduced * lit[..., None], lit])
    parts = cv2.GaussianBlur(parts, (0, 0), 0.15 * size / small)
    smoothed = parts[..., :3] / np.maximum(parts[..., 3:], 1e-3)
    ground: Any = cv2.resize(smoothed, (width, height))
    # Keep away from the edge.
    field: Any = (cv2.resize(lit, (width, height)) > 0.5).astype(np.uint8)
    field = cv2.erode(field, np.ones((5, 5)), borderType=cv2.BORDER_REPLICATE)
    return ground, field.astype(bool)


def _lit(
    ground: Single,
    seen: NDArray[np.bool_],
    darkest: float = 0.1,
    brightest: float = 0.5,
    rare: float = 0.01,
) -> Single:
    """Image (H, W): 1 in the largest bright connected region within `seen`, 0 elsewhere.

    The threshold lies at a light between ground and darker surroundings that few pixels have.

    Parameters
    ----------
    darkest, brightest: smallest and largest threshold, over the brightest ground
    rare: share of the pixels below which a range of light counts as a gap
    """
    light = np.maximum(ground.max(axis=2), _BLACK)
    share = np.where(seen, light / np.percentile(light[seen], 95), 0.0)
    edges = np.geomspace(darkest, brightest, 9)
    pixels = np.histogram(share[seen], edges)[0] / seen.sum()
    gap = np.flatnonzero(pixels <= max(rare, pixels.min()))[-1]
    bright = (share > edges[gap]).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(bright, connectivity=4)
    largest = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
    return (np.asarray(labels) == largest).astype(np.float32)


def plain_pixels(
    densities: Light, field: NDArray[np.bool_], margin: int, touching: float = 0.2
) -> NDArray[np.bool_]:
    """Mask of a field's pixels that keep a margin [px] from markers of any layer, shape (H, W).

    Pixels with a density above `touching` belong to markers.
    """
    touched: Any = (abs(densities) > touching).any(axis=0).astype(np.uint8)
    # Opening removes specks of noise.
    touched = cv2.morphologyEx(touched, cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * margin + 1, 2 * margin + 1))
    return field & ~cv2.dilate(touched, around).astype(bool)


def estimate_ground(linear: Light, plain: NDArray[np.bool_], scale: float) -> Light:
    """Estimate the linear light of the unmarked skin from the pixels between the markers.

    A polynomial in (x, y) describes the shading of the dome; the residual is smoothed locally.

    Parameters
    ----------
    linear: linear-light image, shape (H, W, 3)
    plain: mask of pixels that show unmarked skin, shape (H, W)
    scale: smoothing length, about the distance between markers [px]

    Returns
    -------
    Ground at every pixel, shape (H, W, 3), in the dtype of `linear`.
    """
    shading = _polynomial_shading(linear, plain)
    ratio = linear / shading
    plain = plain & _near_one(ratio)
    height, width = plain.shape
    small = (width // _STRIDE, height // _STRIDE)
    parts: Any = np.dstack([ratio * plain[..., None], plain]).astype(np.float32)
    parts = cv2.resize(parts, small, interpolation=cv2.INTER_AREA)
    parts = cv2.GaussianBlur(parts, (0, 0), scale / _STRIDE)
    # Far from all plain pixels only the polynomial counts.
    local = (parts[..., :3] + 1e-3) / (parts[..., 3:] + 1e-3)
    return shading * cv2.resize(local, (width, height), interpolation=cv2.INTER_LINEAR)


def _polynomial_shading(linear: Light, plain: NDArray[np.bool_]) -> Single:
    """Fit a polynomial per channel to the logarithm of plain pixels; return its light (H, W, 3)."""
    height, width = plain.shape
    # The shading is so smooth that every fourth pixel is enough.
    rows, cols = np.arange(0, height + 3, _STRIDE), np.arange(0, width + 3, _STRIDE)
    y, x = np.meshgrid(rows / (height / 2) - 1.0, (cols - width / 2) / (height / 2), indexing="ij")
    powers = [(i, j) for i in range(7) for j in range(7 - i)]
    x_powers, y_powers = (np.cumprod([np.ones_like(v)] + 6 * [v], axis=0) for v in (x, y))
    across = np.stack([x_powers[i] * y_powers[j] for i, j in powers], axis=-1)
    light, sample = linear[::_STRIDE, ::_STRIDE], plain[::_STRIDE, ::_STRIDE]
    inside = across[: light.shape[0], : light.shape[1]]
    for _ in range(3):
        target = np.log(np.maximum(light[sample], _BLACK))
        # Normal equations: thirty unknowns from ten thousand pixels.
        known = inside[sample]
        coefficients = np.linalg.lstsq(known.T @ known, known.T @ target, rcond=None)[0]
        # Outside the dome, where it is not used, the polynomial diverges.
        shading = np.exp(np.clip(across @ coefficients, -6.0, 1.0)).astype(np.float32)
        sample = sample & _near_one(light / shading[: light.shape[0], : light.shape[1]])
    at_x, at_y = np.meshgrid(np.arange(width) / _STRIDE, np.arange(height) / _STRIDE)
    return np.asarray(
        cv2.remap(shading, at_x.astype(np.float32), at_y.astype(np.float32), cv2.INTER_LINEAR)
    )


def _near_one(ratio: Light, near: float = 0.08) -> NDArray[np.bool_]:
    """Mask of pixels whose ratio of light to shading is near 1 in every channel, shape (H, W).

    `near` is the largest relative difference: more than noise, less than an edge.
    """
    low, high = [1.0 - near] * 3, [1.0 + near] * 3
    return np.asarray(cv2.inRange(ratio, np.array(low), np.array(high))).astype(bool)
