"""A specimen of `dome-2020`, whose printed discs are crooked: what is seen of it stays seen."""

from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from chromagrip.loop.grasp import grasp
from chromagrip.render import Frame
from chromagrip.scene.scene import load_scene
from chromagrip.sensing.reader import known_sensor
from chromagrip.sensing.sensor import open_camera
from chromagrip.tracking import MarkerTracker, Palette
from chromagrip.tracking.fit import tracker as module

#: Frames of a light touch, and the first one that a lamp may change in.
FRAMES, DIMMED = 12, 6


@pytest.fixture(scope="module")
def pictures() -> tuple[MarkerTracker, list[Frame]]:
    """Tracker of the specimen at rest, and frames of a light touch."""
    changes = {"path": "camera", "sensor": "dome-2020", "duration_s": 0.01 * FRAMES}
    scene = load_scene("dome-1", changes)
    with closing(open_camera(scene)) as camera:
        samples = grasp(scene, camera)
        rest = camera.expose_rest(next(samples).contact.state, 8)
        frames = [sample.frame for sample in samples if sample.frame is not None]
    tracker = MarkerTracker(Palette.of_sensor(known_sensor(scene).sensor), 2.0)
    tracker.reset(rest)
    return tracker, frames


@pytest.fixture
def fits_of_colours(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What is added to when colours are fitted."""
    fits: list[Any] = []
    tune = module.tune

    def counted(*args: Any) -> Any:
        fits.append(args)
        return tune(*args)

    monkeypatch.setattr(module, "tune", counted)
    return fits


@pytest.mark.loops
def test_markers_that_are_seen_at_rest_and_no_others_are_seen_in_a_light_touch(
    pictures: tuple[MarkerTracker, list[Frame]], fits_of_colours: list[Any]
) -> None:
    tracker, frames = pictures
    start, seen = tracker.state, tracker.rest.visible
    assert 0.8 * seen.size < seen.sum() < seen.size
    for frame in frames:
        assert (tracker.update(frame).visible == seen).all()
    tracker.state = start
    assert not fits_of_colours  # they explain no less than at rest


def test_colours_of_crooked_markers_are_fitted_where_the_light_changes(
    pictures: tuple[MarkerTracker, list[Frame]], fits_of_colours: list[Any]
) -> None:
    tracker, frames = pictures
    start, seen = tracker.state, tracker.rest.visible
    for frame in frames[:DIMMED]:
        tracker.update(frame)
    before = tracker.state
    clear = [tracker.update(frame) for frame in frames[DIMMED:]]
    tracker.state = before
    for frame, tracks in zip(frames[DIMMED:], clear, strict=True):
        image = np.rint(0.8 * frame.image + 40.0).astype(np.uint8)
        dim = tracker.update(replace(frame, image=image))
        assert (dim.visible == seen).all()
        off = (dim.position - tracks.position)[seen]
        assert np.sqrt((off**2).mean()) < 0.05
    assert fits_of_colours
    tracker.state = start
