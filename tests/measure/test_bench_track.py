"""The score of trackers: its limit, its truth, its counts, and where identity is lost."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from chromagrip.errors import UserError
from chromagrip.measure.bench import track as bench_track
from chromagrip.measure.engine import measure
from chromagrip.measure.limits.kernels import fisher_information
from chromagrip.measure.limits.positions import bounds, position_limits
from chromagrip.measure.study import Asked
from chromagrip.measure.worlds.track_motion import contact_motion, motion, pitch
from chromagrip.measure.worlds.track_scenes import SCENES, Conditions, Sequence, sequence
from chromagrip.measure.worlds.track_scores import (
    UNITS,
    WITHIN,
    Constant,
    Followed,
    follow,
    numbers,
    scores,
)
from chromagrip.output.report import Bounds, Table
from chromagrip.render import Frame, load_sensor
from chromagrip.render.colour import decode_srgb, encode_srgb
from chromagrip.render.drawing.coverage import edge_width
from chromagrip.render.ground import ground_image
from chromagrip.render.membrane import rest_membrane
from chromagrip.render.outlines import centroids, outlines
from chromagrip.tracking import Tracks

SENSOR = load_sensor("thesis")
BLUR = SENSOR.camera.blur_px


# ---- the limit ----


def discs(*centres: tuple[float, float], radius: float) -> np.ndarray:
    shapes = np.full((len(centres), 3, 2), np.nan)
    shapes[:, 0] = centres
    shapes[:, 1:] = radius * np.eye(2)
    return shapes


def information(shapes: np.ndarray, absorbed: np.ndarray, ground: np.ndarray) -> np.ndarray:
    inverses = np.linalg.inv(np.swapaxes(shapes[:, :, 1:], -1, -2))
    return fisher_information(shapes, inverses, edge_width(BLUR), absorbed, ground, 1.0)


def test_limit_of_one_disc_in_one_channel_is_the_known_one() -> None:
    """σ/A·√(2s/(√π R)), for a disc so faint that its edge keeps its shape in grey levels."""
    nothing = np.full((1, 3, 2), np.nan)
    absorbed = np.array([[0.0, 0.02, 0.0], [0.0, 0.0, 0.0]])
    contrast = float(encode_srgb(0.5) - encode_srgb(0.5 * 0.98))
    for radius in (5.0, 8.0):
        shapes = np.stack([discs((20.3, 19.8), radius=radius), nothing])
        found = bounds(information(shapes, absorbed, np.full((40, 42, 3), 0.5)), 2.0)
        known = 2.0 / contrast * np.sqrt(2 * edge_width(BLUR) / (np.sqrt(np.pi) * radius))
        assert found[0, 0] == pytest.approx(known, rel=0.03)
        assert np.isnan(found[1]).all()


def brute_levels(centres: np.ndarray, radius: float, ground: np.ndarray) -> np.ndarray:
    """Grey levels of pairs (M, 2, 2) of discs: every pixel sampled 16 × 16 times, then blurred."""
    fine, size = 16, ground.shape[0]
    y, x = (np.mgrid[: size * fine, : size * fine] + 0.5) / fine - 0.5
    light = np.ones((size * fine, size * fine, 3))
    for pair in centres:
        for layer, (cx, cy) in enumerate(pair):
            inside = (x - cx) ** 2 + (y - cy) ** 2 < radius**2
            light[inside] *= SENSOR.transmittance[layer]
    light = np.asarray(cv2.GaussianBlur(light, (0, 0), BLUR * fine))
    seen = light.reshape(size, fine, size, fine, 3).mean(axis=(1, 3))
    return encode_srgb(ground * seen)


@pytest.mark.parametrize("apart", [(0.0, 0.0), (3.0, 1.0), (7.0, -2.0)])
def test_limit_of_overlapping_pairs_is_that_of_brute_force(apart: tuple[float, float]) -> None:
    """Also with a neighbour whose blurred edge meets the outer marker's."""
    radius, step = 4.8, 1 / 16
    ground = np.broadcast_to(decode_srgb(np.array([250.0, 249.0, 248.0])), (32, 32, 3))
    outer, neighbour = np.array([15.2, 16.1]), np.array([5.0, 14.0])
    centres = np.array([[outer, outer + apart], [neighbour, neighbour]])
    slopes = []
    for layer, axis in ((0, 0), (0, 1), (1, 0), (1, 1)):
        levels = []
        for sign in (1, -1):
            moved = centres.copy()
            moved[0, layer, axis] += sign * step
            levels.append(brute_levels(moved, radius, ground))
        slopes.append(((levels[0] - levels[1]) / (2 * step)).ravel())
    brute = bounds((np.array(slopes) @ np.array(slopes).T)[None], 2.0)
    shapes = np.stack([discs(*map(tuple, centres[:, k]), radius=radius) for k in (0, 1)])
    found = bounds(information(shapes, 1.0 - SENSOR.transmittance, ground.copy()), 2.0)
    np.testing.assert_allclose(found[:, 0], brute[:, 0], rtol=0.05)


