"""Texture of a real skin: coloured clouds, fine structure, hairs and threads of glue.

Each function gives a factor on linear light, (H, W, 3), from the places of the pixels in radii of
the skin's image from its middle, (H, W, 2), and that radius [px].
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from .defects import BLOTCHES, GRAIN, THREADS

Array = NDArray[np.float64]


def blotches(away: Array, radius: float, contrast: float, seed: int) -> Array:
    """Bluish and brownish clouds whose contrast is a share of the light."""
    rng = np.random.default_rng([seed, BLOTCHES])
    cloud = 0.11  # size of clouds, in radii of the skin's image
    blue, brown = (
        np.maximum(_clouds(away.shape[:2], cloud * radius, rng), 0.0)[..., None] for _ in range(2)
    )
    # There is more of it towards the rim, where the skin is seen aslant.
    share = (0.3 + 1.2 * (away**2).sum(axis=-1))[..., None]
    # What clouds take from red, green and blue: the skin is bluish where there is more of it.
    bluish = np.array([1.0, 0.75, 0.25])
    return np.asarray(np.exp(-contrast * share * (blue * bluish + 0.5 * brown * bluish[::-1])))


def grain(away: Array, radius: float, deviation: float, seed: int) -> Array:
    """Fine structure of that standard deviation."""
    rng = np.random.default_rng([seed, GRAIN])
    size = 0.012  # size of the fine structure, in radii of the skin's image
    fine = _clouds(away.shape[:2], size * radius, rng) + _clouds(
        away.shape[:2], 3.0 * size * radius, rng
    )
    return np.asarray(np.exp(deviation * np.sqrt(0.5) * fine))[..., None]


def threads(away: Array, radius: float, count: int, seed: int) -> Array:
    """Hairs and threads of glue in turn, each a curve of its own."""
    rng = np.random.default_rng([seed, THREADS])
    height, width = away.shape[:2]
    middle = np.array([np.argmin(abs(away[0, :, 0])), np.argmin(abs(away[:, 0, 1]))])
    clear = np.ones((height, width, 3))
    hair = (0.55, 0.5, 0.5)  # light that hairs, and threads of glue, let through
    glue = (0.97, 0.9, 0.45)
    thin = 0.008  # width of a thread, in radii of the skin's image
    for number in range(count):
        steps = np.linspace(0.0, 1.0, 24)
        turn = rng.uniform(0.0, 2 * np.pi) + rng.normal(0.0, 1.2) * steps
        turn = turn + 0.5 * np.sin(rng.uniform(2.0, 8.0) * steps + rng.uniform(0.0, 6.0))
        heading = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        length = rng.uniform(0.2, 0.9)
        path = rng.uniform(-0.55, 0.55, 2) + length / len(steps) * np.cumsum(heading, axis=0)
        drawn = np.zeros((height, width), dtype=np.uint8)
        points = np.rint(16.0 * (middle + radius * path)).astype(np.int32)
        thick = max(1, round(thin * radius * rng.uniform(0.8, 2.0)))
        cv2.polylines(drawn, [points], False, 255, thick, cv2.LINE_AA, 4)
        soft = np.asarray(cv2.GaussianBlur(drawn, (0, 0), 0.6), dtype=float)
        cover = soft[..., None] / 255.0
        through = np.array(hair if number % 2 == 0 else glue)
        clear *= 1.0 - rng.uniform(0.4, 1.0) * cover * (1.0 - through)
    return clear


def _clouds(shape: tuple[int, ...], size: float, rng: np.random.Generator) -> Array:
    """Smooth noise of mean 0 and deviation 1, (H, W)."""
    noise = rng.standard_normal(shape[:2])
    smooth = np.asarray(cv2.GaussianBlur(noise, (0, 0), max(size, 0.4)))
    return np.asarray((smooth - smooth.mean()) / smooth.std())
