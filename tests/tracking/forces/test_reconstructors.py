"""The chain's reconstructor against known forces: exact marker motion, no image between."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from chromagrip.errors import UserError
from chromagrip.model import (
    ContactObject,
    Fingertip,
    ForceField,
    contact_forces,
    rest_state,
    step,
)
from chromagrip.render import MembraneMap, load_sensor
from chromagrip.render.outlines import areas, centroids, outlines
from chromagrip.tracking import (
    NoEstimateError,
    SensorCalibration,
    Tracks,
    load_calibration,
    load_reconstructor,
)

SENSOR = load_sensor("thesis")
TIP = Fingertip()
KNOWN = load_calibration("thesis")
MAP = MembraneMap(SENSOR, TIP.nodes)
#: Noise of (x, y, log size) of magenta, then of yellow [px, px, 1].
NOISE = np.array([[0.0075, 0.0075, 0.00135], [0.006, 0.006, 0.00105]])


def tracks(seen: np.ndarray, rng: np.random.Generator | None = None) -> Tracks:
    """Where the membrane's own outlines are, with noise if given."""
    shapes = outlines(MAP(seen), SENSOR.view)
    size = 0.5 * np.log(areas(shapes, False))
    measured = np.concatenate([centroids(shapes, False), size[..., None]], axis=-1)
    if rng is not None:
        measured = measured + NOISE[:, None] * rng.standard_normal(measured.shape)
    layers, pairs = measured.shape[:2]
    return Tracks(
        time=0.0,
        position=measured[..., :2],
        log_size=measured[..., 2],
        hue=np.zeros(pairs),
        visible=np.ones((layers, pairs), dtype=bool),
        ambiguous=np.zeros((layers, pairs), dtype=bool),
        last_seen=np.zeros((layers, pairs)),
        covariance=np.tile(np.diag(NOISE.ravel() ** 2), (pairs, 1, 1)),
    )


UNLOADED = tracks(np.zeros((TIP.nodes, 2)))
REST = replace(UNLOADED, covariance=UNLOADED.covariance / 16)


def press(obj: ContactObject, grip: float, load: float) -> tuple[np.ndarray, ForceField]:
    """Displacements and true forces of a press that is loaded slowly, and held."""
    state = rest_state(TIP)
    for k in range(140):
        state = step(TIP, obj, state, 5e-3, grip, load * float(np.clip((k - 30) / 60, 0, 1)))
    return state.deformation.seen, contact_forces(TIP, obj, state)


@pytest.fixture(scope="module")
def sheared() -> tuple[np.ndarray, ForceField]:
    return press(ContactObject(stiffness=300.0, curvature=30.0), 1.6, 0.5)


@pytest.fixture(scope="module")
def held(sheared: tuple[np.ndarray, ForceField]) -> Tracks:
    return tracks(sheared[0])


def signed_friction(field: ForceField) -> float:
    return float(field.friction[field.contact].sum())


def read(seen_by: Tracks) -> ForceField:
    return load_reconstructor("sequential")(KNOWN, REST).update(seen_by)


def test_a_standing_press_is_read_from_a_single_frame(
    sheared: tuple[np.ndarray, ForceField], held: Tracks
) -> None:
    _, truth = sheared
    field = read(held)
    assert field.total_normal == pytest.approx(truth.total_normal, rel=0.05)
    assert signed_friction(field) == pytest.approx(signed_friction(truth), abs=0.06)


def test_mirrored_markers_give_mirrored_forces(
    sheared: tuple[np.ndarray, ForceField], held: Tracks
) -> None:
    there = read(held)
    back = read(tracks(sheared[0][::-1] * np.array([-1.0, 1.0])))
    assert signed_friction(back) == pytest.approx(-signed_friction(there), abs=0.02)
    assert back.total_normal == pytest.approx(there.total_normal, rel=0.02)


def test_too_few_markers_are_an_error_that_counts_them(held: Tracks) -> None:
    few = np.zeros_like(held.visible)
    few[:, np.argsort(SENSOR.places[:, 0])[:12]] = True
    with pytest.raises(NoEstimateError, match=r"^12 marker pairs visible .* at least \d+ are"):
        read(replace(held, visible=few))


def test_the_covariance_covers_the_scatter(sheared: tuple[np.ndarray, ForceField]) -> None:
    """Of noisy repeats about their own mean: the rest, a bias, is the model's and not noise."""
    seen, _ = sheared
    fields = [read(tracks(seen, np.random.default_rng(k))) for k in range(12)]
    totals = np.array([[f.total_normal, signed_friction(f)] for f in fields])
    stated = np.sqrt(np.mean([np.diag(f.totals_covariance) for f in fields], axis=0))
    ratio = totals.std(axis=0, ddof=1) / stated
    assert (ratio < 1.5).all()
    assert ratio[0] > 0.3


@pytest.mark.parametrize(
    ("obj", "grip", "load"),
    [
        (ContactObject(stiffness=80.0, curvature=200.0, friction=0.7), 1.35, 0.65),
        (ContactObject(stiffness=1000.0, friction=0.3), 3.1, -0.65),
        (ContactObject(stiffness=500.0, curvature=100.0, friction=0.8), 4.0, 1.0),
    ],
)
def test_any_load_is_reached_from_rest_in_one_frame(
    obj: ContactObject, grip: float, load: float
) -> None:
    """No frame between rest and the full load; µ is read where the skin slips."""
    seen, truth = press(obj, grip, load)
    field = read(tracks(seen, np.random.default_rng(0)))
    assert field.total_normal == pytest.approx(truth.total_normal, rel=0.10)
    assert signed_friction(field) == pytest.approx(signed_friction(truth), abs=0.05)
    reading = field.friction_reading
    assert reading is not None
    assert abs(reading.value - obj.friction) < 3.0 * reading.deviation


class Foreign:
    """One that somebody else wrote."""

    def __init__(self, calibration: SensorCalibration, rest: Tracks) -> None: ...

    def reset(self) -> None: ...

    def update(self, tracks: Tracks) -> ForceField: ...


def test_reconstructors_go_by_name() -> None:
    made: Callable[[SensorCalibration, Tracks], object] = load_reconstructor(f"{__name__}:Foreign")
    assert made is Foreign
    with pytest.raises(UserError, match="there is auto, sequential"):
        load_reconstructor("magic")
    with pytest.raises(UserError, match="has no reset"):
        load_reconstructor("collections:OrderedDict")