def test_limit_goes_with_noise_and_contrast() -> None:
    membrane = rest_membrane(SENSOR)
    ground = ground_image(SENSOR).astype(float)
    base = position_limits(SENSOR, membrane, ground, 2.0)
    assert 0.004 < np.median(base) < 0.008  # three channels beat the 0.0065 px of one
    np.testing.assert_allclose(position_limits(SENSOR, membrane, ground, 6.0), 3.0 * base)
    np.testing.assert_allclose(
        position_limits(SENSOR, membrane, ground, 2.0, contrast=0.5), 2.0 * base
    )
    assert (position_limits(SENSOR, membrane, 0.6 * ground, 2.0) > base).all()
    assert (position_limits(SENSOR, membrane, ground, 2.0, defocus=1.0) > base).all()
    alone = membrane.centres.copy()
    alone[1] = np.nan
    lone = position_limits(SENSOR, replace(membrane, centres=alone), ground, 2.0)
    assert np.isnan(lone[1]).all()
    assert (lone[0] < base[0]).all()  # nothing else to tell it from, and more light


# ---- scenes ----


def test_the_same_scene_has_the_same_bytes() -> None:
    first, again = (sequence(SCENES["missing"], 2, limits=False) for _ in range(2))
    for one, two in zip(first.shots, again.shots, strict=True):
        np.testing.assert_array_equal(one.frame.image, two.frame.image)
        np.testing.assert_array_equal(one.hidden, two.hidden)
    assert not np.array_equal(first.rest[0].image, first.rest[1].image)
    absent, vanished = ~first.there, first.shots[0].hidden & first.there
    assert absent.sum(axis=1).tolist() == [20, 20]
    assert vanished.sum(axis=1).tolist() == [19, 19]


def test_light_contrast_and_patch_are_as_said() -> None:
    """In frames without noise, where nothing moves."""
    still = Conditions(text="", grasp=0.0, sway_px=0.0, noise=0.0)

    def last(conditions: Conditions) -> tuple[np.ndarray, Sequence]:
        seen = sequence(conditions, 4, limits=False)
        return seen.shots[-1].frame.image.astype(float), seen

    image, seen = last(still)
    np.testing.assert_array_equal(image, seen.rest[0].image)
    darker = decode_srgb(last(replace(still, light=0.6))[0])
    skin = image.min(axis=2) > 100
    assert np.median(darker[skin] / decode_srgb(image[skin])) == pytest.approx(0.6, abs=0.01)
    flat, _ = last(replace(still, contrast=0.5))
    np.testing.assert_allclose(flat, 128 + 0.5 * (image - 128), atol=0.51)
    shaded = decode_srgb(last(replace(still, shadow=0.3))[0]) / decode_srgb(image)
    assert np.nanmin(shaded[skin]) == pytest.approx(0.7, abs=0.03)
    covered, seen = last(replace(still, patch=True))
    shot = seen.shots[-1]
    at = np.rint(shot.centre).astype(int)
    grey = (covered[at[..., 1], at[..., 0]] == 128).all(axis=-1)
    assert grey[shot.hidden].all()
    assert shot.hidden.sum() > 8
    assert not grey[shot.visible].any()


def test_a_jump_is_as_long_as_it_says_and_leaves_the_rim() -> None:
    seen = sequence(Conditions(text="", grasp=0.0, sway_px=0.0, shift_pitch=1.2), 3, limits=False)
    path = np.stack([seen.centre, *(shot.centre for shot in seen.shots)])
    length = np.linalg.norm(np.diff(path, axis=0), axis=-1)
    apex = int(np.argmin(SENSOR.places[:, 0]))
    size = 1.2 * pitch(SENSOR)
    np.testing.assert_allclose(length[:, 0, apex], [0.0, size, size], rtol=0.02)
    np.testing.assert_allclose(length[:, 1, apex], 0.5 * length[:, 0, apex], rtol=0.02)
    rim = SENSOR.places[:, 0] > np.deg2rad(84.0)
    assert length[:, :, rim].max() < 0.1
    assert length.max() == pytest.approx(size, rel=0.02)


