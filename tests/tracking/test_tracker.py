import copy
import pickle
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import KDTree

from chromagrip.errors import UserError
from chromagrip.model import ContactObject, Fingertip, State, rest_state, step
from chromagrip.render import Frame, Membrane, MembraneMap, add_noise, load_sensor, open_renderer
from chromagrip.render.colour import decode_srgb, encode_srgb
from chromagrip.render.outlines import centroids, outlines
from chromagrip.tracking import MarkerTracker, Palette, Tracks
from chromagrip.tracking.fit.kernels.pair_kernels import mean_hues
from chromagrip.tracking.fit.settings import FitSettings
from chromagrip.tracking.fit.templates import forget
from chromagrip.tracking.fit.tracker import FULL, QUICK

SENSOR = load_sensor("thesis")
PALETTE = Palette.of_sensor(SENSOR)
PAINTER = open_renderer("painter", SENSOR)
TIP = Fingertip()
MAP = MembraneMap(SENSOR, TIP.nodes)
REST = MAP(np.zeros((TIP.nodes, 2)))
NOISE = 2.0
Image = NDArray[np.uint8]


def shoot(membrane: Membrane, index: int, noise: float = NOISE) -> Frame:
    image = PAINTER.render(membrane)
    add_noise(image, noise, 11, index)
    return Frame(image=image, time=0.01 * index)


def pressing(grip: float, load: float, frames: int) -> list[State]:
    """States 10 ms apart, loaded from the third on."""
    state, states = rest_state(TIP), []
    for k in range(frames):
        for _ in range(2):
            state = step(TIP, ContactObject(), state, 5e-3, grip, load if k > 2 else 0.0)
        states.append(state)
    return states


@cache
def at_rest(noise: float, settings: FitSettings) -> MarkerTracker:
    tracker = MarkerTracker(PALETTE, NOISE, settings)
    tracker.reset([shoot(REST, 2**31 + k, noise) for k in range(8)])
    return tracker


def fresh(noise: float = NOISE, settings: FitSettings = FULL) -> MarkerTracker:
    """A tracker of its own, reset to the rest frames."""
    return copy.deepcopy(at_rest(noise, settings))


def image_centres(membrane: Membrane) -> np.ndarray:
    """Where the middle of each marker's image is [px], shape (2, M, 2)."""
    return centroids(outlines(membrane, SENSOR.view), square=False)


def numbers(tracks: Tracks) -> np.ndarray:
    """Which marker of the design each tracked pair is, by its place at rest."""
    return np.asarray(KDTree(image_centres(REST)[0]).query(tracks.position[0])[1])


def test_rest_frame_shows_every_marker_once() -> None:
    tracks = fresh().rest
    assert sorted(numbers(tracks)) == list(range(400))
    truth = image_centres(REST)[:, numbers(tracks)]
    assert np.sqrt(((tracks.position - truth) ** 2).mean()) < 0.005


def test_displacements_are_as_good_as_their_covariance() -> None:
    """Unbiased, near the limit, and honest: normalised squared error of 1."""
    tracker = fresh()
    order = numbers(tracker.rest)
    rest = image_centres(REST)[:, order]
    for k, state in enumerate(pressing(3.0, 0.65, 30)):
        membrane = MAP(state.deformation.seen)
        tracks = tracker.update(shoot(membrane, k))
    truth = image_centres(membrane)[:, order] - rest
    assert np.abs(truth).max() > 4.0  # something happened
    assert tracks.visible.mean() > 0.99
    seen = tracks.visible.all(axis=0)
    error = (tracks.position - tracker.rest.position - truth)[:, seen]
    # One disc alone cannot do better than σ/A·sqrt(2s/(√π R)) ≈ 0.0065 px per frame.
    assert 0.006 < np.sqrt((error**2).mean()) < 0.010
    assert np.abs(error.mean(axis=1)).max() < 0.003
    variance = (tracks.covariance + tracker.rest.covariance)[seen]
    for layer in (0, 1):
        block = variance[:, 3 * layer : 3 * layer + 2, 3 * layer : 3 * layer + 2]
        squared = np.einsum("mi,mij,mj->m", error[layer], np.linalg.inv(block), error[layer])
        assert 0.8 < squared.mean() / 2 < 1.3


