"""The fit on the thesis' pictures: its errors, colours, lost markers and templates."""

import copy
import pickle
from collections.abc import Iterable
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from scipy.spatial import KDTree

from chromagrip.render import Frame, Membrane, MembraneMap, load_sensor, open_renderer
from chromagrip.render.colour import decode_srgb, encode_srgb
from chromagrip.render.outlines import centroids, outlines
from chromagrip.tracking import MarkerTracker, Palette, Tracks, read_rest
from chromagrip.tracking.fit.relocate import Relocator
from chromagrip.tracking.fit.templates import forget

from .middle import (
    FIRM,
    LIGHT,
    NOISE,
    PAINTER,
    PALETTE,
    PLACES,
    REST,
    SENSOR,
    SIDE,
    THESIS,
    TIP,
    Image,
    carried,
    image_centres,
    moved,
    noisy,
    numbers,
    shoot,
)

WHOLE = Palette.of_sensor(THESIS)


@cache
def resting() -> list[Frame]:
    return [shoot(REST, 2**31 + k) for k in range(8)]


@cache
def at_rest() -> MarkerTracker:
    tracker = MarkerTracker(PALETTE, NOISE)
    tracker.reset(resting())
    return tracker


def fresh() -> MarkerTracker:
    """A tracker of its own, reset to the rest frames."""
    return copy.deepcopy(at_rest())


def followed(tracker: MarkerTracker, membranes: Iterable[Membrane]) -> tuple[Tracks, np.ndarray]:
    """Tracks of the last one's picture, and the errors of all places (K, 2, M, 2) [px]."""
    order, errors = numbers(tracker.rest), []
    for k, membrane in enumerate(membranes):
        tracks = tracker.update(shoot(membrane, k))
        errors.append(tracks.position - image_centres(membrane)[:, order])
    return tracks, np.array(errors)


def test_rest_frame_shows_every_marker_once() -> None:
    tracks = fresh().rest
    assert sorted(numbers(tracks)) == list(range(len(PLACES)))
    truth = image_centres(REST)[:, numbers(tracks)]
    assert np.sqrt(((tracks.position - truth) ** 2).mean()) < 0.005


def test_displacements_are_as_good_as_their_covariance() -> None:
    """Unbiased, near the limit, and honest: normalised squared error of 1."""
    tracker = fresh()
    rest = image_centres(REST)[:, numbers(tracker.rest)]
    tracks, errors = followed(tracker, [carried(k * FIRM) for k in np.linspace(0.1, 1.0, 10)])
    assert (
        np.abs(image_centres(carried(FIRM)) - image_centres(REST)).max() > 4.0
    )  # something happened
    assert tracks.visible.mean() > 0.99
    seen = tracks.visible.all(axis=0)
    error = (errors[-1] - (tracker.rest.position - rest))[:, seen]
    # One disc alone cannot do better than σ/A·sqrt(2s/(√π R)) ≈ 0.0065 px per frame.
    assert 0.006 < np.sqrt((error**2).mean()) < 0.010
    assert np.abs(error.mean(axis=1)).max() < 0.003
    variance = (tracks.covariance + tracker.rest.covariance)[seen]
    for layer in (0, 1):
        block = variance[:, 3 * layer : 3 * layer + 2, 3 * layer : 3 * layer + 2]
        squared = np.einsum("mi,mij,mj->m", error[layer], np.linalg.inv(block), error[layer])
        assert 0.8 < squared.mean() / 2 < 1.3


def test_hue_is_measured_when_it_is_first_read_and_copied_without_the_image() -> None:
    tracker = fresh()
    tracks = tracker.update(shoot(REST, 0))
    data = pickle.dumps(tracks)
    assert len(data) < 0.6 * 3 * SIDE**2  # the image alone has 235,200 bytes
    hue = tracks.hue
    assert tracks.hue is hue
    np.testing.assert_allclose(np.nanmedian(hue), np.nanmedian(tracker.rest.hue), atol=0.5)
    np.testing.assert_array_equal(pickle.loads(data).hue, hue)


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
    shares = np.minimum(np.linspace(0.05, 0.65, 13), 0.5)
    tracks, errors = followed(tracker, [carried(squeezed(share)) for share in shares])
    assert np.isfinite(errors).all()
    membrane = carried(squeezed(0.5))
    far = np.linalg.norm(image_centres(membrane) - image_centres(REST), axis=-1)
    apart = KDTree(image_centres(membrane)[0]).query(image_centres(membrane)[0], k=2)[0][:, 1]
    assert far.max() > 8.0
    assert apart.min() < 8.0  # of a diameter of 9.6 px
    assert not tracks.ambiguous.any()
    touching = (apart < 9.0)[numbers(tracker.rest)]
    assert touching.sum() >= 3
    # Shade whose two dyes were blurred each on its own would draw them by 0.05 px.
    assert np.sqrt(np.mean(np.square(errors)[10:, :, touching])) < 0.015


