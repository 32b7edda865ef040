"""From an image to the dyes: densities and coverages, free of shading.

By Beer and Lambert's law the light of a pixel is that of the ground times Π Tₖ^dₖ, where Tₖ is the
transmittance of dye k and dₖ its density.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..render.drawing import shared_coverage

Array = NDArray[np.float64]
Single = NDArray[np.float32]
#: Linear light, in either precision.
Light = NDArray[np.floating[Any]]

#: Least linear light, so that its logarithm is finite.
_BLACK = 1e-4
#: Ground is looked for within this many of the markers' typical distance.
AROUND = 2.2
#: Channels of a colour image differ by more than this somewhere [grey levels].
COLOURED = 12.0
#: Linear light that is told from black for certain: three grey levels make 1e-3.
DARKEST = 3e-3
#: Distance of the pixels that the shading is fitted to [px].
_STRIDE = 4


def unmixing_matrix(transmittance: Array) -> Array:
    """Least-squares map from log attenuation (R, G, B) to dye densities, shape (L, 3).

    A density is 1 inside a marker of that dye and 0 outside, wherever the other layer's lie.

    Parameters
    ----------
    transmittance: share of the ground's light that each dye leaves, shape (L, 3)
    """
    return np.linalg.pinv(-np.log(transmittance).T)


def dye_densities(linear: Light, ground: Light, matrix: Array) -> Light:
    """Density of each dye per pixel, shape (L, H, W), as precise as the light.

    Parameters
    ----------
    linear: linear light of the picture, shape (H, W, 3)
    ground: of the sensor without markers, shape (H, W, 3)
    matrix: of `unmixing_matrix`, shape (L, 3)
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
    """Share of each blurred pixel that markers of each layer cover, shape (L, H, W).

    A lens blurs light, in which coverages are linear and densities are not. Light over the ground's
    is 1 − a₀C₀ − a₁C₁ + a₀a₁C₀₁, where a is the share that a dye absorbs and C₀₁ the coverage by
    both. C₀₁ is about the smaller of C₀ and C₁, because the edges of a pair run side by side; where
    they cross it is less by an amount that is estimated first. Light is thus linear in both, once
    it is known which one is smaller.

    Parameters
    ----------
    ratio: linear light over the ground's, shape (H, W, 3)
    transmittance: share of the ground's linear light that a marker leaves, shape (L, 3)
    noise_power: power of linear light that its noise is proportional to; levels are about its root
    calming: blur of the image from which the layer with the smaller coverage is chosen [px]
    alone: smaller coverage that is noise: only one layer, or none, is there
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
    """Smaller coverage less the coverage by both layers, shape (H, W).

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
    """Coverages (L, H, W) by weighted least squares, of lost light over the ground's (H, W, 3)."""
    matrix = np.linalg.pinv((absorbed * weight).T) * weight
    coverages: Any = cv2.transform(lost, matrix)
    return np.moveaxis(coverages.reshape(*lost.shape[:2], -1), 2, 0)


def rough_ground(
    smooth: Single, size: int, seen: NDArray[np.bool_], bright: bool
) -> tuple[Single, NDArray[np.bool_]]:
    """Brightest light near each pixel, as an estimate of the ground, and a mask of the lit field.

    For markers that are brighter than the ground it is the darkest light.

    Parameters
    ----------
    smooth: linear light, smoothed because extremes of noise would be taken, shape (H, W, 3)
    size: larger than a marker [px]
    seen: pixels that may show the sensor, shape (H, W)
    bright: whether markers are brighter than the ground
    """
    small = min(8, max(1, size // 12))
    height, width = smooth.shape[:2]
    reduced = cv2.resize(smooth, (width // small, height // small), interpolation=cv2.INTER_AREA)
    # The outside of the image counts as dark, as a housing is: so that a narrow strip of housing
    # in the image is not closed as a marker would be.
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
    # Smoothed within the lit field, so that the housing does not darken the rim.
    parts: Any = np.dstack([reduced * lit[..., None], lit])
    parts = cv2.GaussianBlur(parts, (0, 0), 0.15 * size / small)
    smoothed = parts[..., :3] / np.maximum(parts[..., 3:], 1e-3)
    ground: Any = cv2.resize(smoothed, (width, height))
    # Clear of the edge.
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
    """1 in the largest region that is about as bright as the brightest, 0 elsewhere, (H, W).

    It is 0 where `seen` is False. The surroundings of a sensor are darker, and few pixels have a
    light in between.

    Parameters
    ----------
    darkest, brightest: lowest and highest light at the edge of the field, over the brightest ground
    rare: share of the pixels below which a light is in between
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
    """Pixels of a field that are clear of markers of any layer by a margin [px], shape (H, W).

    Pixels of a density above `touching` belong to markers.
    """
    touched: Any = (abs(densities) > touching).any(axis=0).astype(np.uint8)
    # Opening removes specks of noise.
    touched = cv2.morphologyEx(touched, cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * margin + 1, 2 * margin + 1))
    return field & ~cv2.dilate(touched, around).astype(bool)


def estimate_ground(linear: Light, plain: NDArray[np.bool_], scale: float) -> Light:
    """Linear light of the unmarked skin, from the pixels between the markers.

    A polynomial in (x, y) describes the shading of the dome; the remainder is smoothed locally.

    Parameters
    ----------
    linear: linear-light image, shape (H, W, 3)
    plain: pixels that show unmarked skin, shape (H, W)
    scale: smoothing, about the distance between markers [px]

    Returns
    -------
    Ground under every pixel, shape (H, W, 3), as precise as the light.
    """
    shading = _polynomial_shading(linear, plain)
    ratio = linear / shading
    plain = plain & _near_one(ratio)
    height, width = plain.shape
    small = (width // _STRIDE, height // _STRIDE)
    parts: Any = np.dstack([ratio * plain[..., None], plain]).astype(np.float32)
    parts = cv2.resize(parts, small, interpolation=cv2.INTER_AREA)
    parts = cv2.GaussianBlur(parts, (0, 0), scale / _STRIDE)
    # Far from all plain pixels the polynomial alone counts.
    local = (parts[..., :3] + 1e-3) / (parts[..., 3:] + 1e-3)
    return shading * cv2.resize(local, (width, height), interpolation=cv2.INTER_LINEAR)


def _polynomial_shading(linear: Light, plain: NDArray[np.bool_]) -> Single:
    """Log-polynomial through the plain pixels, per channel, shape (H, W, 3)."""
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
        # Normal equations: thirty unknowns of ten thousand pixels.
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
    """Mask of pixels with light near the shading in every channel, shape (H, W).

    `near` is a relative difference: more than noise, less than an edge.
    """
    low, high = [1.0 - near] * 3, [1.0 + near] * 3
    return np.asarray(cv2.inRange(ratio, np.array(low), np.array(high))).astype(bool)
