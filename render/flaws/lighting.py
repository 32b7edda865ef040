"""Defects of the light that do not change: uneven LEDs, vignette, seams, dust, reflections."""

import msgspec
import numpy as np
import scipy
from numpy.typing import NDArray

from ..colour import decode_srgb
from ..design.dials import Defects
from ..design.sensor import Seams, SensorDesign
from ..ground import inside_rim, pixel_grid, pixel_places, seam_cover
from .defects import DUST, GORE_COUNT, LEDS, SEAMS, SPECULAR
from .texture import blotches, grain, threads

Array = NDArray[np.float64]
Image32 = NDArray[np.float32]

#: Seams of a skin that is glued from four gores (of designs without seams of their own).
GORES = Seams(count=GORE_COUNT, width_mm=0.9, colour=(226, 196, 201))


def light_map(sensor: SensorDesign, defects: Defects, seed: int) -> Image32 | None:
    """Factor on each pixel's linear light, shape (H, W, 3); None if it is 1 everywhere."""
    d = defects
    textured = d.glow or d.blotches or d.grain or d.threads
    if not (d.vignette or d.uneven_leds or d.seam_tint or d.dust or textured):
        return None
    pixels, places, skin = _skin(sensor)
    factor = np.ones((*skin.shape, 3))
    glued = (205, 163, 158)  # colour of broad seams: there is glue in them
    if d.seam_tint:
        tinted = sensor if sensor.seams else msgspec.structs.replace(sensor, seams=GORES)
        assert tinted.seams is not None
        tint = decode_srgb(np.array(glued if d.seam_width_mm else tinted.seams.colour, dtype=float))
        dye = tint / decode_srgb(np.array(sensor.ground.apex, dtype=float))
        cover = np.where(skin, _seams(tinted, d, places, seed), 0.0)
        factor *= np.maximum(1.0 - d.seam_tint * cover[..., None] * (1.0 - dye), 0.0)
    if d.uneven_leds:
        factor *= 1.0 + d.uneven_leds * _led_pattern(sensor, pixels, skin, seed)[..., None]
    if d.dust:
        factor *= _dust(sensor, pixels, skin, d.dust, seed)[..., None]
    glow_width = 0.7  # radius of the middle that is too bright, in radii of the skin's image
    if textured:
        away = (pixels - _middle(sensor)) / _radius(skin)
        factor *= 1.0 + d.glow * np.exp(-0.5 * (away**2).sum(axis=-1) / glow_width**2)[..., None]
        radius = _radius(skin)
        texture = np.ones_like(factor)
        if d.blotches:
            texture *= blotches(away, radius, d.blotches, seed)
        if d.grain:
            texture *= grain(away, radius, d.grain, seed)
        if d.threads:
            texture *= threads(away, radius, d.threads, seed)
        factor *= np.where(skin[..., None], texture, 1.0)
    if d.vignette:
        factor *= _vignette(sensor, pixels, d.vignette)[..., None]
    return factor.astype(np.float32)


def _seams(sensor: SensorDesign, defects: Defects, places: Array, seed: int) -> Array:
    """Share of each pixel covered by a seam (H, W): the design's, or as wide and crooked as set."""
    assert sensor.seams is not None
    width, wander, gaps = defects.seam_width_mm, defects.seam_wander_mm, defects.seam_gaps
    if not (width or wander or gaps):
        return seam_cover(sensor, places)
    first, phi = np.nan_to_num(places[..., 0]), np.nan_to_num(places[..., 1])
    metric = 1e3 * sensor.shape.metric(0.0)
    along = first * metric  # [mm]
    ring = sensor.shape.ring(first) * metric
    rng = np.random.default_rng([seed, SEAMS])
    cover = np.zeros(first.shape)
    for number in range(sensor.seams.count):
        turn = phi - 2 * np.pi * number / sensor.seams.count
        bend, wide, there = (_wavy(along, rng) for _ in range(3))
        aside = np.sin(turn) * ring - wander * (rng.uniform(-0.5, 0.5) + 0.5 * bend)
        half = 0.5 * (width or sensor.seams.width_mm) * (0.65 + 0.35 * wide)
        # As often as not one edge is sharper than the other.
        edge = scipy.special.expit((half - abs(aside)) / (0.15 * half))
        present = np.clip(0.5 + 3.0 * (there + 1.0 - 2.0 * gaps), 0.0, 1.0)
        behind = np.clip(0.5 + np.cos(turn) * ring / half, 0.0, 1.0)
        cover = np.maximum(cover, edge * present * behind * (0.8 + 0.2 * wide))
    return cover


def _wavy(along: Array, rng: np.random.Generator) -> Array:
    """Slow variation along a seam, within ±1."""
    waves = [
        np.sin(along / length + rng.uniform(0.0, 2 * np.pi))
        for length in rng.uniform([3.0, 1.2], [6.0, 2.2])
    ]
    return np.asarray(0.65 * waves[0] + 0.35 * waves[1])


