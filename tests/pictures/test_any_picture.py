"""Pictures of any kind: each is tracked, or refused in one sentence; nothing crashes or warns."""

import warnings
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from chromagrip.errors import UserError
from chromagrip.pictures.marker_list import list_markers
from chromagrip.pictures.track import track_source
from chromagrip.render import load_sensor, open_renderer, rest_membrane
from chromagrip.tracking import tracker_names

Picture = np.ndarray
Random = np.random.Generator
#: Pictures in all, and in one test.
PICTURES, TOGETHER = 500, 25
DESIGNS = ("thesis", "dome-2020", "dome-2022", "flat-2019", "fovea")
FONTS = 8


@cache
def at_rest(design: str) -> Picture:
    """Picture of a design (H, W, 3), blue first, as OpenCV writes it."""
    sensor = load_sensor(design)
    image = open_renderer("painter", sensor).render(rest_membrane(sensor))
    return np.ascontiguousarray(image[..., ::-1])


def size(rng: Random) -> tuple[int, int]:
    """Height and width, mostly small, to 4000 px."""
    height, width = np.exp(rng.uniform(0.0, np.log([900.0, 900.0])))
    if rng.random() < 0.05:
        height, width = 4000.0, max(1.0, width / 2.0)
    return int(height), int(width)


def constant(rng: Random) -> Picture:
    return np.full((*size(rng), 3), rng.integers(0, 256, 3), np.uint8)


def noise(rng: Random) -> Picture:
    image = rng.integers(0, 256, (*size(rng), 3)).astype(np.uint8)
    blur = rng.choice([0.0, rng.uniform(0.5, 6.0)])
    return np.asarray(cv2.GaussianBlur(image, (0, 0), blur)) if blur else image


def slope(rng: Random) -> Picture:
    height, width = size(rng)
    down, across = rng.uniform(0.0, 300.0, 2)
    light = np.add.outer(np.linspace(0.0, down, height), np.linspace(0.0, across, width))
    return np.clip(light[..., None] * rng.uniform(0.2, 1.0, 3), 0, 255).astype(np.uint8)


def writing(rng: Random) -> Picture:
    height, width = size(rng)
    image = np.full((max(height, 60), max(width, 100), 3), 255, np.uint8)
    scale, thick, font = rng.uniform(0.4, 1.2), int(rng.integers(1, 3)), int(rng.integers(FONTS))
    for y in range(20, len(image), 30):
        words = "".join(chr(c) for c in rng.integers(33, 126, 40))
        cv2.putText(image, words, (5, y), font, scale, (0, 0, 0), thick)
    return image


def cut(rng: Random) -> Picture:
    """A part of a sensor, cut through markers anywhere."""
    image = at_rest(str(rng.choice(DESIGNS)))
    top, left = (int(rng.integers(0, side - 1)) for side in image.shape[:2])
    height, width = (int(rng.integers(1, side)) for side in image.shape[:2])
    return np.ascontiguousarray(image[top : top + height, left : left + width])


def resized(rng: Random) -> Picture:
    image, scale = at_rest(str(rng.choice(DESIGNS))), rng.uniform(0.1, 2.2)
    how = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=how))


def stored_otherwise(rng: Random) -> Picture:
    """A sensor in grey, in 16 bits, with alpha, or with a channel at 0 or 255."""
    image = at_rest(str(rng.choice(DESIGNS)))
    how = rng.integers(0, 5)
    if how == 0:
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
    if how == 1:
        return image.astype(np.uint16) * 257
    if how == 2:
        alpha = rng.integers(0, 256, image.shape[:2]).astype(np.uint8)
        return np.dstack([image, alpha])
    image = image.copy()
    image[..., rng.integers(0, 3)] = 0 if how == 3 else 255
    return image


NOTHING = (constant, noise, slope, writing)
SENSORS = (cut, resized, stored_otherwise)


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, PICTURES, TOGETHER))
def test_any_picture_is_tracked_or_refused(first: int, tmp_path: Path) -> None:
    trackers = sorted(tracker_names())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for number in range(first, first + TOGETHER):
            rng = np.random.default_rng(number)
            make = (*NOTHING, *SENSORS)[number % (len(NOTHING) + len(SENSORS))]
            file = tmp_path / f"{number}.png"
            cv2.imwrite(str(file), make(rng))
            tracker = trackers[number % len(trackers)]
            try:
                list_markers(file)
                assert make not in NOTHING, f"markers in picture {number}, {make.__name__}"
                track_source(str(file), str(file), tracker=tracker)
            except UserError:
                pass
            except Exception as error:
                raise AssertionError(f"picture {number}, {make.__name__}, {tracker}") from error
            file.unlink()
