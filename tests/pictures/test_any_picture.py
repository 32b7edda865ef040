"""Pictures of parts of sensors: each is tracked, or refused."""

import warnings
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from chromagrip.errors import UserError
from chromagrip.pictures.marker_list import list_markers
from chromagrip.pictures.track import track_source
from chromagrip.render import load_sensor, open_renderer, rest_membrane
from chromagrip.tracking import tracker_names

from .drawn_dots import save

DESIGNS = ("thesis", "dome-2020", "dome-2022", "flat-2019", "fovea")


@cache
def at_rest(design: str) -> np.ndarray:
    sensor = load_sensor(design)
    return open_renderer("painter", sensor).render(rest_membrane(sensor))


def cut(rng: np.random.Generator) -> np.ndarray:
    """A part of a sensor's picture, cut through markers anywhere, and doubled or not."""
    image = at_rest(str(rng.choice(DESIGNS)))
    top, left = (int(rng.integers(0, side - 1)) for side in image.shape[:2])
    height, width = (int(rng.integers(1, side)) for side in image.shape[:2])
    scale = int(rng.integers(1, 3))
    return image[top : top + height, left : left + width].repeat(scale, axis=0).repeat(scale, 1)


@pytest.mark.data
def test_any_picture_is_tracked_or_refused(tmp_path: Path) -> None:
    for seed, tracker in enumerate(6 * sorted(tracker_names())):
        file = save(tmp_path / "one.png", cut(np.random.default_rng(seed)))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                list_markers(file)
                track_source(str(file), str(file), tracker=tracker)
        except UserError:
            pass
        except Exception as error:
            raise AssertionError(f"picture {seed}, {tracker}") from error