def test_markers_on_each_other_are_ambiguous() -> None:
    tracker = fresh()
    assert not tracker.rest.ambiguous.any()
    order = numbers(tracker.rest)
    other = int(KDTree(REST.centres[0]).query(REST.centres[0, 0], k=2)[1][1])
    way = REST.centres[:, [other]] - REST.centres[:, [0]]
    first = np.array([0])
    tracks, _ = followed(tracker, [moved(k * way, of=first) for k in (0.2, 0.4, 0.6, 0.8)])
    doubtful = order[tracks.ambiguous.any(axis=0) | ~tracks.visible.all(axis=0)]
    assert set(doubtful) == {0, other}


def without(membrane: Membrane, share: float, seed: int) -> Membrane:
    """Some markers of each layer gone."""
    centres = membrane.centres.copy()
    for layer in range(2):
        order = np.random.default_rng([seed, layer]).permutation(len(centres[layer]))
        centres[layer, order[: round(share * len(order))]] = np.nan
    return Membrane(centres=centres, axes=membrane.axes)


def whole(seen: np.ndarray, index: int, lost: float = 0.0) -> tuple[Frame, np.ndarray]:
    """Picture of the whole sensor with a share of its markers gone, and where they are [px]."""
    membrane = without(MembraneMap(THESIS, TIP.nodes)(seen), lost, seed=3)
    frame = noisy(open_renderer("painter", THESIS).render(membrane), index)
    return frame, centroids(outlines(membrane, THESIS.view), square=False)


def test_identity_survives_a_jump_past_the_pitch() -> None:
    """From rest by 1.2 pitch, back through 2.4 to the other side, a twentieth of them gone.

    Every local method takes a marker for its neighbour from half a pitch on. Of a pair whose one
    marker is gone, the other is still followed.
    """
    tracker, (frame, start) = MarkerTracker(WHOLE, NOISE), whole(sheared(0.0), 9)
    order = KDTree(start[0]).query(tracker.reset([frame]).position[0])[1]
    for k, pitches in enumerate((1.2, -1.2)):
        frame, centres = whole(sheared(pitches), k, 0.05)
        tracks, truth = tracker.update(frame), centres[:, order]
        there = np.isfinite(truth[..., 0])
        apart = np.linalg.norm(tracks.position - truth, axis=-1)
        assert np.nanmax(apart) < 0.5  # a twentieth of a pitch: no number is another's
        assert not tracks.visible[~there].any()
        assert tracks.visible[there].mean() > 0.98
        half = there.any(axis=0) & ~there.all(axis=0)
        assert tracks.visible[:, half][there[:, half]].mean() > 0.95
        assert not tracks.ambiguous[tracks.visible].any()
    assert half.sum() > 20
    assert tracker.update(whole(sheared(0.0), 4)[0]).visible.all()


def ramp(image: Image, k: int) -> Image:
    """Light that falls to 0.6 all over, and to half of that again across the image."""
    across = np.linspace(1.0, 1.0 - 0.05 * k, image.shape[1])[None, :, None]
    return dimmed(image, (1.0 - 0.04 * k) * across)


def dimmed(image: Image, light: float | np.ndarray) -> Image:
    return np.rint(encode_srgb(decode_srgb(image.astype(float)) * light)).astype(np.uint8)


def test_light_drops_out() -> None:
    """Nothing is lost; errors grow no more than twice."""
    found = []
    for darker in (0, 1):
        tracker, errors = fresh(), []
        order = numbers(tracker.rest)
        for k in range(10):
            membrane = carried(0.1 * (k + 1) * LIGHT)
            tracks = tracker.update(noisy(ramp(PAINTER.render(membrane), darker * k), k))
            errors.append(tracks.position - image_centres(membrane)[:, order])
            assert tracks.visible.all()
        found.append(np.sqrt(np.mean(np.square(errors))))
    assert found[1] < 2.0 * found[0]


def test_a_picture_that_was_blurred_before_shows_no_change_at_rest() -> None:
    """Light is fitted at rest where it would be fitted later: sizes would change by 2 %."""
    matrix = np.array([[1.0, 0.0, 0.25], [0.0, 1.0, 0.15]])  # by interpolation, which blurs

    def displaced(frame: Frame) -> Frame:
        size = frame.image.shape[1::-1]
        image = cv2.warpAffine(frame.image, matrix, size, borderMode=cv2.BORDER_REPLICATE)
        return replace(frame, image=np.asarray(image))

    tracker = MarkerTracker(PALETTE, NOISE)
    tracker.reset([displaced(frame) for frame in resting()])
    for k in range(3):
        tracks = tracker.update(displaced(shoot(REST, k)))
        assert abs(np.nanmean(tracks.log_size, axis=1)).max() < 1e-3
        assert np.nanmedian(abs(tracks.position - tracker.rest.position)) < 0.02


