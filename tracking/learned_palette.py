"""Colours of a specimen's markers, learned from a picture of it at rest.

By Beer and Lambert's law the log attenuation of a dye lies on a ray in the space of the three
channels. Where two layers overlap, their attenuations add up. So every marked pixel lies between
the rays of the single dyes, which are estimated at both ends of the distribution.
"""

import itertools
import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from .palette import Palette, load_palette
from .sighting import Sighting
from .spots import find_spots
from .unmixing import (
    AROUND,
    COLOURED,
    DARKEST,
    dye_densities,
    linear_light,
    rough_ground,
    unmixing_matrix,
)

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class PaletteSettings:
    """Tuned parameters of `learn_palette`.

    Attributes
    ----------
    edge: change of the light from pixel to pixel over the contrast, above which a pixel is at an
        edge and shows mixed light
    marked: smallest absorbed share of light of a marked pixel, over that of the strongest ones
    other: largest deviation of one dye's light from a line over the ground's light, relative to the
        ground
    few: share of one dye's pixels that may deviate further
    outermost: quantiles of the angle at which the ray of a single dye may lie
    alike: cosine between two rays above which they belong to one dye; it is that of 2.6°
    near: largest angle between pixels of one dye and its ray, over the angle between the rays
    known: cosine above which rays belong to the dyes of the default palette
    known_sum: largest relative error of the colour of both its dyes together
    black: light of a pixel over the ground's, in its brightest channel, below which it is black
    blacks: share of such pixels above which they are dots, and not where two dyes overlap
    clear: smallest light of one of two dyes in its brightest channel, if together they are black
    seldom: smallest share of the pixels that then show each of them alone
    grey: largest difference between the channels of a grey dye
    darkest, brightest: bounds of an estimated transmittance
    """

    edge: float = 0.12
    marked: float = 0.35
    other: float = 0.15
    few: float = 0.05
    outermost: tuple[float, ...] = (0.01, 0.03, 0.08, 0.16, 0.25)
    alike: float = 0.999
    near: float = 0.1
    known: float = 0.85
    known_sum: float = 0.2
    black: float = 0.3
    blacks: float = 0.3
    clear: float = 0.7
    seldom: float = 0.08
    grey: float = 0.4
    darkest: float = 1e-3
    brightest: float = 100.0


#: Names of hues from 0° on, 60° each.
_HUES = ("red", "yellow", "green", "cyan", "blue", "magenta")


def learn_palette(
    image: NDArray[np.uint8], seen: Sighting, settings: PaletteSettings = PaletteSettings()
) -> Palette:
    """Learn the palette of the markers in a picture, with one layer or two.

    Markers that are brighter than the ground are assumed to form one layer.

    Parameters
    ----------
    image: sRGB picture, shape (H, W, 3)
    seen: positions of its markers
    """
    linear = linear_light(image)
    smooth = np.maximum(np.asarray(cv2.medianBlur(linear, 3)), np.float32(DARKEST))
    ground, lit = rough_ground(smooth, int(AROUND * seen.pitch), seen.field, seen.bright)
    marked = seen.spots & lit & _even(smooth, ground, settings.edge)
    if not marked.any():
        raise UserError("the dots that are seen show no even colour: they are too small or uneven")
    light, around = smooth[marked], np.maximum(ground, np.float32(DARKEST))[marked]
    share = np.maximum(1.0 - (around / light if seen.bright else light / around), 0.0)
    size = np.linalg.norm(share, axis=1)
    strong = size > settings.marked * np.percentile(size, 98.0)
    light, around, share = light[strong], around[strong], share[strong]
    spread = np.percentile(np.ptp(image[seen.field].astype(np.int16), axis=1), 99.5)
    two = not seen.bright and spread >= COLOURED and _two_dyes(light, around, settings)
    lost = np.log(around / light)
    rays = _distinct(lost, share, settings) if two else []
    black = (light < settings.black * around).all(axis=1)
    if two and black.mean() > settings.blacks:
        # Black dots cast coloured shade, on a side for each of the lights; no dyes add up to them.
        rays = [pair for pair in rays if _add_up(pair, lost, black, settings)]
        light, around = (light, around) if rays else (light[black], around[black])
    if not rays:
        dye = _one_dye(light, around, seen.bright, settings)
        return _both_known(dye, seen, settings.known_sum) or _named(dye[None], seen, settings)
    found = [_named(np.maximum(np.exp(-each), settings.darkest), seen, settings) for each in rays]
    field = seen.field & lit
    return max(found, key=lambda palette: _score(palette, linear, ground, field))


def _distinct(lost: Array, share: Array, settings: PaletteSettings) -> list[Array]:
    """Candidate pairs of rays of two dyes, see `_rays`, except nearly parallel ones.

    Several quantiles are tried, because few markers may show one dye alone.
    """
    ends = itertools.product(settings.outermost, repeat=2)
    pairs = [_rays(lost, share, first, last, settings.near) for first, last in ends]
    return [pair for pair in pairs if float(np.prod(_units(pair), axis=0).sum()) < settings.alike]


def _add_up(pair: Array, lost: Array, black: Mask, settings: PaletteSettings) -> bool:
    """Whether two clear dyes (2, 3) together give the black pixels, and each shows alone."""
    own = np.exp(-pair)
    if own.max(axis=1).min() < settings.clear:
        return False
    together = abs(np.exp(-lost[black]) - own.prod(axis=0)).max(axis=1)
    alone = [abs(np.exp(-lost) - dye).max(axis=1) < settings.other for dye in own]
    shares = [float(np.mean(some)) for some in alone]
    return bool(np.median(together) < settings.other and min(shares) > settings.seldom)


