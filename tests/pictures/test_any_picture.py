"""Pictures of sensors, cut, scaled or stored otherwise: each is tracked, or refused."""

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
PICTURES, TOGETHER = 90, 15
DESIGNS = ("thesis", "dome-2020", "dome-2022", "flat-2019", "fovea")


@cache
def at_rest(design: str) -> Picture:
    """Picture of a design (H, W, 3), blue first, as OpenCV writes it."""
    sensor = load_sensor(design)
    image = open_renderer("painter", sensor).render(rest_membrane(sensor))
    return np.ascontiguousarray(image[..., ::-1])


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


MAKES = (cut, resized)


@pytest.mark.data
@pytest.mark.parametrize("first", range(0, PICTURES, TOGETHER))
def test_any_picture_is_tracked_or_refused(first: int, tmp_path: Path) -> None:
    trackers = sorted(tracker_names())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for number in range(first, first + TOGETHER):
            rng = np.random.default_rng(number)
            make = MAKES[number % len(MAKES)]
            file = tmp_path / f"{number}.png"
            cv2.imwrite(str(file), make(rng))
            tracker = trackers[number % len(trackers)]
            try:
                list_markers(file)
                track_source(str(file), str(file), tracker=tracker)
            except UserError:
                pass
            except Exception as error:
                raise AssertionError(f"picture {number}, {make.__name__}, {tracker}") from error
            file.unlink()
