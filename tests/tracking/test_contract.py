"""What every tracker keeps to, on the sensor's pictures and on dots drawn here."""

from contextlib import closing
from dataclasses import replace
from functools import cache
from importlib.metadata import EntryPoint
from typing import Any

import numpy as np
import pytest

from chromagrip.errors import UserError
from chromagrip.model import rest_state
from chromagrip.render import Frame, Membrane
from chromagrip.render.colour import decode_srgb
from chromagrip.scene.scene import load_scene
from chromagrip.sensing.sensor import open_camera
from chromagrip.tracking import (
    MarkerTracker,
    Palette,
    Tracker,
    Tracks,
    load_palette,
    load_tracker,
)
from chromagrip.tracking.baselines.centroid import WeightedCentroid
from chromagrip.tracking.fit.settings import FitSettings
from chromagrip.tracking.learned_palette import learn_palette
from chromagrip.tracking.sighting import sight
from chromagrip.tracking.trackers import TRACKERS

from ..pictures.drawn_dots import covered, levels
from .middle import (
    NOISE,
    PAINTER,
    PALETTE,
    REST,
    SIDE,
    image_centres,
    moved,
    numbers,
    shoot,
)

DARK = load_palette("dark-dots")
#: RMS error of a displacement per coordinate that each may have [px]. The limit for one disc is
#: 0.0092; known of one layer of discs: Lucas–Kanade 0.0116, mask centroids 0.088.
ALLOWED = {
    "fit": 0.0115,
    "quick": 0.016,
    # Edges of the other dye, which densities in log space do not quite divide out: 0.022 over the
    # whole sensor, whose rim is hardly pushed.
    "lk": 0.03,
    "centroid": 0.03,
    "detect": 0.0135,
    "chromatouch": 0.12,
}
NAMES = list(TRACKERS.entries)


@cache
def picture(outer: float, inner: float, index: int) -> Frame:
    """The layers of the sensor moved aside by so much [m]."""
    return shoot(pushed(outer, inner), index)


def pushed(outer: float, inner: float) -> Membrane:
    """Layers pushed aside by up to so much [m], smoothly, most in the middle."""
    centres = REST.centres.copy()
    x, y = centres[0, :, 0], centres[0, :, 1]
    share = np.exp(-(x**2 + y**2) / 5e-3**2)
    for layer, sideways in enumerate((outer, inner)):
        centres[layer, :, 0] += sideways * share
        centres[layer, :, 1] += 0.4 * sideways * share
    return Membrane(centres=centres, axes=REST.axes)


def slid(shift: float, layer: int = 0, axis: int = 0) -> Membrane:
    """One layer moved over the other, by so much [m]."""
    return moved(shift * np.eye(3)[axis], layer=layer)


@cache
def reset(name: str) -> tuple[Tracker, Tracks, Any]:
    tracker = load_tracker(name)(PALETTE, NOISE)
    rest = tracker.reset([picture(0.0, 0.0, 2**31 + k) for k in range(4)])
    return tracker, rest, tracker.state


@cache
def reset_to_dots(name: str, palette: str = "dark-dots") -> tuple[Tracker, Tracks, Any]:
    known = load_palette(palette)
    tracker = load_tracker(name)(known, NOISE)
    return (
        tracker,
        tracker.reset([dots((0.0, 0.0), 100 + k, known) for k in range(4)]),
        tracker.state,
    )


def fresh(name: str, on_dots: bool = False) -> tuple[Tracker, Tracks]:
    """A tracker as after its reset, which takes its time, and its tracks of the rest."""
    tracker, rest, tracker.state = (reset_to_dots if on_dots else reset)(name)
    return tracker, rest


def truth(rest: Tracks, membrane: Membrane) -> np.ndarray:
    """True displacement of each tracked number [px], shape (2, M, 2)."""
    return (image_centres(membrane) - image_centres(REST))[:, numbers(rest)]


def dots(shift: tuple[float, float], index: int, palette: Palette = DARK) -> Frame:
    """Blurred dots of a palette of one dye on a shaded ground, all shifted by that much [px]."""
    y, x = np.mgrid[:192, :216]
    light = (0.9 - 0.25 * (x / 216) - 0.2 * (y / 192) ** 2) * (0.1 if palette.bright else 1.0)
    places = 24.0 * np.stack(np.meshgrid(np.arange(2, 8), np.arange(2, 7)), -1).reshape(-1, 2)
    cover = covered((216, 192), places + shift, np.full(len(places), 5.5), 0.9)[..., None]
    image = light[..., None] * (1.0 - cover * (1.0 - palette.transmittance[0]))
    return Frame(image=levels(image, NOISE, 1000 + index), time=0.01 * index)