def test_a_drift_takes_the_rim_along_in_all_directions_in_small_steps() -> None:
    drift = SCENES["drift"]
    path = motion(
        SENSOR, None, 40, grasp=0.0, sway_px=0.0, shift_pitch=0.0, layer_shift_px=0.0,
        drift_pitch=drift.drift_pitch,
    )  # fmt: skip
    rest = rest_membrane(SENSOR)
    places = [centroids(outlines(one, SENSOR.view), square=False)[0] for one in [rest, *path]]
    away = (np.stack(places) - places[0]) / pitch(SENSOR)
    middle = np.linalg.norm(places[0] - np.median(places[0], axis=0), axis=1).argmin()
    assert np.linalg.norm(away[:, middle], axis=1).max() == pytest.approx(3.0, rel=0.05)
    assert np.nanmin(np.nanmax(np.linalg.norm(away, axis=2), axis=0)) > 0.5  # of all markers
    steps = np.diff(away, axis=0)
    assert np.nanmax(np.linalg.norm(steps, axis=2)) < 0.45
    around = np.sort(np.arctan2(*steps[:, middle].T))
    assert np.diff(around, append=around[0] + 2 * np.pi).max() < np.radians(30.0)
    # A turn takes the far sides of the field in opposite directions.
    left, right = places[0][:, 0].argmin(), places[0][:, 0].argmax()
    assert abs(away[10, right] - away[10, left]).max() > 0.5


def test_a_drift_is_followed_until_markers_go_over_the_rim() -> None:
    seen = sequence(SCENES["drift"], 12, limits=False)
    hidden = [int(shot.hidden.sum()) for shot in seen.shots]
    assert hidden[0] == 0
    assert hidden[-1] > 10
    found = scores(follow("fit", seen), seen)
    assert (found["swaps"], found["false"]) == (0.0, 0.0)
    assert found["right"] > 99.5
    assert scores(follow("constant", seen), seen)["right"] < 10.0


def test_who_is_not_told_of_crosstalk_is_not_told() -> None:
    told, untold = (
        sequence(SCENES[name], 1, limits=False) for name in ("crosstalk", "crosstalk-unknown")
    )
    np.testing.assert_array_equal(told.shots[0].frame.image, untold.shots[0].frame.image)
    assert told.palette.transmittance[1, 1] == pytest.approx(0.9)
    assert untold.palette.transmittance[1, 1] == pytest.approx(0.99)
    shift = (told.shots[0].centre - told.centre)[:, np.argmin(SENSOR.places[:, 0])]
    np.testing.assert_allclose(shift, [[3.0, 0.0], [0.0, 0.0]], atol=0.01)


# ---- scores ----


@pytest.fixture(scope="module")
def seen() -> Sequence:
    return sequence(SCENES["missing"], 4)


def truthful(seen: Sequence, *, error: np.ndarray | float = 0.0, order: np.ndarray) -> Followed:
    """What a tracker that knows the truth says, but for an error (F, 2, M, 2), in its own order."""

    def tracks(place: np.ndarray, visible: np.ndarray, k: int, spread: np.ndarray) -> Tracks:
        shot = seen.shots[max(k, 0)]
        covariance = np.full((place.shape[1], 6, 6), np.nan)
        for layer in (0, 1):
            for axis in (0, 1):
                covariance[:, 3 * layer + axis, 3 * layer : 3 * layer + 2] = 0.0
                covariance[:, 3 * layer + axis, 3 * layer + axis] = spread[layer, :, axis] ** 2
        size = -np.log1p((shot.height if k >= 0 else 0.0 * shot.height) / seen.distance)
        return Tracks(
            time=0.01 * k,
            position=np.where(visible[..., None], place, np.nan)[:, order],
            log_size=size[:, order],
            hue=(shot.hue + 2.0)[order],
            visible=visible[:, order],
            ambiguous=np.zeros_like(visible),
            last_seen=np.zeros(visible.shape),
            covariance=covariance[order],
        )

    count = len(seen.shots)
    errors = np.broadcast_to(error, (count, 2, len(order), 2))
    return Followed(
        rest=tracks(seen.centre, seen.there, -1, np.zeros((2, len(order), 2))),
        tracks=[
            tracks(shot.centre + errors[k], shot.visible, k, shot.limit)
            for k, shot in enumerate(seen.shots)
        ],
        times=[2.0] * count,
    )


