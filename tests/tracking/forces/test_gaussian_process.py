from functools import lru_cache

import numpy as np
import pytest

from chromagrip.model import ContactObject, Fingertip, ForceField, contact_forces, rest_state, step
from chromagrip.render import Frame, MembraneMap, add_noise, load_sensor, open_renderer
from chromagrip.render.outlines import centroids, outlines
from chromagrip.tracking import (
    GaussianProcess,
    MarkerTracker,
    NoEstimateError,
    Palette,
    SensorCalibration,
    Tracks,
)
from chromagrip.tracking.forces.chain.sensitivity import MarkerResponse
from chromagrip.tracking.forces.chain.settings import GaussianProcessSettings, ObjectSettings

SENSOR = load_sensor("thesis")
PAINTER = open_renderer("painter", SENSOR)
TIP = Fingertip()
KNOWN = SensorCalibration(sensor=SENSOR, fingertip=TIP)
MAP = MembraneMap(SENSOR, TIP.nodes)


def shoot(seen: np.ndarray, index: int) -> Frame:
    image = PAINTER.render(MAP(seen))
    add_noise(image, 2.0, 21, index)
    return Frame(image=image, time=0.01 * index)


@pytest.fixture(scope="module")
def tracker() -> MarkerTracker:
    tracker = MarkerTracker(Palette.of_sensor(SENSOR), 2.0)
    tracker.reset([shoot(np.zeros((TIP.nodes, 2)), 2**31 + k) for k in range(16)])
    return tracker


Seen = tuple[ForceField, ForceField, Tracks]


def watch(
    tracker: MarkerTracker, obj: ContactObject, grip: float, load: float, frames: int = 60
) -> list[Seen]:
    """(estimate, truth, tracks) of a press that is loaded after 50 ms, from images.

    Each press is followed once; shorter ones are its beginning.
    """
    return list(whole_press(tracker, obj, grip, load)[:frames])


def test_the_largest_misfit_and_the_object_are_settings(tracker: MarkerTracker) -> None:
    tracker.reset([shoot(np.zeros((TIP.nodes, 2)), 2**31 + k) for k in range(4)])
    state = rest_state(TIP)
    for _ in range(10):
        state = step(TIP, ContactObject(), state, 2e-3, 1.86, 0.0)
    tracks = tracker.update(shoot(state.deformation.seen, 0))

    def totals(settings: GaussianProcessSettings) -> np.ndarray:
        field = GaussianProcess(KNOWN, tracker.rest, settings=settings).update(tracks)
        return np.array(field.totals_covariance)

    usual = totals(GaussianProcessSettings())
    unsure = totals(GaussianProcessSettings(contact=ObjectSettings(common=0.3)))
    assert unsure[0, 0] > 2.0 * usual[0, 0]
    with pytest.raises(NoEstimateError, match="no deformation of the fingertip"):
        totals(GaussianProcessSettings(misfit=1e-3))


@lru_cache
def whole_press(
    tracker: MarkerTracker, obj: ContactObject, grip: float, load: float
) -> tuple[Seen, ...]:
    frames = 60
    tracker.reset([shoot(np.zeros((TIP.nodes, 2)), 2**31 + k) for k in range(16)])
    estimator = GaussianProcess(KNOWN, tracker.rest)
    state, seen = rest_state(TIP), []
    for k in range(frames):
        for _ in range(5):
            state = step(TIP, obj, state, 2e-3, grip, load if k >= 5 else 0.0)
        tracks = tracker.update(shoot(state.deformation.seen, k))
        seen.append((estimator.update(tracks), contact_forces(TIP, obj, state), tracks))
    return tuple(seen)


@pytest.mark.parametrize(
    ("obj", "grip", "load"),
    [
        (ContactObject(), 1.86, 0.65),
        pytest.param(ContactObject(friction=0.7), 1.33, -0.65, marks=pytest.mark.slow),
        # A soft round object lets the skin sink in: its normal is not the skin's.
        (ContactObject(stiffness=160.0, curvature=50.0, friction=0.3), 3.1, 0.65),
    ],
)
def test_forces_come_out_of_the_image(
    tracker: MarkerTracker, obj: ContactObject, grip: float, load: float
) -> None:
    """Object and command are unknown to the estimator; 0.2 s are averaged."""
    late = watch(tracker, obj, grip, load)[-20:]
    normal = np.mean([e.total_normal / t.total_normal for e, t, _ in late])
    friction = np.mean([e.total_friction - t.total_friction for e, t, _ in late])
    assert normal == pytest.approx(1.0, abs=0.05)
    assert friction == pytest.approx(0.0, abs=0.02)
    estimate = late[-1][0]
    assert np.sign(estimate.friction[estimate.contact].sum()) == np.sign(load)


def test_estimate_scatters_as_much_as_it_says(tracker: MarkerTracker) -> None:
    late = watch(tracker, ContactObject(), 1.86, 0.65)[-25:]
    scatter = np.std([e.total_normal - t.total_normal for e, t, _ in late])
    stated = np.mean([np.sqrt(e.totals_covariance[0, 0]) for e, _, _ in late])
    assert 0.3 * stated < scatter < 3.0 * stated


