"""How a dome with coloured discs looks at rest: statistics that compare a rendering with a picture.

All lengths are in radii of the dome's image, unless they say otherwise; colours are CIELAB, D65.
"""

import tomllib
from contextlib import closing
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from chromagrip.render import (
    Flaws,
    Imaging,
    add_noise,
    load_sensor,
    open_renderer,
    rest_membrane,
)
from chromagrip.tracking import detect_markers, learn_palette, sight

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

#: Chroma above which a pixel is of a marker, and that its ground has at most.
_DYED, _PLAIN = 30.0, 24.0
#: Pixels further out are the rim's.
_INSIDE = 0.96
#: Radius of the middle, and radii of a ring near the rim.
_MIDDLE, _OUTER = 0.3, (0.8, 0.92)
#: What is finer than this is fine structure.
_FINE = 0.03
#: Quantiles that describe a palette.
QUANTILES = np.linspace(0.01, 0.99, 25)
#: Width from 10 to 90 % of a blurred edge, over its height and largest slope.
_EDGE = 2 * 1.2816 / np.sqrt(2 * np.pi)
#: Directions in which the edge of a marker is looked at.
_WAYS = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)


class Look(NamedTuple):
    """Statistics of one picture.

    Attributes
    ----------
    markers: that are visible
    radius, nearest: of a marker, and distance to the nearest other, in the median
    radius_low, radius_high: from 10 to 90 % of the markers
    farthest: of a marker from the middle
    area: share of the dome's image that the outer layer's markers would cover, each whole
    misaligned: distance of the layers in the gore where it is largest, in diameters of a marker
    fall: L* of the middle over that of the rim
    tint: standard deviation of a* and b* of the ground, the larger of both
    fine: standard deviation of the fine structure in L*
    orange: L*, a*, b* of both dyes on each other
    edge_px: width of an edge from 10 to 90 % at a dome's radius of 131 px [px]
    palette: quantiles of L*, a*, b* inside the dome, shape (3, Q)
    """

    markers: int
    radius: float
    radius_low: float
    radius_high: float
    nearest: float
    farthest: float
    area: float
    misaligned: float
    fall: float
    tint: float
    fine: float
    orange: Array
    edge_px: float
    palette: Array


def look(image: Image, centre: tuple[float, float], radius: float) -> Look:
    """Statistics of a picture of a dome at rest.

    Parameters
    ----------
    image: sRGB, shape (H, W, 3)
    centre: of the dome's image (x, y) [px]
    radius: of the dome's image [px]
    """
    scaled = image.astype(np.float32) / np.float32(255.0)
    lab = np.asarray(cv2.cvtColor(scaled, cv2.COLOR_RGB2LAB), dtype=float)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    away = np.hypot(x - centre[0], y - centre[1]) / radius
    inside = away < _INSIDE
    chroma = np.hypot(lab[..., 1], lab[..., 2])
    dyed = inside & (chroma > _DYED)
    near = cv2.dilate(dyed.astype(np.uint8), np.ones((3, 3), np.uint8), iterations=2) > 0
    plain = inside & ~near & (chroma < _PLAIN)
    disc = np.repeat((away < 1.02)[..., None], 3, axis=2)
    shown = np.where(disc, image, 0).astype(np.uint8)
    magenta, yellow = detect_markers(shown, learn_palette(shown, sight(shown)))
    at = (magenta.position - centre) / radius
    whole = magenta.area > 0.0  # that of a marker beside the rim is not known
    sizes = np.sqrt(magenta.area[whole] / np.pi) / radius
    light = np.asarray(lab[..., 0])
    fine = light - _smooth(light, plain, _FINE * radius)
    return Look(
        markers=len(at),
        radius=float(np.median(sizes)),
        radius_low=float(np.quantile(sizes, 0.1)),
        radius_high=float(np.quantile(sizes, 0.9)),
        nearest=float(np.median(np.asarray(KDTree(at).query(at, k=2)[0])[:, 1])),
        farthest=float(np.hypot(*at.T).max()),
        area=float(len(at) * np.median(sizes) ** 2),
        misaligned=_misaligned(at, (yellow.position - centre) / radius, 2.0 * np.median(sizes)),
        fall=float(
            np.median(light[plain & (away < _MIDDLE)])
            - np.median(light[plain & (away > _OUTER[0]) & (away < _OUTER[1])])
        ),
        tint=float(lab[plain][:, 1:].std(axis=0).max()),
        fine=float(fine[plain].std()),
        orange=_orange(lab, dyed),
        edge_px=_edge(image[..., 1].astype(float), magenta.position[whole], sizes * radius)
        * 131
        / radius,
        palette=np.quantile(lab[inside], QUANTILES, axis=0).T,
    )


