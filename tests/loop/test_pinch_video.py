"""The video of a pinch: what is where in its pictures, and how many there are."""

import math
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

import chromagrip
from chromagrip import load_scene
from chromagrip.loop.pinch.stage import FINGER_COLOURS, Stage, draw_along, draw_side
from chromagrip.loop.pinch.stage import set_stage as stage_of
from chromagrip.loop.pinch.video import HEIGHT, SIDE, WIDTH, PinchVideo, _upright
from chromagrip.loop.pinch.world import Pinched
from chromagrip.loop.results.dome_picture import FIRST_TOP, TractionPicture
from chromagrip.loop.rig import Rig
from chromagrip.loop.run import run
from chromagrip.loop.sample import Sample, Truth
from chromagrip.model.pinch import rotation_by

from .test_pinch import COARSE

#: Angle of the view downwards [rad], and colour of the object's upper half, RGB.
ABOVE = 0.3
UPPER = (250, 214, 130)
HELD = {"controller": "conservative", "conservative.force_n": 1.5, "duration_s": 0.7}
#: Turn of the hand at the last knot of the path.
TILTED = {"pinch.hand_turns_deg": [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 60.0, 0.0]]}


def scene(**changes: Any) -> chromagrip.Scene:
    keys = {key.replace("__", "."): value for key, value in changes.items()}
    return load_scene("pinch-lift", {**COARSE, **HELD, **keys})


def untouched(its: chromagrip.Scene) -> tuple[Stage, Pinched]:
    """Stage of a scene, and its pinch at the start."""
    rig = Rig(its)
    rig.reset()
    stage = stage_of(rig.plant.pinch, its.duration_s, (560, 464), (232, 232))
    return stage, rig.sample().pinch


def at(pinched: Pinched, time: float) -> Pinched:
    """As if the hand had carried all along its path without any sag."""
    return replace(pinched, state=replace(pinched.state, time=time))


def hue(picture: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """Pixels that have a colour, whatever the light; (row, column) each."""
    values = picture.astype(float)
    size = np.linalg.norm(values, axis=-1) * np.linalg.norm(colour)
    alike = (values @ np.array(colour, float)) / np.maximum(size, 1.0)
    return np.argwhere((alike > 0.9995) & (np.ptp(picture, axis=-1) > 30))


def test_what_is_lifted_moves_up_by_its_way() -> None:
    stage, start = untouched(scene())
    before, after = (hue(draw_side(stage, at(start, t)), UPPER) for t in (0.0, 0.7))
    way = 0.060 * math.cos(ABOVE) / stage.side.pixel
    assert way > 150.0
    assert before[:, 0].min() - after[:, 0].min() == pytest.approx(way, abs=1.01)
    assert before[:, 1].mean() == pytest.approx(after[:, 1].mean(), abs=1.0)


def test_the_first_finger_is_at_the_left_and_a_tilt_lowers_the_second() -> None:
    stage, start = untouched(scene(**TILTED))
    level, tilted = (
        [hue(draw_side(stage, at(start, time)), each).mean(axis=0) for each in FINGER_COLOURS]
        for time in (0.0, 0.7)
    )
    assert level[0][1] < level[1][1] - 50
    assert level[0][0] == pytest.approx(level[1][0], abs=2.0)
    assert tilted[0][0] < tilted[1][0] - 50


def test_a_turn_about_the_pinch_is_clockwise_as_seen_from_the_first_finger() -> None:
    stage, start = untouched(scene())
    first = start.state.first
    angle = math.radians(25.0)
    turned = replace(first, rotation=rotation_by(np.array([0.0, 0.0, angle])) @ first.rotation)
    after = replace(start, state=replace(start.state, first=turned))
    here, there = (hue(draw_along(stage, each), UPPER).mean(axis=0) for each in (start, after))
    arm = 115.5 - here[0]  # of the light half, above the middle of the picture
    assert there[1] - here[1] == pytest.approx(arm * math.sin(angle), abs=0.1 * arm)
    assert 115.5 - there[0] == pytest.approx(arm * math.cos(angle), abs=0.1 * arm)


@pytest.fixture(scope="module")
def gripped() -> Sample:
    rig = Rig(scene(duration_s=0.3))
    rig.reset()
    for _ in range(8):
        rig.step(1.5)
    return rig.sample(1.5)


def test_a_traction_has_x_downwards_and_y_to_the_left(gripped: Sample, tmp_path: Path) -> None:
    def half(k: int, axis: int) -> Any:
        contact = gripped.pinch.fingers[k]
        side = contact.field.position[:, axis] > 0.5e-3
        return replace(contact, field=replace(contact.field, contact=contact.field.contact & side))

    with closing(PinchVideo(tmp_path / "video.mp4", scene())) as video:
        for axis, column, sign in ((0, 0, 1.0), (1, 1, -1.0)):
            now = replace(gripped.pinch, fingers=(half(0, axis), half(1, axis)))
            for picture in video._draw_tractions(replace(gripped, truth=Truth(now=now))):
                blue = np.argwhere(picture[..., 2].astype(int) - picture[..., 0] > 40)
                assert len(blue) > 20
                assert sign * (blue[:, column].mean() - 0.5 * SIDE) > 5.0


def test_a_camera_has_x_downwards_and_y_to_the_left() -> None:
    for place, seen in (((240, 500), (1, 0)), ((420, 320), (0, -1))):
        image = np.zeros((480, 640, 3), np.uint8)
        image[place[0] - 9 : place[0] + 9, place[1] - 9 : place[1] + 9] = 255
        middle = np.argwhere(_upright(image)[..., 0] > 128).mean(axis=0) - 0.5 * (SIDE - 1)
        assert np.sign(np.where(abs(middle) < 2.0, 0.0, middle)).tolist() == list(seen)


def pictures(path: Path) -> list[np.ndarray]:
    with av.open(str(path)) as video:
        return [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]


@pytest.mark.loops
def test_a_run_has_a_picture_of_each_instant_of_the_video(tmp_path: Path) -> None:
    for rate, duration, count in ((200.0, 0.1, 11), (60.0, 0.2, 13)):  # at most 100 a second
        run(scene(duration_s=duration, camera__rate_hz=rate), tmp_path, overwrite=True)
        shown = pictures(tmp_path / "tactile.mp4")
        assert len(shown) == count
        assert shown[0].shape == (HEIGHT, WIDTH, 3)


def test_the_scale_of_pressure_starts_high_and_never_falls(gripped: Sample) -> None:
    field, mu = gripped.pinch.fingers[0].field, gripped.pinch.fingers[0].friction
    picture, tops = TractionPicture(scene().build_dome(), 200), []
    for times in (0.0, 1.0, 100.0, 1.0):
        picture.draw(replace(field, normal=times * field.normal), mu)
        tops.append(picture.top)
    assert tops[0] == tops[1] == FIRST_TOP < tops[2] == tops[3]