def glare_map(sensor: SensorDesign, defects: Defects, seed: int) -> Image32 | None:
    """Linear light that LED reflections add, shape (H, W, 3); None without any."""
    if not defects.specular:
        return None
    pixels, _, skin = _skin(sensor)
    glare = np.zeros(skin.shape)
    rng = np.random.default_rng([seed, SPECULAR])
    radius = _radius(skin)
    # A mirrored ring is a ring, as even as its LEDs were soldered.
    around = 2 * np.pi * (np.arange(defects.specular) / defects.specular + rng.random())
    brightness = 4.0  # brightness of reflections, in units of white: they saturate
    for angle in around:
        angle, share = angle + rng.normal(0.0, 0.08), rng.normal(0.62, 0.03)
        centre = _middle(sensor) + radius * share * np.array([np.cos(angle), np.sin(angle)])
        width = radius * rng.uniform(0.004, 0.008)
        _stamp(glare, centre, (width, width * rng.uniform(1.0, 1.8)), angle, 2, brightness)
    if defects.vignette:
        glare *= _vignette(sensor, pixels, defects.vignette)
    return np.repeat(glare[..., None], 3, axis=-1).astype(np.float32)


def _skin(sensor: SensorDesign) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Pixels (H, W, 2), the places seen there, and whether they are on the skin (H, W)."""
    places = pixel_places(sensor)
    return pixel_grid(sensor), places, inside_rim(sensor, places) > 0.0


def _middle(sensor: SensorDesign) -> Array:
    """Pixel (x, y) on the axis."""
    return sensor.view.project(sensor.shape.points(np.zeros(2), 0.0))


def _radius(skin: NDArray[np.bool_]) -> float:
    """Radius of the disc that is as large as the skin's image [px]."""
    return float(np.sqrt(skin.sum() / np.pi))


def _vignette(sensor: SensorDesign, pixels: Array, loss: float) -> Array:
    square = ((pixels - _middle(sensor)) ** 2).sum(axis=-1)
    return 1.0 - loss * square / square.max()


def _led_pattern(sensor: SensorDesign, pixels: Array, skin: NDArray[np.bool_], seed: int) -> Array:
    """Deviation of the light: on the skin of mean 0 and at most 1."""
    rng = np.random.default_rng([seed, LEDS])
    count = 6  # LEDs around the skin
    angle = 2 * np.pi * (np.arange(count) / count + rng.random())
    place = (pixels - _middle(sensor)) / _radius(skin)
    light = np.zeros(skin.shape)
    lobe = 0.5  # width of an LED's lobe, in radii of the skin's image
    ring = 1.1  # radius of the ring of LEDs, in radii of the skin's image
    for a, strength in zip(angle, rng.uniform(-1.0, 1.0, count), strict=True):
        away = place - ring * np.array([np.cos(a), np.sin(a)])
        light += strength / (lobe**2 + (away**2).sum(axis=-1))
    light -= light[skin].mean()
    return np.clip(light / abs(light[skin]).max(), -1.0, 1.0)


def _dust(
    sensor: SensorDesign, pixels: Array, skin: NDArray[np.bool_], count: int, seed: int
) -> Array:
    """Transmittance of that many specks, from grains to fibres."""
    rng = np.random.default_rng([seed, DUST])
    clear = np.ones(skin.shape)
    centres = pixels[skin][rng.integers(0, skin.sum(), count)]
    for centre in centres:
        width = max(_radius(skin) * rng.uniform(0.004, 0.016), 0.7)
        length = width * (1.0 + 4.0 * rng.random() ** 3)
        speck = np.zeros(skin.shape)
        _stamp(speck, centre, (width, length), rng.uniform(0.0, np.pi), 4, rng.uniform(0.15, 0.6))
        clear *= 1.0 - speck
    return clear


def _stamp(
    image: Array,
    centre: Array,
    widths: tuple[float, float],
    angle: float,
    power: int,
    height: float,
) -> None:
    """Add height·exp(−½·r^power) around a pixel, r in widths [px] along the angle and across."""
    reach = int(4.0 * max(widths)) + 1
    left, top = np.maximum(np.rint(centre).astype(int) - reach, 0)
    part = image[top : top + 2 * reach + 1, left : left + 2 * reach + 1]
    y, x = np.mgrid[: part.shape[0], : part.shape[1]]
    x, y = x + left - centre[0], y + top - centre[1]
    cos, sin = np.cos(angle), np.sin(angle)
    r = np.hypot((cos * x + sin * y) / widths[0], (cos * y - sin * x) / widths[1])
    part += height * np.exp(-0.5 * r**power)