@pytest.mark.parametrize("name", NAMES)
def test_small_shifts_are_found_without_drift(name: str) -> None:
    """As good at the third frame as at the first."""
    tracker, rest = fresh(name)
    assert rest.visible.mean() > 0.97
    errors = []
    for k in range(0, 5, 2):
        way = (8e-5 * np.sin(0.6 * (k + 1)),) * 2
        tracks = tracker.update(picture(*way, k))
        assert tracks.visible.mean() > 0.97
        assert not tracks.ambiguous.any()
        np.testing.assert_array_equal(tracks.last_seen[tracks.visible], 0.01 * k)
        errors.append(tracks.position - rest.position - truth(rest, pushed(*way)))
    rms = np.sqrt(np.nanmean(np.square(errors), axis=(1, 2, 3)))
    assert rms.max() < ALLOWED[name]
    assert rms[-1] < 1.2 * rms[0]
    # One disc alone cannot do better than σ/A·sqrt(2s/(√π R)) ≈ 0.0065 px per frame.
    assert rms.min() > 0.0065


@pytest.mark.parametrize("name", NAMES)
def test_covered_markers_are_lost_and_found_again(name: str) -> None:
    """And of a blank frame, nothing is seen."""
    tracker, rest = fresh(name)
    x, y = rest.position[0].T
    hidden = (x > 116) & (y > 114) & (y < 166)
    assert hidden.sum() > 6
    for k in range(3):
        covered = k == 1
        image = picture(2e-5 * k, 2e-5 * k, 10 + k).image.copy()
        if covered:
            image[98:182, 100:] = 128  # a finger on the lens
        tracks = tracker.update(Frame(image=image, time=0.1 + 0.01 * k))
        certain = (tracks.visible & ~tracks.ambiguous)[:, hidden]
        assert certain.any() == (not covered)
        # Never a stale position, and the time of the last good one.
        np.testing.assert_array_equal(np.isnan(tracks.position).any(axis=-1), ~tracks.visible)
        last = tracks.last_seen[:, hidden]
        gone = ~tracks.visible[:, hidden]
        assert last[~gone] == pytest.approx(tracks.time)
        assert (last[gone] < tracks.time).all()
        if covered:
            assert gone.mean() > 0.8
            assert np.median(last) == 0.1
    assert tracks.visible[:, hidden].mean() > 0.95
    error = (tracks.position - rest.position - truth(rest, pushed(4e-5, 4e-5)))[:, hidden]
    assert np.nanmax(abs(error)) < 1.0
    blank = tracker.update(Frame(image=np.full((SIDE, SIDE, 3), 240, np.uint8), time=1.0))
    assert not blank.visible.any()
    assert np.isnan(blank.position).all()
    np.testing.assert_array_equal(blank.last_seen, tracks.last_seen)


@pytest.mark.parametrize("name", NAMES)
def test_a_state_goes_on_where_it_was_taken_and_a_picture_again_changes_nothing(name: str) -> None:
    frames = [dots((1.5 * k, -0.7 * k), k) for k in range(3)]
    tracker, _ = fresh(name, on_dots=True)
    tracker.update(frames[0])
    state = tracker.state
    expected = [tracker.update(frame) for frame in frames[1:]]
    # The same tracker, but anything it keeps beside its state has gone on meanwhile.
    tracker.state = state
    for frame, tracks in zip(frames[1:], expected, strict=True):
        again = tracker.update(frame)
        for field in ("position", "log_size", "hue", "visible", "last_seen", "covariance"):
            np.testing.assert_array_equal(getattr(again, field), getattr(tracks, field))
    for _ in range(3):
        again = tracker.update(frames[-1])
    np.testing.assert_allclose(tracker.update(frames[-1]).position, again.position, atol=2e-3)