def test_a_yellow_that_the_palette_does_not_know_is_learned() -> None:
    """A tenth more of the green than the palette says: raw, that draws magenta by 0.3 px."""
    known = PALETTE.transmittance * [[1.0, 1.0, 1.0], [1.0, 1.0 / 0.9, 1.0]]
    tracker = MarkerTracker(Palette(names=PALETTE.names, transmittance=known), NOISE)
    tracker.reset(resting())
    way = [[0.16e-3 * min(k / 8, 1.0), 0.0, 0.0] for k in range(12)]  # 3 px in the end
    _, errors = followed(tracker, [moved(np.array(by), layer=0) for by in way])
    bias = np.nanmean(errors[-1], axis=1)
    # Of the 400 markers of the whole sensor 0.011 px are left; a quarter of them tell less.
    assert np.abs(bias).max() < 0.05


@pytest.mark.stages
def test_a_ground_that_falls_off_at_the_rim_does_not_change_the_colours() -> None:
    """Colours that a few rim pairs spoil draw a marker off the one beneath it, by 2 % here."""
    sensor = load_sensor("dome-2020")
    painter, palette = open_renderer("painter", sensor), Palette.of_sensor(sensor)
    rest = MembraneMap(sensor, TIP.nodes)(np.zeros((TIP.nodes, 2)))

    def centres_of(membrane: Membrane) -> np.ndarray:
        return centroids(outlines(membrane, sensor.view), square=False)

    tracker = MarkerTracker(palette, NOISE)
    tracker.reset([noisy(painter.render(rest), 2**31 + k) for k in range(8)])
    for k in range(8):
        centres = rest.centres.copy()
        centres[0, :, 0] += 0.3e-3 * min(k / 5, 1.0)
        aside = Membrane(centres=centres, axes=rest.axes)
        tracks = tracker.update(noisy(painter.render(aside), k))
    at_rest = centres_of(rest)
    order = KDTree(at_rest[1]).query(np.nan_to_num(tracker.rest.position[1]))[1]
    truth = (centres_of(aside) - at_rest)[0, order, 0]
    shift = (tracks.position - tracker.rest.position)[0, :, 0]
    inner = (sensor.places[order, 0] < 0.8) & tracks.visible[0]
    assert np.median(truth[inner]) > 1.5
    assert np.median(shift[inner] / truth[inner]) == pytest.approx(1.0, abs=4e-3)


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
    way = [*np.linspace(0.0, 0.025, 10), 0.025, 0.025, 0.025, 0.2, 0.2, 0.21]
    order = numbers(tracker.rest)
    apart, errors = [], []
    for k, shift in enumerate(way):
        membrane = carried(sheared(shift))
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


def test_markers_are_relocated_however_far_they_went() -> None:
    """From rest in one step, and as light falls off to one side."""
    frame, start = whole(sheared(0.0), 9)
    rest = read_rest([frame], WHOLE)
    order = KDTree(start[0]).query(rest.position[0])[1]
    frame, centres = whole(sheared(2.0), 1)
    image = np.rint(frame.image * np.linspace(1.0, 0.6, 640)[:, None]).astype(np.uint8)
    located = Relocator(rest, WHOLE)(image)
    assert located.found.mean() > 0.99
    apart = np.linalg.norm(located.position - centres[:, order], axis=-1)
    assert apart[located.found].max() < 1.0
    assert np.median(located.gains[:, 1]) == pytest.approx(0.8**2.2, rel=0.05)


def test_few_templates_are_made_while_the_skin_holds_still_and_they_follow_the_light() -> None:
    """Light that fades evenly, and then to one side."""
    tracker = fresh()
    made = []
    for k in range(4):
        before = tracker.state.templates
        tracker.update(shoot(REST, k))
        made.append((tracker.state.templates.fits != before.fits).any(axis=(1, 2)).mean())
    assert made[0] == 1.0
    assert max(made[2:]) < 0.02
    picture = PAINTER.render(REST)
    across = np.linspace(-1.0, 1.0, picture.shape[1])[None, :, None]
    for k in range(8):
        light = 1.0 - 0.02 * k + 0.02 * max(k - 4, 0) * across
        tracks = tracker.update(noisy(dimmed(picture, light), k))
    assert tracks.visible.all()
    error = tracks.position - tracker.rest.position
    assert abs(error.mean(axis=1)).max() < 2e-3
    assert error.std() < 1.3 * 0.0077


def test_templates_see_neighbours_that_move() -> None:
    """Half of the markers pass by the others, which hold still."""
    tracker = fresh()
    passing = PLACES[:, 1] > 0.0
    of = np.flatnonzero(passing)
    way = [np.array([8e-6 * k, 0.0, 0.0]) for k in range(20)]
    _, errors = followed(tracker, [moved(by, of=of) for by in way])
    still = ~passing[numbers(tracker.rest)]
    assert errors[-1][:, still].std() < 1.3 * 0.0077
