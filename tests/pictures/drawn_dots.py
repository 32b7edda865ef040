"""Pictures of dots with known places and radii."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from chromagrip.render.colour import encode_srgb

Array = NDArray[np.float64]


def spread(width: int, height: int, pitch: float, seed: int = 0) -> Array:
    """Places on a disturbed grid that fills a picture [px], shape (n, 2)."""
    x, y = np.meshgrid(*(np.arange(pitch, side - pitch / 2, pitch) for side in (width, height)))
    places = np.stack([x.ravel(), y.ravel()], axis=-1)
    return places + np.random.default_rng(seed).uniform(-0.06, 0.06, places.shape) * pitch


def covered(size: tuple[int, int], places: Array, radii: Array, blur: float = 1.0) -> Array:
    """Share of each pixel that discs cover, (H, W), of a picture of that width and height."""
    width, height = size
    cover = np.zeros((height, width))
    for (x, y), radius in zip(places, radii, strict=True):
        reach = int(radius + 6.0 * blur)
        left, top = max(0, int(x) - reach), max(0, int(y) - reach)
        part = cover[top : int(y) + reach + 2, left : int(x) + reach + 2]
        rows, cols = np.ogrid[top : top + part.shape[0], left : left + part.shape[1]]
        away = np.hypot(cols - x, rows - y)
        np.maximum(part, 0.5 - 0.5 * np.tanh((away - radius) / blur), out=part)
    return cover


def levels(linear: Array, noise: float = 1.5, seed: int = 0) -> NDArray[np.uint8]:
    """Picture of linear light, with noise [grey levels]."""
    exact = encode_srgb(np.clip(linear, 0.0, 1.0))
    noisy = exact + np.random.default_rng(seed).normal(0.0, noise, exact.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def dotted(
    size: tuple[int, int],
    places: Array,
    radii: Array,
    dye: tuple[float, float, float] = (0.1, 0.1, 0.1),
    ground: tuple[float, float, float] = (0.6, 0.58, 0.5),
) -> NDArray[np.uint8]:
    """Dots of a dye on shaded ground."""
    cover = covered(size, places, radii)[..., None]
    y, x = np.mgrid[: size[1], : size[0]]
    shade = 1.0 - 0.3 * np.hypot(x / size[0] - 0.4, y / size[1] - 0.4)
    return levels(shade[..., None] * np.array(ground) * (1.0 - cover * (1.0 - np.array(dye))))


def save(path: Path, image: NDArray[np.uint8]) -> Path:
    """Write an RGB picture, and its folder."""
    path.parent.mkdir(exist_ok=True)
    assert cv2.imwrite(str(path), image[..., ::-1])
    return path