def _even(light: Single, ground: Single, edge: float) -> Mask:
    """Mask of pixels away from edges, where light is mixed, shape (H, W)."""
    slopes = [abs(cv2.Sobel(light, cv2.CV_32F, *way, scale=0.25)) for way in ((1, 0), (0, 1))]
    contrast = abs(ground - light).max(axis=2)
    return np.asarray(np.max(slopes, axis=(0, 3)) < edge * contrast)


def _two_dyes(light: Array, around: Array, settings: PaletteSettings) -> bool:
    """Whether the light of n spot pixels, (n, 3), needs two dyes, on ground of any colour."""
    apart = np.zeros(len(light))
    for own, ground in zip(light.T, around.T, strict=True):
        near = np.ones(len(own), dtype=bool)
        for _ in range(6):
            # Fog and stray light raise the black level of a channel, and never lower it.
            slope, lift = _line(ground[near], own[near])
            left = abs(own - slope * ground - lift)
            near = left <= 2.5 * np.median(left) + 1e-4
        apart = np.maximum(apart, left / (ground + 0.1 * ground.max()))
    return bool((apart > settings.other).mean() > settings.few)


def _line(x: Array, y: Array) -> tuple[float, float]:
    """Slope and intercept of the line fitted to points; intercept 0 if it would be negative."""
    across, up = x - x.mean(), y - y.mean()
    spread = float(across @ across)
    # Uniform ground, as in a saturated channel, gives no slope.
    slope = float(across @ up) / spread if spread > 1e-6 * float(x @ x) else math.inf
    lift = float(y.mean()) - slope * float(x.mean())
    return (slope, lift) if lift > 0.0 else (float(x @ y) / float(x @ x), 0.0)


def _one_dye(light: Array, around: Array, bright: bool, settings: PaletteSettings) -> Array:
    """Transmittance of a single dye (3,), from those of n pixels (n, 3) with the most light."""
    best = light if bright else around
    lit = best > 0.5 * np.percentile(best, 95, axis=0)
    pairs = zip((light / around).T, lit.T, strict=True)
    found = np.array([np.median(ratio[some]) for ratio, some in pairs])
    return np.clip(found, settings.darkest, settings.brightest)


def _both_known(dye: Array, seen: Sighting, error: float) -> Palette | None:
    """Return the default palette if a transmittance (3,) is that of both its dyes, else None.

    Where layers lie exactly on each other, as at rest, a picture shows neither dye alone.
    """
    usual = load_palette()
    both, own = -np.log(usual.transmittance).sum(axis=0), -np.log(dye)
    alike = np.linalg.norm(own - both) < error * np.linalg.norm(both)
    return replace(usual, seen=seen) if alike else None


def _rays(lost: Array, share: Array, first: float, last: float, near: float) -> Array:
    """Estimate the log attenuation of each of two dyes, shape (2, 3), from n marked pixels.

    Parameters
    ----------
    lost: log attenuation of each pixel, shape (n, 3)
    share: absorbed share of light, in which noise is uniform, shape (n, 3)
    first, last: shares of the pixels outside the two rays
    near: largest angle between pixels of one dye and its ray, over the angle between the rays
    """
    axes = np.linalg.svd(share, full_matrices=False)[2][:2]
    axes[0] *= np.sign(axes[0].sum())
    along, across = axes @ share.T
    angle = np.arctan2(across, along)
    low, high = np.quantile(angle, [first, 1.0 - last])
    turn = near * (high - low)
    of = (angle < low + turn, angle > high - turn)
    return np.maximum([np.median(lost[some], axis=0) for some in of], 0.0)


def _score(palette: Palette, linear: Single, ground: Single, field: Mask) -> float:
    """Score of a palette: number of markers found, weighted towards the layer with fewer."""
    densities = dye_densities(linear, ground, unmixing_matrix(palette.transmittance))
    found = (find_spots(density, field, True, palette.spots) for density in densities)
    counts = sorted(len(spots.area) for spots in found)
    # With equal numbers prefer the paler palette: two dyes together absorb more than one.
    return counts[0] + 0.5 * counts[1] + 0.01 * float(palette.transmittance.mean())


def _named(transmittance: Array, seen: Sighting, settings: PaletteSettings) -> Palette:
    """Name a palette after its colours; two dyes of the default palette get its names and order."""
    if len(transmittance) == 2:
        usual = load_palette()
        own, known = (_units(np.log(rows)) for rows in (transmittance, usual.transmittance))
        match = own @ known.T
        if match[0, 0] + match[1, 1] < match[0, 1] + match[1, 0]:
            transmittance, match = transmittance[::-1], match[::-1]
        if min(match[0, 0], match[1, 1]) > settings.known:
            return Palette(names=usual.names, transmittance=transmittance, seen=seen)
    names = [_name(row, settings.grey) for row in transmittance]
    if len(set(names)) < len(names):
        names = [f"{name} {k + 1}" for k, name in enumerate(names)]
    return Palette(names=tuple(names), transmittance=transmittance, seen=seen)


def _units(rows: Array) -> Array:
    """Scale rows to unit length."""
    return rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-9)


def _name(transmittance: Array, grey: float) -> str:
    """Name of a dye's colour; "dark" or "bright" for a grey dye or one brighter than the ground."""
    colour = transmittance / transmittance.max()
    if transmittance.mean() > 1.0:
        return "bright"
    if transmittance.max() < grey or colour.min() > 1.0 - grey:
        return "dark"
    red, green, blue = colour
    hue = np.degrees(np.arctan2(np.sqrt(3.0) * (green - blue), 2.0 * red - green - blue))
    return _HUES[round(hue / 60.0) % 6]