def test_a_frozen_image_freezes_the_tracks() -> None:
    tracker = fresh()
    frame = shoot(MAP(pressing(2.0, 0.5, 5)[-1].deformation.seen), 3)
    for _ in range(4):
        tracks = tracker.update(frame)
    again = tracker.update(frame)
    np.testing.assert_allclose(again.position, tracks.position, atol=2e-3)


def test_hue_is_measured_when_it_is_first_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes its time, and no force is read from it."""
    calls = []

    def hues(image: Image, shapes: np.ndarray, fits: np.ndarray) -> np.ndarray:
        calls.append(image)
        return mean_hues(image, shapes, fits)

    tracker = fresh()
    monkeypatch.setattr("chromagrip.tracking.fit.pair_fit.mean_hues", hues)
    tracks = tracker.update(shoot(REST, 0))
    assert not calls
    hue = tracks.hue
    assert len(calls) == 1
    assert tracks.hue is hue
    np.testing.assert_allclose(np.nanmedian(hue), np.nanmedian(tracker.rest.hue), atol=0.5)


def test_copied_tracks_hold_their_hue_and_no_image() -> None:
    tracks = fresh().update(shoot(REST, 0))
    data = pickle.dumps(tracks)
    assert len(data) < 400_000  # the image alone has 921,600 bytes
    np.testing.assert_array_equal(pickle.loads(data).hue, tracks.hue)


@pytest.mark.parametrize(
    ("frames", "words"),
    [
        ([], "at least one rest frame"),
        ([np.full((480, 640, 3), 240, np.uint8)], "image is grey.*need a colour image"),
        ([np.zeros((480, 640, 3), np.uint8)], "image is grey"),
        ([np.full((100, 100, 3), 240, np.uint8)], r"shape \(100, 100, 3\).*\(480, 640, 3\)"),
    ],
)
def test_bad_rest_frames_are_refused(frames: list[np.ndarray], words: str) -> None:
    with pytest.raises(UserError, match=words):
        MarkerTracker(PALETTE, NOISE).reset([Frame(image=image, time=0.0) for image in frames])


def sheared(pitches: float) -> np.ndarray:
    """Node displacements whose apex moves by so many pitches of 0.98 mm, the rim held."""
    angle = np.clip(TIP.angles() / 1.48, -1.0, 1.0)
    return np.cos(0.5 * np.pi * angle)[:, None] ** 2 * [0.98e-3 * pitches, -0.3e-3]


def squeezed(share: float) -> np.ndarray:
    """Node displacements that press the apex together: the skin there is shorter by this share."""
    half = np.radians(20.0)
    length = SENSOR.skin.radius_mm * 1e-3 * half
    angle = np.clip(TIP.angles() / half, -1.0, 1.0)
    along = -share * length / np.pi * np.sin(np.pi * angle)
    return np.stack([along, np.zeros_like(along)], axis=1)


def test_skin_pressed_together_is_followed() -> None:
    """Markers that touch are not bent by each other, and neighbours that differ are not torn."""
    tracker = fresh()
    order = numbers(tracker.rest)
    frames = np.minimum(np.linspace(0.05, 0.65, 13), 0.5)
    errors = []
    for k, share in enumerate(frames):
        membrane = MAP(squeezed(share))
        tracks = tracker.update(shoot(membrane, k))
        assert tracks.visible.all()
        if k >= 10:
            errors.append(tracks.position - image_centres(membrane)[:, order])
    moved = np.linalg.norm(image_centres(membrane) - image_centres(REST), axis=-1)
    apart = KDTree(image_centres(membrane)[0]).query(image_centres(membrane)[0], k=2)[0][:, 1]
    assert moved.max() > 8.0
    assert apart.min() < 8.0  # of a diameter of 9.6 px
    assert not tracks.ambiguous.any()
    touching = (apart < 9.0)[order]
    assert touching.sum() >= 3
    # Shade whose two dyes were blurred each on its own would draw them by 0.05 px.
    assert np.sqrt(np.mean(np.square(errors)[:, :, touching])) < 0.015


def test_markers_on_each_other_are_ambiguous() -> None:
    tracker = fresh()
    assert not tracker.rest.ambiguous.any()
    order = numbers(tracker.rest)
    centre = REST.centres[0, 0]
    other = int(KDTree(REST.centres[0]).query(centre, k=2)[1][1])
    for k, share in enumerate(np.linspace(0.1, 0.8, 8)):
        centres = REST.centres.copy()
        centres[:, 0] += share * (REST.centres[:, other] - REST.centres[:, 0])
        tracks = tracker.update(shoot(Membrane(centres=centres, axes=REST.axes), k))
    doubtful = order[tracks.ambiguous.any(axis=0) | ~tracks.visible.all(axis=0)]
    assert set(doubtful) == {0, other}


def without(membrane: Membrane, share: float, seed: int) -> Membrane:
    """Some markers of each layer gone."""
    centres = membrane.centres.copy()
    for layer in range(2):
        order = np.random.default_rng([seed, layer]).permutation(len(centres[layer]))
        centres[layer, order[: round(share * len(order))]] = np.nan
    return Membrane(centres=centres, axes=membrane.axes)


def test_identity_survives_a_jump_past_the_pitch() -> None:
    """From rest by 1.2 pitch, back through 2.4 to the other side, a twentieth of them gone.

    Every local method takes a marker for its neighbour from half a pitch on.
    """
    tracker = fresh()
    order = numbers(tracker.rest)
    for k, pitches in enumerate((1.2, 0.0, -1.2, 0.0)):
        membrane = without(MAP(sheared(pitches)), 0.05, seed=3)
        tracks = tracker.update(shoot(membrane, k))
        there = np.isfinite(membrane.centres[:, order, 0])
        truth = image_centres(membrane)[:, order]
        apart = np.linalg.norm(tracks.position - truth, axis=-1)
        assert np.nanmax(apart) < 0.5  # a twentieth of a pitch: no number is another's
        assert not tracks.visible[~there].any()
        assert np.isnan(tracks.position[~there]).all()
        assert tracks.visible[there].mean() > 0.98
        assert not tracks.ambiguous[tracks.visible].any()


def test_what_is_gone_says_since_when() -> None:
    tracker = fresh()
    whole, torn = MAP(sheared(0.05)), without(MAP(sheared(0.1)), 0.1, seed=5)
    tracker.update(shoot(whole, 1))
    order = numbers(tracker.rest)
    gone = np.isnan(torn.centres[:, order, 0])
    for k in (2, 3):
        tracks = tracker.update(shoot(torn, k))
    np.testing.assert_allclose(tracks.last_seen[gone], 0.01)
    np.testing.assert_allclose(tracks.last_seen[~gone & tracks.visible], 0.03)
    # Of a pair whose one marker is gone, the other is still followed.
    half = gone.any(axis=0) & ~gone.all(axis=0)
    assert half.sum() > 40
    assert tracks.visible[:, half][~gone[:, half]].mean() > 0.95
    tracks = tracker.update(shoot(whole, 4))
    assert tracks.visible.all()


def ramp(image: Image, k: int) -> Image:
    """Light that falls to 0.6 all over, and to half of that again across the image."""
    across = np.linspace(1.0, 1.0 - 0.025 * k, image.shape[1])[None, :, None]
    return dimmed(image, (1.0 - 0.02 * k) * across)


def shadow(image: Image, k: int) -> Image:
    """Three tenths less light in a band with edges of about 20 px, which wanders."""
    x = np.arange(image.shape[1]) - 150.0 - 15.0 * k
    band = 1.0 / (1.0 + np.exp(-x / 5.0)) - 1.0 / (1.0 + np.exp(-(x - 150.0) / 5.0))
    return dimmed(image, 1.0 - 0.3 * band[None, :, None])


def halved(image: Image, k: int) -> Image:
    """Half the contrast, in levels."""
    return np.rint(128.0 + (image - 128.0) / 2.0).astype(np.uint8)


def dimmed(image: Image, light: float | np.ndarray) -> Image:
    return np.rint(encode_srgb(decode_srgb(image.astype(float)) * light)).astype(np.uint8)


@pytest.mark.parametrize(("change", "worse"), [(ramp, 2.0), (shadow, 2.0), (halved, 4.0)])
def test_light_and_contrast_drop_out(change: Callable[[Image, int], Image], worse: float) -> None:
    """Nothing is lost; errors grow as the contrast falls, no more than twice beyond that."""
    assert error_under(change) < worse * error_under(unchanged)


def unchanged(image: Image, k: int) -> Image:
    return image


@cache
def error_under(change: Callable[[Image, int], Image]) -> float:
    """Error of places in a press whose pictures are changed, none of them lost [px]."""
    tracker = fresh()
    order = numbers(tracker.rest)
    errors = []
    for k, state in enumerate(pressing(2.0, 0.5, 20)):
        membrane = MAP(state.deformation.seen)
        image = change(PAINTER.render(membrane), k)
        add_noise(image, NOISE, 11, k)
        tracks = tracker.update(Frame(image=image, time=0.01 * k))
        errors.append(tracks.position - image_centres(membrane)[:, order])
        assert tracks.visible.all()
    return float(np.sqrt(np.mean(np.square(errors))))


def displaced(image: Image, shift: float) -> Image:
    """Picture shifted by linear interpolation, which blurs it."""
    matrix = np.array([[1.0, 0.0, shift], [0.0, 1.0, 0.6 * shift]])
    size = image.shape[1::-1]
    return np.asarray(cv2.warpAffine(image, matrix, size, borderMode=cv2.BORDER_REPLICATE))


@pytest.mark.parametrize(
    "shift", [0.25, 0.5, *(pytest.param(k, marks=pytest.mark.stages) for k in (0.2, 0.3))]
)
def test_a_picture_that_was_blurred_before_shows_no_change_at_rest(shift: float) -> None:
    """Light is fitted at rest where it would be fitted later: sizes would change by 2 %."""
    frames = [shoot(REST, 2**31 + k) for k in range(8)] + [shoot(REST, k) for k in range(8)]
    blurred = [replace(frame, image=displaced(frame.image, shift)) for frame in frames]
    tracker = MarkerTracker(PALETTE, NOISE)
    tracker.reset(blurred[:8])
    for frame in blurred[8:]:
        tracks = tracker.update(frame)
        assert abs(np.nanmean(tracks.log_size, axis=1)).max() < 1e-3
        assert np.nanmedian(abs(tracks.position - tracker.rest.position)) < 0.02


def test_a_yellow_that_the_palette_does_not_know_is_learned() -> None:
    """A tenth more of the green than the palette says: raw, that draws magenta by 0.3 px."""
    known = PALETTE.transmittance * [[1.0, 1.0, 1.0], [1.0, 1.0 / 0.9, 1.0]]
    tracker = MarkerTracker(Palette(names=PALETTE.names, transmittance=known), NOISE)
    tracker.reset([shoot(REST, 2**31 + k) for k in range(8)])
    order = numbers(tracker.rest)
    for k in range(20):
        centres = REST.centres.copy()
        centres[0, :, 0] += 0.16e-3 * min(k / 8, 1.0)  # 3 px in the end
        moved = Membrane(centres=centres, axes=REST.axes)
        tracks = tracker.update(shoot(moved, k))
    near = SENSOR.places[order, 0] < 1.0
    truth = image_centres(moved)[:, order]
    assert np.abs(truth - image_centres(REST)[:, order])[0, near, 0].mean() > 2.8
    bias = np.nanmean((tracks.position - truth)[:, near], axis=1)
    # 0.011 px are left on average of 12 noises, 0.0133 px of one.
    assert np.abs(bias).max() < 0.015


def test_a_ground_that_falls_off_at_the_rim_does_not_change_the_colours() -> None:
    """Colours that a few rim pairs spoil draw a marker off the one beneath it, by 2 % here."""
    sensor = load_sensor("dome-2020")
    painter, palette = open_renderer("painter", sensor), Palette.of_sensor(sensor)
    rest = MembraneMap(sensor, TIP.nodes)(np.zeros((TIP.nodes, 2)))

    def taken(membrane: Membrane, index: int) -> Frame:
        image = painter.render(membrane)
        add_noise(image, NOISE, 5, index)
        return Frame(image=image, time=0.01 * index)

    def centres_of(membrane: Membrane) -> np.ndarray:
        return centroids(outlines(membrane, sensor.view), square=False)

    tracker = MarkerTracker(palette, NOISE)
    tracker.reset([taken(rest, 2**31 + k) for k in range(8)])
    for k in range(12):
        centres = rest.centres.copy()
        centres[0, :, 0] += 0.3e-3 * min(k / 6, 1.0)
        moved = Membrane(centres=centres, axes=rest.axes)
        tracks = tracker.update(taken(moved, k))
    at_rest = centres_of(rest)
    order = KDTree(at_rest[1]).query(np.nan_to_num(tracker.rest.position[1]))[1]
    truth = (centres_of(moved) - at_rest)[0, order, 0]
    shift = (tracks.position - tracker.rest.position)[0, :, 0]
    inner = (sensor.places[order, 0] < 0.8) & tracks.visible[0]
    assert np.median(truth[inner]) > 1.5
    assert np.median(shift[inner] / truth[inner]) == pytest.approx(1.0, abs=4e-3)


def test_errors_do_not_add_up() -> None:
    tracker = fresh()
    order = numbers(tracker.rest)
    rms = []
    for k in range(120):
        membrane = MAP(sheared(0.2 * np.sin(0.2 * k)))
        error = tracker.update(shoot(membrane, k)).position - image_centres(membrane)[:, order]
        rms.append(np.sqrt(np.mean(error**2)))
    assert np.mean(rms[-20:]) == pytest.approx(np.mean(rms[:20]), rel=0.1)


def anew(tracker: MarkerTracker, frame: Frame) -> Tracks:
    """Tracks of a frame, every pair fitted without a template."""
    other = copy.copy(tracker)
    state = tracker.state
    forget(state.templates)
    other.state = state
    return other.update(frame)


def test_templates_say_what_the_fit_says() -> None:
    """Skin that creeps, holds still and jumps: each frame once more without any template."""
    tracker = fresh()
    way = np.concatenate([np.linspace(0.0, 0.05, 20), np.full(5, 0.05), [0.2, 0.2, 0.21]])
    order = numbers(tracker.rest)
    apart, errors = [], []
    for k, shift in enumerate(way):
        membrane = MAP(sheared(shift))
        frame = shoot(membrane, k)
        fitted, tracks = anew(tracker, frame), tracker.update(frame)
        apart.append(tracks.position - fitted.position)
        errors.append(fitted.position - image_centres(membrane)[:, order])
        assert np.std(tracks.log_size - fitted.log_size) < 0.2 * np.std(fitted.log_size)
        spread, known = (np.diagonal(t.covariance, axis1=1, axis2=2) for t in (tracks, fitted))
        assert np.median(spread / known) == pytest.approx(1.0, abs=0.04)
    # The noise is the same in both: what is left is far below it.
    assert np.std(apart) < 0.2 * np.std(errors)
    assert abs(np.mean(apart)) < 1e-4


def test_a_layer_that_is_not_there_stays_where_it_is_at_rest() -> None:
    """Half of a pair: the light on it is counted from the middle of both layers."""
    centres = REST.centres.copy()
    gone = np.flatnonzero(SENSOR.places[:, 0] < 0.6)[::7]
    centres[1, gone] = np.nan
    tracker = MarkerTracker(Palette.of_sensor(SENSOR), 2.0)
    tracker.reset([shoot(Membrane(centres=centres, axes=REST.axes), 0)])
    before = tracker.state.start
    absent = ~before.present
    assert absent.sum() == len(gone)
    for k in range(5):
        moved = centres + np.array([1e-5 * k, 0.0, 0.0])
        tracks = tracker.update(shoot(Membrane(centres=moved, axes=REST.axes), k))
    after = tracker.state.start
    assert tracks.visible[before.present.T].all()
    assert (abs(after.fits - before.fits)[before.present][:, 0] > 0.3).mean() > 0.9
    np.testing.assert_array_equal(after.fits[absent], before.fits[absent])


def test_few_templates_are_made_while_the_skin_holds_still() -> None:
    tracker = fresh()
    made = []
    for k in range(6):
        before = tracker.state.templates
        tracker.update(shoot(REST, k))
        after = tracker.state.templates
        made.append((after.fits != before.fits).any(axis=(1, 2)).mean())
    assert made[0] == 1.0
    assert max(made[2:]) < 0.02


def test_templates_follow_the_light() -> None:
    """Light that fades evenly, and then to one side, with markers that hold still."""
    tracker = fresh()
    picture = decode_srgb(open_renderer("painter", SENSOR).render(REST).astype(float))
    across = np.linspace(-1.0, 1.0, picture.shape[1])[None, :, None]
    for k in range(16):
        light = 1.0 - 0.01 * k + 0.01 * max(k - 8, 0) * across
        image = np.rint(encode_srgb(picture * light)).astype(np.uint8)
        add_noise(image, 2.0, 5, k)
        tracks = tracker.update(Frame(image=image, time=0.01 * k))
    assert tracks.visible.all()
    error = tracks.position - tracker.rest.position
    assert abs(error.mean(axis=1)).max() < 2e-3
    assert error.std() < 1.3 * 0.0077


def test_templates_see_neighbours_that_move() -> None:
    """Half of the markers pass by the others, which hold still."""
    tracker = fresh()
    order = numbers(tracker.rest)
    moving = SENSOR.places[:, 1] > 0.0
    for k in range(40):
        centres = REST.centres.copy()
        centres[:, moving, 0] += 4e-6 * k
        membrane = Membrane(centres=centres, axes=REST.axes)
        tracks = tracker.update(shoot(membrane, k))
    error = (tracks.position - image_centres(membrane)[:, order])[:, ~moving[order]]
    near = np.linalg.norm(tracks.position[0] - 239.5, axis=1)[~moving[order]] < 200.0
    assert error[:, near].std() < 1.3 * 0.0077


def test_less_effort_costs_less_than_twice_the_error() -> None:
    """Half of the rows, shapes as at rest: √2 of the error, and a little."""
    rms = {}
    for settings in (FULL, QUICK):
        tracker = fresh(settings=settings)
        order = numbers(tracker.rest)
        errors = []
        for k, state in enumerate(pressing(2.0, 0.5, 20)):
            membrane = MAP(state.deformation.seen)
            tracks = tracker.update(shoot(membrane, k))
            errors.append(tracks.position - image_centres(membrane)[:, order])
        rms[settings] = np.sqrt(np.mean(np.square(errors)))
    assert 1.3 < rms[QUICK] / rms[FULL] < 1.8
