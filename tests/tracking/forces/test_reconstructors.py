"""Every reconstructor against forces that are known: exact marker motion, no image between."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from chromagrip.errors import UserError
from chromagrip.model import (
    ContactObject,
    Fingertip,
    ForceField,
    chain_compliance,
    chain_forces,
    contact_forces,
    rest_state,
    step,
)
from chromagrip.render import MembraneMap, load_sensor
from chromagrip.render.outlines import areas, centroids, outlines
from chromagrip.tracking import (
    FRICTION,
    NoEstimateError,
    SensorCalibration,
    Tracks,
    load_reconstructor,
)

SENSOR = load_sensor("thesis")
TIP = Fingertip()
KNOWN = SensorCalibration(sensor=SENSOR, fingertip=TIP)
MAP = MembraneMap(SENSOR, TIP.nodes)
#: Noise of (x, y, log size) of magenta, then of yellow [px, px, 1].
NOISE = np.array([[0.0075, 0.0075, 0.00135], [0.006, 0.006, 0.00105]])
#: How far ΣFn of a standing press may be off without noise: what each method's own model costs.
OURS = {"gp": 0.03}


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


def read(name: str, seen_by: Tracks, calibration: SensorCalibration = KNOWN) -> ForceField:
    return load_reconstructor(name)(calibration, REST).update(seen_by)


@pytest.mark.parametrize("name", OURS)
def test_a_standing_press_is_read_from_a_single_frame(
    name: str, sheared: tuple[np.ndarray, ForceField], held: Tracks
) -> None:
    _, truth = sheared
    field = read(name, held)
    assert field.total_normal == pytest.approx(truth.total_normal, rel=OURS[name])
    assert signed_friction(field) == pytest.approx(signed_friction(truth), abs=0.06)
    assert field.spread is not None
    assert field.spread.shape[0] == 2 * TIP.nodes
    rows = field.spread.reshape(2, TIP.nodes, -1)[:, field.contact].sum(axis=1)
    np.testing.assert_allclose(field.totals_covariance, rows @ rows.T, rtol=1e-9)


#: A smooth bump of force, pressing and shearing, of the size 1 at its middle.
BUMP = np.exp(-0.5 * (TIP.angles() * TIP.radius / 1.5e-3) ** 2)[:, None] * np.array([0.3, -1.0])


def test_smooth_forces_come_back_node_by_node() -> None:
    """u solves K(u)·u = f by Newton; what is read is f, whichever way its normal is taken."""
    forces, seen = 0.025 * BUMP, np.zeros((TIP.nodes, 2))
    for _ in range(40):
        missing = forces - chain_forces(TIP, seen)
        seen = seen + 0.5 * chain_compliance(TIP, seen, missing[:, :, None], 0.05)[:, :, 0]
    np.testing.assert_allclose(chain_forces(TIP, seen)[1:-1], forces[1:-1], atol=1e-6)
    field = read("gp", tracks(seen))
    size, truth = np.hypot(field.normal, field.friction), np.hypot(*forces.T)
    assert size.sum() == pytest.approx(truth.sum(), rel=0.05)
    assert abs(size - truth).max() < 0.15 * truth.max()


@pytest.mark.parametrize("name", OURS)
def test_mirrored_markers_give_mirrored_forces(
    name: str, sheared: tuple[np.ndarray, ForceField], held: Tracks
) -> None:
    there = read(name, held)
    back = read(name, tracks(sheared[0][::-1] * np.array([-1.0, 1.0])))
    assert signed_friction(back) == pytest.approx(-signed_friction(there), abs=0.02)
    assert back.total_normal == pytest.approx(there.total_normal, rel=0.02)


@pytest.mark.parametrize("name", OURS)
def test_a_stiffer_fingertip_of_the_same_shape_pushes_harder(name: str, held: Tracks) -> None:
    """Both stiffnesses times s: the same displacements, forces times s."""
    stiffer = replace(
        TIP,
        tissue_stiffness=1.3 * TIP.tissue_stiffness,
        membrane_stiffness=1.3 * TIP.membrane_stiffness,
    )
    field, firm = read(name, held), read(name, held, replace(KNOWN, fingertip=stiffer))
    assert firm.total_normal == pytest.approx(1.3 * field.total_normal, rel=0.01)
    assert firm.total_friction == pytest.approx(1.3 * field.total_friction, rel=0.05)


@pytest.mark.parametrize("name", OURS)
def test_lost_markers_widen_the_interval_and_do_not_bend_the_field(name: str, held: Tracks) -> None:
    """A third of those that feel the contact; what it presses on must be seen."""
    near = np.deg2rad(4.0) < SENSOR.places[:, 0]
    keep = ~near | (np.arange(len(near)) % 3 > 0)
    blind = replace(held, position=np.where(keep[:, None], held.position, np.nan))
    whole, part = read(name, held), read(name, replace(blind, visible=held.visible & keep))
    before, after = (np.sqrt(f.totals_covariance[0, 0]) for f in (whole, part))
    assert after > before
    assert part.total_normal == pytest.approx(whole.total_normal, abs=2.0 * after)


@pytest.mark.parametrize("name", OURS)
def test_too_few_markers_are_an_error_that_counts_them(name: str, held: Tracks) -> None:
    few = np.zeros_like(held.visible)
    few[:, np.argsort(SENSOR.places[:, 0])[:12]] = True
    with pytest.raises(NoEstimateError, match=r"^12 marker pairs visible .* at least \d+ are"):
        read(name, replace(held, visible=few))


@pytest.mark.parametrize("name", ["gp"])
def test_the_covariance_covers_the_scatter(
    name: str, sheared: tuple[np.ndarray, ForceField]
) -> None:
    """Of noisy repeats about their own mean: the rest, a bias, is the model's and not noise."""
    seen, _ = sheared
    fields = [read(name, tracks(seen, np.random.default_rng(k))) for k in range(12)]
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
    field = read("gp", tracks(seen, np.random.default_rng(0)))
    assert field.total_normal == pytest.approx(truth.total_normal, rel=0.10)
    assert signed_friction(field) == pytest.approx(signed_friction(truth), abs=0.05)
    reading = FRICTION["core-quantile"](field)
    assert abs(reading.value - obj.friction) < 3.0 * reading.deviation


def test_a_pure_press_does_not_show_friction() -> None:
    """Whatever µ is: the largest ratio is the tissue's Poisson factor (E7)."""
    seen, _ = press(ContactObject(friction=0.8), 2.0, 0.0)
    for seed in range(3):
        assert not FRICTION["core-quantile"](
            read("gp", tracks(seen, np.random.default_rng(seed)))
        ).observable


def test_fine_chains_give_the_same_forces(
    held: Tracks, sheared: tuple[np.ndarray, ForceField]
) -> None:
    """Unknowns are forces per place on the skin, not per node."""
    fine = replace(KNOWN, fingertip=replace(TIP, nodes=501))
    assert read("gp", held, fine).total_normal == pytest.approx(
        read("gp", held).total_normal, rel=0.03
    )


class Foreign:
    """One that somebody else wrote."""

    def __init__(self, calibration: SensorCalibration, rest: Tracks) -> None: ...

    def reset(self) -> None: ...

    def update(self, tracks: Tracks) -> ForceField: ...


def test_reconstructors_go_by_name() -> None:
    made: Callable[[SensorCalibration, Tracks], object] = load_reconstructor(f"{__name__}:Foreign")
    assert made is Foreign
    with pytest.raises(UserError, match="there is auto, gp"):
        load_reconstructor("magic")
    with pytest.raises(UserError, match="has no reset"):
        load_reconstructor("collections:OrderedDict")