def test_errors_as_large_as_the_limit_score_one(seen: Sequence) -> None:
    rng = np.random.default_rng(0)
    limit = np.stack([shot.limit for shot in seen.shots])
    order = rng.permutation(seen.there.shape[1])
    said = truthful(seen, error=limit * rng.standard_normal(limit.shape), order=order)
    found = scores(said, seen)
    assert set(found) == set(UNITS)
    for layer in ("magenta", "yellow"):
        assert found[f"{layer}_ratio"] == pytest.approx(1.0, abs=0.05)
        assert found[f"{layer}_nees"] == pytest.approx(1.0, abs=0.1)
        assert found[f"{layer}_bias"] < 0.001
    for score in ("swaps", "lost", "false", "ambiguous"):
        assert found[score] == 0.0
    assert found["right"] == found["occlusion"] == 100.0
    assert found["hue"] == pytest.approx(2.0)
    assert found["normal"] == pytest.approx(0.0, abs=1e-9)
    assert found["time"] == 2.0


def test_a_constant_error_is_a_bias_and_takes_its_share_of_points(seen: Sequence) -> None:
    order = np.arange(seen.there.shape[1])
    found = scores(truthful(seen, error=np.array([-0.24, 0.18]), order=order), seen)
    assert found["magenta_bias"] == pytest.approx(0.3)
    assert found["yellow_bias_x"] == pytest.approx(-0.24)
    assert found["magenta_p95"] == pytest.approx(0.3)
    assert found["yellow_rms"] == pytest.approx(0.3 / np.sqrt(2.0))
    share = 100.0 * np.mean(np.array(WITHIN) > 0.3)
    assert found["within"] == found["jaccard"] == pytest.approx(share)


def test_swaps_losses_and_inventions_are_counted(seen: Sequence) -> None:
    order = np.arange(seen.there.shape[1])
    said = truthful(seen, order=order)
    whole = seen.shots[2].visible.all(axis=0)
    a, b, c, d = np.flatnonzero(whole)[:4]
    last = said.tracks[2]
    last.position[:, [a, b]] = last.position[:, [b, a]]  # two pairs exchanged: four swaps
    last.visible[0, c] = False
    last.ambiguous[1, d] = True
    gone = np.flatnonzero(seen.shots[2].hidden[0] & seen.there[0])[0]
    last.visible[0, gone] = True
    last.position[0, gone] = seen.shots[2].centre[0, gone]
    found = scores(said, seen)
    assert (found["swaps"], found["lost"]) == (4.0, 1.0)
    assert (found["false"], found["ambiguous"]) == (1.0, 1.0)
    wrong = 6  # of all that are visible or have gone; those never there are not asked for
    asked = sum(int((s.visible | (s.hidden & seen.there)).sum()) for s in seen.shots)
    assert found["right"] == pytest.approx(100.0 * (1.0 - wrong / asked))


def test_a_number_that_nothing_had_at_rest_is_false(seen: Sequence) -> None:
    order = np.arange(seen.there.shape[1])
    said = truthful(seen, order=order)
    absent = np.flatnonzero(~seen.there[1])[0]
    said.rest.visible[1, absent] = True
    said.rest.position[1, absent] = (3.0, 3.0)
    for tracks in said.tracks:
        tracks.visible[1, absent] = True
        tracks.position[1, absent] = (3.0, 3.0)
    assert numbers(said.rest, seen)[1, absent] == -1
    assert scores(said, seen)["false"] == len(said.tracks)


def test_a_number_that_comes_late_is_lost_until_then(seen: Sequence) -> None:
    order = np.arange(seen.there.shape[1])
    said = truthful(seen, order=order)
    late = int(np.flatnonzero(seen.shots[0].visible[1])[7])
    for tracks in (said.rest, said.tracks[0], said.tracks[1]):
        tracks.visible[1, late] = False
    found = scores(said, seen)
    assert (found["lost"], found["false"], found["swaps"]) == (2.0, 0.0, 0.0)


def test_who_never_looks_is_told_from_a_tracker() -> None:
    seen = sequence(SCENES["sway"], 3)
    constant, fit = (scores(follow(name, seen), seen) for name in ("constant", "fit"))
    assert constant["right"] < 60.0
    assert constant["magenta_ratio"] > 50.0
    assert fit["right"] > 99.0
    for layer in ("magenta", "yellow"):
        assert 0.95 <= fit[f"{layer}_ratio"] <= 1.5  # below, the bound would be wrong


# ---- the commands ----

REFUSING = '''
"""Tracker of a user that refuses all frames."""
from chromagrip.errors import UserError
from chromagrip.measure.worlds.track_scores import Constant

class Refusing(Constant):
    def update(self, frame):
        raise UserError("this tracker does not like the frame")
'''