@pytest.mark.parametrize("palette", ["dark-dots", "bright-pins"])
@pytest.mark.parametrize("name", NAMES)
def test_palettes_of_one_dye(name: str, palette: str) -> None:
    tracker, rest, tracker.state = reset_to_dots(name, palette)
    assert rest.position.shape[0] == 1
    tracks = tracker.update(dots((0.63, -0.37), 0, load_palette(palette)))
    assert tracks.visible.mean() > 0.97
    error = tracks.position - rest.position - np.array([0.63, -0.37])
    assert np.nanmedian(abs(error)) < ALLOWED[name]
    assert np.nanmax(abs(error)) < 0.5
    assert tracks.covariance.shape == (rest.position.shape[1], 3, 3)


@pytest.mark.parametrize("name", NAMES)
def test_half_a_pitch_between_frames_is_the_end(name: str) -> None:
    """Right at 0.3 pitch, wrong past half of one: a regular grid looks as if it went back."""
    for share, right in ((0.3, True), (0.7, False)):
        tracker, rest = fresh(name, on_dots=True)
        tracks = tracker.update(dots((24.0 * share, 0.0), 0))
        x = rest.position[..., 0]
        inner = (x > 66) & (x < 150)
        error = (tracks.position - rest.position)[inner, 0] - 24.0 * share
        assert (np.mean(abs(error) < 1.0) > 0.9) == right


@pytest.mark.parametrize("name", NAMES)
def test_frames_that_cannot_be_used_are_refused(name: str) -> None:
    tracker, _ = fresh(name, on_dots=True)
    for image in (np.zeros((100, 100, 3), np.uint8), np.zeros((192, 216, 3), np.float32)):
        with pytest.raises(UserError, match=r"shape .* type .*, the rest frame had \(192, 216, 3"):
            tracker.update(Frame(image=image, time=0.0))  # type: ignore[arg-type]
    for images, words in (
        ([], "at least one rest frame"),
        ([np.full((SIDE, SIDE, 3), 240, np.uint8)], "image is grey.*need a colour image"),
    ):
        with pytest.raises(UserError, match=words):
            load_tracker(name)(PALETTE, NOISE).reset([Frame(image=i, time=0.0) for i in images])


@cache
def worn() -> tuple[list[Frame], Palette]:
    """A dome whose spots nearly all show both dyes on each other, and its palette as it is seen."""
    changes = {
        "sensor": "dome-2020-printed", "seed": 677, "defects.worn_markers": 0.107,
        "camera.noise_levels": 1.0,
    }  # fmt: skip
    scene = load_scene("camera-100hz", changes)
    with closing(open_camera(scene)) as camera:
        frames = camera.expose_rest(rest_state(scene.build_fingertip()), 1)
    return frames, learn_palette(frames[0].image, sight(frames[0].image))


@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.stages) for name in NAMES])
def test_a_worn_dome_whose_colours_are_learned_is_followed_and_with_others_refused(
    name: str,
) -> None:
    frames, palette = worn()
    # The dyes are not one: only yellow lets red and green through.
    assert palette.transmittance[1, 1] > 4.0 * palette.transmittance[0, 1]
    assert load_tracker(name)(palette, 1.0).reset(frames).visible[0].sum() > 60
    # Two dyes of nearly one colour seem to cover less than nothing of some spots.
    alike = np.array([[0.63, 0.11, 0.03], [0.64, 0.12, 0.03]])
    with pytest.raises(UserError, match="markers"):
        load_tracker(name)(replace(palette, transmittance=alike), 1.0).reset(frames)


@pytest.mark.parametrize(("name", "within"), [("fit", 5e-4), ("quick", 5e-4), ("detect", 2e-3)])
def test_sizes_tell_of_the_distance(name: str, within: float) -> None:
    """A membrane nearer by 2 % looks 2 % larger."""
    tracker, rest = fresh(name)
    tracks = tracker.update(shoot(Membrane(centres=0.98 * REST.centres, axes=REST.axes), 0))
    grown = np.nanmean(tracks.log_size - rest.log_size, axis=1)
    assert grown == pytest.approx(-np.log(0.98), abs=within)


def test_detected_markers_do_not_mind_less_light() -> None:
    """A step to 0.6 of the light: noise weighs more by less than 2, and nothing is lost."""
    tracker, rest = fresh("detect")
    aside = pushed(4e-5, 4e-5)
    image = levels(0.6 * decode_srgb(PAINTER.render(aside).astype(float)), NOISE, 3)
    tracks = tracker.update(Frame(image=image, time=0.0))
    assert tracks.visible.all()
    error = tracks.position - rest.position - truth(rest, aside)
    assert np.sqrt((error**2).mean()) < 2 * 0.0092