def test_an_unloaded_sensor_shows_no_force(tracker: MarkerTracker) -> None:
    unloaded = np.zeros((TIP.nodes, 2))
    tracker.reset([shoot(unloaded, 2**31 + k) for k in range(16)])
    estimator = GaussianProcess(KNOWN, tracker.rest)
    for k in range(5):
        field = estimator.update(tracker.update(shoot(unloaded, k)))
    assert abs(field.normal.sum()) < 0.1
    assert abs(field.friction.sum()) < 0.05


def test_the_same_frame_gives_the_same_force(tracker: MarkerTracker) -> None:
    """A frozen image freezes the estimate, however long it is looked at."""
    _, _, tracks = watch(tracker, ContactObject(), 1.86, 0.65, frames=30)[-1]
    estimator = GaussianProcess(KNOWN, tracker.rest)
    totals = [estimator.update(tracks).total_normal for _ in range(40)]
    assert np.ptp(totals[-10:]) < 0.002 * totals[-1]


def test_too_few_markers_is_an_error_that_counts_them(tracker: MarkerTracker) -> None:
    _, _, tracks = watch(tracker, ContactObject(), 1.86, 0.65, frames=9)[-1]
    blind = np.zeros_like(tracks.visible)
    blind[:, :5] = True
    estimator = GaussianProcess(KNOWN, tracker.rest)
    with pytest.raises(NoEstimateError, match="at least 20 are needed"):
        estimator.update(
            Tracks(**{**vars(tracks), "visible": blind, "position": tracks.position.copy()})
        )


def test_nonsense_is_refused_and_forgotten(tracker: MarkerTracker) -> None:
    """Markers thrown about say nothing; the frames after them are read as if it had not been."""
    seen = watch(tracker, ContactObject(), 1.86, 0.65, frames=30)
    estimator = GaussianProcess(KNOWN, tracker.rest)
    good = seen[-1][2]
    thrown = good.position + np.random.default_rng(0).normal(0, 60.0, good.position.shape)
    nonsense = Tracks(**{**vars(good), "position": thrown})
    with pytest.raises(NoEstimateError):  # noqa: PT012 - at the latest when linearised anew
        for _ in range(5):
            estimator.update(nonsense)
    for _, _, tracks in seen:
        field = estimator.update(tracks)
    truth = seen[-1][1]
    assert field.total_normal == pytest.approx(truth.total_normal, rel=0.2)


def test_lost_markers_widen_the_interval(tracker: MarkerTracker) -> None:
    seen = watch(tracker, ContactObject(), 1.86, 0.65, frames=30)

    def deviation(hidden_deg: float) -> float:
        estimator = GaussianProcess(KNOWN, tracker.rest)
        # From frame to frame, as a camera sees it: with its middle hidden, the loaded frame alone
        # is too far from rest.
        places = np.stack([SENSOR.places_at(p, k) for k, p in enumerate(tracker.rest.position)])
        for _, _, tracks in seen:
            visible = tracks.visible & (places[:, :, 0] > np.deg2rad(hidden_deg))
            field = estimator.update(Tracks(**{**vars(tracks), "visible": visible}))
        return float(np.sqrt(field.totals_covariance[0, 0]))

    assert deviation(10.0) > 1.3 * deviation(0.0)


def test_response_is_the_derivative_of_the_prediction() -> None:
    places = np.stack([SENSOR.places[::7]] * 2)
    response = MarkerResponse(SENSOR, places, TIP.nodes)
    waves = np.stack([np.sin(k * (TIP.angles() + np.pi / 2)) for k in range(1, 6)], axis=1)
    rng = np.random.default_rng(8)
    seen = 1e-4 * waves @ rng.standard_normal((5, 2))
    case = 1e-4 * waves @ rng.standard_normal((5, 2))
    _, derivative = response(seen, case[:, :, None])
    none = np.empty((TIP.nodes, 2, 0))
    h = 1e-3
    slope = (response(seen + h * case, none)[0] - response(seen - h * case, none)[0]) / (2 * h)
    scale = np.abs(slope).max(axis=0)
    np.testing.assert_allclose(derivative[:, :, 0] / scale, slope / scale, atol=1e-5)


def test_prediction_is_what_the_renderer_was_given() -> None:
    """The estimator's forward model against the membrane: same pixels, same tilt of the discs."""
    places = np.stack([SENSOR.places] * 2)
    response = MarkerResponse(SENSOR, places, TIP.nodes)
    obj, state = ContactObject(), rest_state(TIP)
    for _ in range(40):
        state = step(TIP, obj, state, 5e-3, 3.0, 0.6)
    predicted, _ = response(state.deformation.seen, np.empty((TIP.nodes, 2, 0)))
    membrane = MAP(state.deformation.seen)
    view = SENSOR.view
    for layer in (0, 1):
        pixels = view.project(membrane.centres[layer])
        np.testing.assert_allclose(predicted[:, 3 * layer : 3 * layer + 2], pixels, atol=1e-9)
        shapes = view.jacobian(membrane.centres[layer]) @ membrane.axes[layer]
        whole = predicted + response.perspective(state.deformation.seen)
        middle = centroids(outlines(membrane, view), square=False)[layer]
        np.testing.assert_allclose(whole[:, 3 * layer : 3 * layer + 2], middle, atol=1e-5)
        area = np.linalg.det(shapes) / SENSOR.half_sizes[layer] ** 2
        np.testing.assert_allclose(predicted[:, 3 * layer + 2], 0.5 * np.log(area), atol=1e-9)
