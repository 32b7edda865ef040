"""The video of a pinch: what is where in its pictures, and how many there are."""

import json
import math
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

import chromagrip
from chromagrip import UserError, load_scene
from chromagrip.loop.pinch.course_plot import BAND, OTHER, SEEN, TRUTH, CoursePlot, Courses
from chromagrip.loop.pinch.stage import FINGER_COLOURS, Stage, draw_along, draw_side
from chromagrip.loop.pinch.stage import set_stage as stage_of
from chromagrip.loop.pinch.video import HEIGHT, SIDE, WIDTH, PinchVideo, _upright
from chromagrip.loop.pinch.world import Pinched
from chromagrip.loop.results.dome_picture import FIRST_TOP, TractionPicture
from chromagrip.loop.rig import Rig
from chromagrip.loop.run import run
from chromagrip.loop.run_files import FILES
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


def exact(picture: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """Pixels of a colour; (row, column) each."""
    return np.argwhere((picture == colour).all(axis=-1))


def test_what_is_lifted_moves_up_by_its_way() -> None:
    stage, start = untouched(scene())
    before, after = (hue(draw_side(stage, at(start, t)), UPPER) for t in (0.0, 0.7))
    way = 0.060 * math.cos(ABOVE) / stage.side.pixel
    assert way > 150.0
    assert before[:, 0].min() - after[:, 0].min() == pytest.approx(way, abs=1.01)
    assert before[:, 1].mean() == pytest.approx(after[:, 1].mean(), abs=1.0)


def test_the_first_finger_is_at_the_left_and_a_tilt_lowers_the_second() -> None:
    """The whole path is in the picture."""
    stage, start = untouched(scene(**TILTED))
    pictures = [draw_side(stage, at(start, time)) for time in (0.0, 0.4, 0.7)]
    for picture in pictures:
        edges = (picture[0], picture[-1], picture[:, 0], picture[:, -1])
        assert all((edge == 255).all() for edge in edges)
    level, tilted = (
        [hue(picture, each).mean(axis=0) for each in FINGER_COLOURS] for picture in pictures[::2]
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


def courses(**last: float) -> Courses:
    """Five frames with one margin and grip, the last of them as given."""
    made = Courses()
    made.times.extend(0.1 * k for k in range(5))
    values = {f"{name}_true": value for name, value in (("margin", 0.8), ("limit_margin", 0.5))}
    values |= {"margin_estimated": 0.7, "limit_margin_estimated": 0.4}
    values |= {"limit_margin_low": 0.3, "limit_margin_high": 0.6}
    for finger in made.margins:
        for name, value in values.items():
            finger[name].extend([value] * 4 + [last.get(name, value)])
    made.forces["grip_n"].extend([3.0] * 4 + [last.get("grip_n", 3.0)])
    made.forces["table_n"].extend([0.0] * 5)
    return made


def test_the_interval_is_drawn_from_end_to_end_and_no_further() -> None:
    plot = CoursePlot((1280, 224), 1.0, 0.1, "estimated")
    picture = plot.draw(courses())
    assert plot.panels[2].high == 5.0
    for panel in plot.panels[:2]:
        low, high = panel.pixels(np.full(2, 0.15), np.array([0.3, 0.6]))
        column = round(float(low[0]))
        rows = exact(picture[:, column : column + 1], BAND)[:, 0]
        assert (rows.min(), rows.max()) == pytest.approx((high[1], low[1]), abs=1.6)
        for value, colour in ((0.8, TRUTH), (0.7, SEEN), (0.5, TRUTH), (0.4, SEEN)):
            row = round(float(panel.pixels(np.zeros(1), np.array([value]))[0, 1]))
            near = picture[row - 1 : row + 2, column].astype(int)
            assert abs(near - colour).sum(axis=-1).min() < 120, value
        after = round(float(panel.pixels(np.array([0.6]), np.zeros(1))[0, 0]))
        assert not len(exact(picture[:, after : round(panel.right)], BAND))
        desired = round(float(panel.pixels(np.zeros(1), np.array([0.1]))[0, 1]))
        assert (exact(picture, OTHER)[:, 0] == desired).sum() > 100
    # What is not known is a gap, and the axis of force grows with the grip.
    unknown = {"limit_margin_low": math.nan, "limit_margin_high": math.nan}
    picture, panel = plot.draw(courses(grip_n=14.0, **unknown)), plot.panels[0]
    columns = exact(picture[:, : round(panel.right)], BAND)[:, 1]
    assert columns.max() == pytest.approx(panel.pixels(np.array([0.3]), np.zeros(1))[0, 0], abs=1.6)
    assert plot.panels[2].high == 20.0


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
        its = scene(duration_s=duration, camera__rate_hz=rate)
        trace = run(its, tmp_path, overwrite=True).trace
        shown = pictures(tmp_path / "tactile.mp4")
        assert len(shown) == count
        assert shown[0].shape == (HEIGHT, WIDTH, 3)
    # It changes nothing.
    assert run(its).trace["object_x_mm"].tobytes() == trace["object_x_mm"].tobytes()
    # The camera's picture is that of the rig, though the controller saw none.
    with closing(Rig(its)) as rig:
        rig.reset()
        camera = _upright(rig.pictures()[0].image).astype(int)
    drawn = shown[0][32 : 32 + SIDE, :SIDE].astype(int)
    assert abs(drawn - camera)[20:].mean() < 6.0


@pytest.mark.loops
def test_an_interrupted_run_keeps_its_video(tmp_path: Path) -> None:
    """And all else that a run leaves."""

    def stop(done: int, _: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(scene(), tmp_path, progress=stop)
    assert len(pictures(tmp_path / "tactile.mp4")) == 3
    assert {path.name for path in tmp_path.iterdir()} == set(FILES)
    written = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert (written["complete"], written["frames"]) == (False, 3)
    assert written["final_grip_n"] == 1.5
    assert load_scene(str(tmp_path / "scene.toml")) == scene()
    with pytest.raises(UserError, match="not empty"):
        run(scene(), tmp_path)


def test_the_scale_of_pressure_starts_high_and_never_falls(gripped: Sample) -> None:
    """A light touch is drawn by the scale of a firm grip, so that colours compare over time."""
    field, mu = gripped.pinch.fingers[0].field, gripped.pinch.fingers[0].friction
    picture = TractionPicture(scene().build_dome(), 200)
    tops = []
    for times in (0.0, 0.1, 1.0, 100.0, 1.0):
        picture.draw(replace(field, normal=times * field.normal), mu)
        tops.append(picture.top)
    assert tops[0] == tops[1] == tops[2] == FIRST_TOP
    assert tops[3] == tops[4] > FIRST_TOP


def test_a_missing_estimate_is_not_drawn_as_no_force(gripped: Sample, tmp_path: Path) -> None:
    silent = [
        replace(each, observation=replace(each.observation, no_estimate="imitated"))
        for each in gripped.readings
        if each.observation is not None
    ]
    with closing(PinchVideo(tmp_path / "video.mp4", scene())) as video:
        video._camera = True  # the readings are drawn, on the dome of the truth
        for readings, written in ((gripped.readings, False), (tuple(silent), True)):
            for picture in video._draw_tractions(replace(gripped, readings=readings)):
                line = picture[22:38, :100].astype(int)  # below the name
                assert ((line[..., 0] - line[..., 1]).max() > 100) == written