@cache
def real_dome() -> dict[str, dict[str, list[float]]]:
    """Ranges of the statistics of the real dome of 2020, and its palette."""
    text = (files(__package__) / "real_dome.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def likenesses(seen: Look) -> dict[str, bool]:
    """Whether each statistic of a rendering is within the range of the real dome's."""
    real = real_dome()
    values = {name: getattr(seen, name) for name in real["ranges"]}
    ranges = dict(real["ranges"])
    for name, value in zip(real["orange"], seen.orange, strict=True):
        values[f"orange_{name}"], ranges[f"orange_{name}"] = value, real["orange"][name]
    return {name: bool(low <= values[name] <= high) for name, (low, high) in ranges.items()}


def built_dome(seed: int, noise: float = 1.0) -> Image:
    """Picture of the unloaded dome of 2020 as built; the seed is its specimen."""
    sensor = load_sensor("dome-2020")
    flaws = Flaws(sensor, sensor.defects, seed)
    with closing(open_renderer("painter", sensor)) as renderer:
        image = renderer.render(flaws(rest_membrane(sensor, flaws.places)))
    imaging = Imaging(sensor, sensor.defects, seed)
    image = imaging.measured(image, 0)
    add_noise(image, noise, seed, 0)
    return imaging.compressed(image)


def look_of_built(seed: int) -> Look:
    """Statistics of that picture."""
    sensor = load_sensor("dome-2020")
    skin, view = sensor.shape, sensor.view
    at = view.project(skin.points(np.array([[0.0, 0.0], [skin.rim, 0.0]]), 0.0))
    return look(built_dome(seed), tuple(at[0]), float(np.hypot(*(at[1] - at[0]))))


def palette_distance(palette: Array, other: Array) -> float:
    """Distance of two palettes (3, Q): of Wasserstein in L*, a* and b*, as one length."""
    return float(np.linalg.norm(abs(palette - other).mean(axis=1)))


def _smooth(light: Array, some: Mask, size: float) -> Array:
    """Mean of the light of some pixels around each pixel."""
    weight = some.astype(float)
    total, count = (np.asarray(cv2.GaussianBlur(v, (0, 0), size)) for v in (light * weight, weight))
    return np.asarray(total / np.maximum(count, 1e-9))


def _misaligned(magenta: Array, yellow: Array, diameter: float) -> float:
    """Median distance of the layers in the worst quarter of the dome, in diameters."""
    away, number = KDTree(yellow).query(magenta, distance_upper_bound=1.2 * diameter)
    found = np.isfinite(away)
    gap = yellow[np.asarray(number)[found]] - magenta[found]
    x, y = magenta[found].T
    quarter = np.floor(np.arctan2(y, x) / (np.pi / 2))
    each = np.array([np.median(gap[quarter == q], axis=0) for q in np.unique(quarter)])
    return float(np.linalg.norm(each, axis=1).max() / diameter)


def _orange(lab: Array, dyed: Mask) -> Array:
    """Colour of both dyes on each other: of the dyed pixels that are neither magenta nor yellow."""
    inner = cv2.erode(dyed.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    hue = np.degrees(np.arctan2(lab[..., 2], lab[..., 1]))
    return np.asarray(np.median(lab[inner & (hue > 35.0) & (hue < 62.0)], axis=0))


def _edge(light: Array, position: Array, radius: Array) -> float:
    """Width of the markers' edges from 10 to 90 %, of the sharper ones [px]."""
    steps: Array = np.arange(-5.0, 5.01, 0.5)
    widths = []
    for centre, size in zip(position, radius, strict=True):
        for way in _WAYS:
            path = centre + (size + steps[:, None]) * np.array([np.cos(way), np.sin(way)])
            x, y = path.T.astype(np.float32)[:, None]
            line = cv2.remap(light.astype(np.float32), x, y, cv2.INTER_LINEAR)[0]
            height, slope = line[-4:].mean() - line[:4].mean(), np.diff(line).max() / 0.5
            if height > 40.0:
                widths.append(_EDGE * height / slope)
    # Other markers and texture beside an edge make it look wider.
    return float(np.quantile(widths, 0.25))