def test_layers_pull_on_each_other_only_where_colours_are_not_unmixed() -> None:
    """The outer layer slides by 3 px over the other: centroids stay, masks are dragged along."""
    bias = {}
    frames = [shoot(slid(shift), 0) for shift in (0.05e-3, 0.10e-3, 0.16e-3)]
    for name in ("fit", "quick", "detect", "chromatouch"):
        tracker, rest = fresh(name)
        for frame in frames:
            tracks = tracker.update(frame)
        true = truth(rest, slid(0.16e-3))
        error = tracks.position - rest.position - true
        middle = np.linalg.norm(rest.position[0] - SIDE / 2, axis=1) < 100
        assert abs(true[0, middle, 0]).min() > 1.5
        bias[name] = abs(np.nanmean(error[:, middle], axis=1))
    assert max(bias[name].max() for name in ("fit", "quick", "detect")) < 0.02
    assert bias["chromatouch"].max() > 0.05


@pytest.mark.parametrize("name", ["fit", "chromatouch"])
def test_hue_turns_from_overlap_towards_magenta(name: str) -> None:
    tracker, rest = fresh(name)
    start = np.nanmedian(rest.hue)
    assert start == pytest.approx(18.0, abs=8.0)  # of a real dome's overlaps
    for shift in (0.1e-3, 0.2e-3, 0.3e-3):
        tracks = tracker.update(shoot(slid(shift, layer=1, axis=1), 0))
    assert np.nanmedian(tracks.hue) < start - 10.0


def test_the_covariance_of_centroids_is_that_of_the_noise() -> None:
    """The scatter of places over frames of one scene, and NaN for the sizes and a lost marker."""
    tracker, rest = fresh("centroid", on_dots=True)
    places = [tracker.update(dots((0.0, 0.0), k)).position for k in range(40)]
    told = np.diagonal(rest.covariance, axis1=1, axis2=2)[rest.visible[0]]
    scatter = np.var(places, axis=0, ddof=1)[0, rest.visible[0]]
    assert scatter.mean() / told[:, :2].mean() == pytest.approx(1.0, abs=0.25)
    assert np.isnan(told[:, 2]).all()
    frame = dots((0.0, 0.0), 0)
    frame.image[:, :90] = 200
    covariance = tracker.update(frame).covariance
    lost = rest.position[0, :, 0] < 80
    assert np.isnan(covariance[lost]).all()
    assert np.isfinite(covariance[~lost, 0, 0]).any()


def test_two_numbers_on_one_blob_are_ambiguous() -> None:
    """With every other column wiped out, the masks' nearest neighbours are claimed twice."""
    tracker, rest = fresh("chromatouch", on_dots=True)
    frame = dots((11.0, 0.0), 0)
    frame.image[:, :130] = dots((11.0, 0.0), 0).image[:, 12:13]
    tracks = tracker.update(frame)
    assert tracks.ambiguous[tracks.visible].all()
    assert not rest.ambiguous.any()


def test_trackers_go_by_name_by_entry_point_and_with_arguments(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    target = "chromagrip.tracking.baselines.centroid:WeightedCentroid"
    assert load_tracker("fit") is MarkerTracker
    assert load_tracker(target) is WeightedCentroid
    coarse = load_tracker("fit", {"settings": FitSettings(rows=3)})(PALETTE, NOISE)
    assert isinstance(coarse, MarkerTracker)
    assert coarse.settings == FitSettings(rows=3)
    mine = {"chromagrip.trackers": [EntryPoint("mine", target, "chromagrip.trackers")]}
    monkeypatch.setattr("chromagrip.by_name.entry_points", lambda group: mine[group])
    assert load_tracker("mine") is WeightedCentroid
    for name, words in (
        ("best", "no tracker 'best'; there is mine, fit.* or give module:Class"),
        ("nowhere:Tracker", "there is no module nowhere in the working folder"),
        ("json:JSONDecoder", "has no reset"),
    ):
        with pytest.raises(UserError, match=words):
            load_tracker(name)
    pale = Palette(names=("a", "b"), transmittance=np.array([[0.8, 0.9, 0.9], [0.9, 0.9, 0.8]]))
    with pytest.raises(UserError, match="a and b must be darker than the ground and saturated"):
        load_tracker("chromatouch")(pale, NOISE)
