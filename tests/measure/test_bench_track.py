"""The score of trackers: its limit, its truth, its counts, and where identity is lost."""

import json
from dataclasses import replace

import numpy as np
import pytest

from chromagrip.errors import UserError
from chromagrip.measure.bench import track as bench_track
from chromagrip.measure.engine import measure
from chromagrip.measure.study import Asked
from chromagrip.measure.worlds.track_motion import pitch
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
from chromagrip.output.report import Bounds
from chromagrip.render import Frame, load_sensor
from chromagrip.render.colour import decode_srgb
from chromagrip.tracking import Tracks

SENSOR = load_sensor("thesis")


# ---- scenes ----


def test_markers_are_missing_and_vanish_as_the_scene_says() -> None:
    seen = sequence(SCENES["missing"], 2, limits=False)
    assert not np.array_equal(seen.rest[0].image, seen.rest[1].image)
    absent, vanished = ~seen.there, seen.shots[0].hidden & seen.there
    assert absent.sum(axis=1).tolist() == [20, 20]
    assert vanished.sum(axis=1).tolist() == [19, 19]


def test_light_contrast_and_patch_are_as_said() -> None:
    """In frames without noise, where nothing moves."""
    still = Conditions(text="", grasp=0.0, sway_px=0.0, noise=0.0)

    def last(conditions: Conditions) -> tuple[np.ndarray, Sequence]:
        seen = sequence(conditions, 2, limits=False)
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


def test_numbers_that_nothing_had_at_rest_are_false_and_late_ones_are_lost(seen: Sequence) -> None:
    order = np.arange(seen.there.shape[1])
    said = truthful(seen, order=order)
    absent = np.flatnonzero(~seen.there[1])[0]
    late = int(np.flatnonzero(seen.shots[0].visible[1])[7])
    for tracks in (said.rest, *said.tracks):
        tracks.visible[1, absent] = True
        tracks.position[1, absent] = (3.0, 3.0)
    for tracks in (said.rest, said.tracks[0], said.tracks[1]):
        tracks.visible[1, late] = False
    assert numbers(said.rest, seen)[1, absent] == -1
    found = scores(said, seen)
    assert (found["lost"], found["false"], found["swaps"]) == (2.0, len(said.tracks), 0.0)


@pytest.mark.studies
def test_who_never_looks_is_told_from_a_tracker() -> None:
    seen = sequence(SCENES["sway"], 3)
    constant, fit = (scores(follow(name, seen), seen) for name in ("constant", "fit"))
    assert constant["right"] < 60.0
    assert constant["magenta_ratio"] > 50.0
    assert fit["right"] > 99.0
    for layer in ("magenta", "yellow"):
        assert 0.95 <= fit[f"{layer}_ratio"] <= 1.5  # below, the bound would be wrong


# ---- the commands ----


@pytest.mark.studies
def test_rows_of_a_bench_and_their_table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_track, "TARGETS", {("sway", "lost"): Bounds(0.0, 0.0)})
    for name in ("QUICK_FRAMES", "QUICK_LONG", "ROUND"):
        monkeypatch.setattr(bench_track, name, 2)

    class Refusing(Constant):
        def update(self, frame: Frame) -> Tracks:
            raise UserError("this tracker does not like the frame")

    report = measure("bench", "track", Asked(quick=True, methods=("constant", Refusing)), workers=1)
    json.dumps(report.as_json(), allow_nan=False)
    rows = {row.name: row for row in report.rows}
    refused = rows["sway/Refusing/refused"]
    assert refused.note == "this tracker does not like the frame"
    assert (refused.value, refused.target, refused.met) == (None, None, None)
    assert rows["sway/constant/false"].value == 0.0
    assert rows["long/constant/drift"].value > 0.0
    assert (rows["long/Refusing/drift"].value, rows["long/Refusing/drift"].met) == (None, False)
