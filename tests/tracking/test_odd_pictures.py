"""Odd pictures in all trackers: each is followed or refused in a sentence, and none crashes."""

from collections.abc import Callable
from contextlib import suppress

import cv2
import numpy as np
import pytest

from chromagrip import UserError
from chromagrip.render import Frame
from chromagrip.tracking import learn_palette, load_tracker, sight, tracker_names


def drawn(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Ground, and discs of one size or of several, on a grid or anywhere, (H, W, 3)."""
    image = np.empty((*shape, 3), np.float32)
    image[:] = rng.uniform(0.0, 255.0, 3)
    image *= np.linspace(rng.choice([0.3, 1.0]), 1.0, shape[1], dtype=np.float32)[:, None]
    radius, inks = rng.uniform(0.5, 20.0), rng.uniform(0.0, 255.0, (3, 3))
    pitch = radius * rng.uniform(1.8, 6.0)
    places = np.stack(np.meshgrid(*(np.arange(0, side, pitch) for side in shape[::-1])), -1)
    places = places.reshape(-1, 2)[: int(rng.choice([10, 2000, 2000]))]
    if rng.random() < 0.2:
        places = rng.uniform(-10.0, max(shape) + 10.0, places.shape)
    kinds = rng.integers(0, rng.choice([1, 1, 3]), len(places))
    for (x, y), kind in zip(np.rint(16.0 * places).astype(int).tolist(), kinds, strict=True):
        size = max(1, round(16.0 * radius * (1.0, 0.5, 2.0)[kind]))
        cv2.circle(image, (x, y), size, inks[kind].tolist(), -1, cv2.LINE_AA, 4)
    return image


def holed(rng: np.random.Generator, image: np.ndarray) -> np.ndarray:
    top, left = (int(rng.integers(0, side)) for side in image.shape[:2])
    image = image.copy()
    image[top : top + 80, left : left + 80] = rng.uniform(0, 255)
    return image


CHANGES: list[Callable[[np.random.Generator, np.ndarray], np.ndarray]] = [
    lambda rng, image: image + rng.normal(0.0, rng.uniform(1.0, 60.0), image.shape),
    lambda rng, image: cv2.GaussianBlur(image.astype("f4"), (0, 0), rng.uniform(0.5, 6.0)),
    holed,
    lambda rng, image: np.rint(image / 60.0) * 60.0,
    lambda rng, image: image * rng.uniform(0.0, 3.0),
    lambda rng, image: np.roll(image, rng.integers(-40, 40, 2), axis=(0, 1)),
    lambda rng, image: image.mean(axis=2, keepdims=True).repeat(3, axis=2),
    lambda rng, image: 255.0 - image,
]


def spoilt(rng: np.random.Generator, image: np.ndarray) -> np.ndarray:
    """Up to two changes."""
    for kind in rng.choice(len(CHANGES), size=rng.integers(0, 3)):
        image = CHANGES[kind](rng, image)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def try_all(seed: int) -> None:
    """Show odd pictures of one seed to each tracker, which may refuse them."""
    rng = np.random.default_rng(seed)
    shape = (int(rng.integers(16, 260)), int(rng.integers(16, 320)))
    first = drawn(rng, shape)
    rest = spoilt(rng, first)
    later = [spoilt(rng, first if rng.random() < 0.8 else drawn(rng, shape)) for _ in range(3)]
    try:
        palette = learn_palette(rest, sight(rest))
    except UserError:
        return
    for name in tracker_names():
        with suppress(UserError):
            tracker = load_tracker(name)(palette, float(rng.uniform(0.5, 5.0)))
            known = tracker.reset([Frame(image=rest, time=0.0)])
            for k, image in enumerate(later):
                tracks = tracker.update(Frame(image=image, time=0.02 * (k + 1)))
                assert tracks.position.shape == known.position.shape
                assert np.isfinite(tracks.position[tracks.visible]).all()


@pytest.mark.parametrize(
    ("first", "count"),
    [(1, 1), pytest.param(20, 40, marks=pytest.mark.fuzz)],
)
def test_odd_pictures_are_followed_or_refused_by_every_tracker(first: int, count: int) -> None:
    for seed in range(first, first + count):
        try_all(seed)