@pytest.fixture
def theirs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "users_trackers.py").write_text(REFUSING)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def _columns(table: Table, *names: str) -> Table:
    """The same table with some of its columns, behind the first."""
    places = [0, *map(table.header.index, names)]
    lines = tuple(tuple(line[place] for place in places) for line in table.lines)
    return Table(tuple(table.header[place] for place in places), lines)


def test_rows_of_a_bench_and_their_table(theirs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_track, "TARGETS", {("sway", "lost"): Bounds(0.0, 0.0)})
    monkeypatch.setattr(bench_track, "QUICK_FRAMES", 2)
    monkeypatch.setattr(bench_track, "QUICK_LONG", 2)
    monkeypatch.setattr(bench_track, "ROUND", 2)
    refusing = "users_trackers:Refusing"
    asked = Asked(quick=True, methods=("constant", refusing))
    report = measure("bench", "track", asked)
    json.dumps(report.as_json(), allow_nan=False)
    rows = {row.name: row for row in report.rows}
    refused = rows[f"sway/{refusing}/refused"]
    assert refused.note == "this tracker does not like the frame"
    assert (refused.value, refused.target, refused.met) == (None, None, None)
    assert rows["sway/constant/false"].value == 0.0
    drift = rows["long/constant/drift"].value
    assert drift is not None
    assert drift > 0.0
    assert rows[f"long/{refusing}/drift"].value is None
    assert rows[f"long/{refusing}/drift"].met is False
    assert report.notes[-1] == f"{refusing} refused sway: this tracker does not like the frame"
    table, pixels, lost, rate = (_columns(one, "constant", refusing) for one in report.tables)
    assert [one.header for one in (pixels, lost, rate)] == [table.header] * 3
    ((_, of_constant, of_refusing),) = pixels.lines
    assert float(of_constant) == pytest.approx(rows["sway/constant/magenta_rms"].value, rel=0.5)
    assert of_refusing == "–"
    assert table.header == ("scene", "constant", refusing)
    ((scene, constant, refusal),) = table.lines
    assert (scene, refusal) == ("sway", "refused")
    assert float(constant.split()[0]) > 1.0


def test_a_bug_of_a_tracker_is_not_taken_for_a_refusal(monkeypatch: pytest.MonkeyPatch) -> None:
    class Broken(Constant):
        def update(self, frame: Frame) -> Tracks:
            raise IndexError("a bug")

    monkeypatch.setattr(bench_track, "TARGETS", {("sway", "lost"): Bounds(0.0, 0.0)})
    monkeypatch.setattr(bench_track, "QUICK_FRAMES", 1)
    with pytest.raises(IndexError, match="a bug"):
        measure("bench", "track", Asked(quick=True, methods=(Broken,)))


def test_impossible_wishes_are_one_sentence() -> None:
    with pytest.raises(UserError, match="no tracker 'nobody'; there is"):
        measure("bench", "track", Asked(quick=True, methods=("nobody",)))
    with pytest.raises(UserError, match="bench track has no scene 'sea'; there is clean, "):
        measure("bench", "track", Asked(quick=True, only=("sea",)))


def test_a_scene_that_was_chosen_is_all_that_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_track, "QUICK_FRAMES", 2)
    told: list[str] = []
    asked = Asked(quick=True, methods=("constant",), only=("sway",))
    report = measure("bench", "track", asked, progress=told.append)
    assert {row.subject[0] for row in report.rows} <= {"sway", "speed", "limit"}
    assert told == ["scene sway: 1 of 1"]


def test_objects_on_the_dome_move_the_markers_as_they_say() -> None:
    """A twist turns what is near the apex; a rod that rolls presses from side to side."""
    sensor = load_sensor("thesis")
    rest = rest_membrane(sensor).centres[0]
    near = np.hypot(rest[:, 0], rest[:, 1]) < 0.8e-3
    far = np.hypot(rest[:, 0], rest[:, 1]) > 5e-3
    *_, end = contact_motion(sensor, None, 4, "twist")
    moved = (end.centres[0] - rest)[:, :2]
    arm = np.column_stack([-rest[:, 1], rest[:, 0]])
    turn = (moved * arm).sum(axis=1) / (arm**2).sum(axis=1)
    assert (np.degrees(turn[near]) > 5.0).all()
    assert (np.degrees(turn[near]) < 40.0).all()
    assert abs(np.degrees(turn[far])).max() < 1.0
    steps = list(contact_motion(sensor, None, 8, "roll"))
    pressed = [rest[np.argmin((one.centres[0] - rest)[:, 2]), 0] for one in steps]
    assert pressed[2] < -1e-3
    assert pressed[-1] > 1e-3
    assert (np.diff(pressed[2:]) >= 0.0).all()
