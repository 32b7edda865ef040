"""Tractions are read off the markers of a dome: forces, friction, what is unsure and refused."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from msgspec import structs
from numpy.typing import NDArray

from chromagrip.errors import UserError
from chromagrip.measure.worlds.dome.readings import read as read_scene
from chromagrip.measure.worlds.dome.scenes import scene
from chromagrip.model import DomeState, ForceField, Motion, Solid, dome_forces, simulate_contact
from chromagrip.model.dome import Stepper, lattice, resting
from chromagrip.model.shapes import ball, cylinder, plane
from chromagrip.render import load_sensor
from chromagrip.tracking import (
    NoEstimateError,
    SensorCalibration,
    Tracks,
    load_reconstructor,
    sensor_as_designed,
)
from chromagrip.tracking.forces import (
    SILICONE_ERROR,
    silicone_names,
    silicone_of,
    with_silicone,
)
from chromagrip.tracking.forces.dome.traction.friction import read_slip
from chromagrip.tracking.forces.dome.traction.reading import TractionReading
from chromagrip.tracking.forces.dome.traction.settings import (
    SlipSettings,
    TractionFitSettings,
    TractionSettings,
)

from .drawn import Drawn

Array = NDArray[np.float64]

SENSOR = "thesis"
DESIGN = load_sensor(SENSOR)
DOME = DESIGN.dome
POINTS = lattice(DOME).points
GRIP = 1.0
NOTHING = np.zeros_like(POINTS)


@lru_cache(maxsize=8)
def grasped(
    solid: Solid, azimuth: float, margin: float, twist: float = 0.0, beside: float = 0.0
) -> DomeState:
    """State after a grip, a load that leaves a margin and a turn [rad]."""
    load = (1.0 - margin) * solid.friction * GRIP
    loads = np.zeros((4, 6))
    loads[1:, 2] = -GRIP
    loads[2:, :2] = load * math.cos(azimuth), load * math.sin(azimuth)
    poses = np.zeros((4, 6))
    poses[2:, 5] = twist
    poses[:, 0] = beside
    motion = Motion(
        times=np.array([0.0, 0.2, 0.5, 0.6]),
        poses=poses,
        free=("x", "y", "z"),
        drag=(2.0, 2.0, 25.0, 0.0, 0.0, 0.0),
        loads=loads,
    )
    stepper = Stepper(DOME, solid, motion, resting(DOME, solid, motion))
    for k in range(60):
        stepper.advance(0.6 * (k + 1) / 60)
    return stepper.state()


def reader(seed: int = 0, share: float = 1.0) -> tuple[TractionReading, Callable[..., Tracks]]:
    """A reader of a specimen at rest, and what draws its tracks."""
    drawn = Drawn(DESIGN, DOME, seed, share)
    return TractionReading(sensor_as_designed(SENSOR), drawn(NOTHING)), drawn


def read(linear: Array, seed: int = 0, share: float = 1.0) -> ForceField:
    """What is read off one frame."""
    reading, drawn = reader(seed, share)
    return reading.update(drawn(linear))


def wrench(field: ForceField) -> Array:
    """Force along x, y and z [N] and torque about z [N·m], shape (4,)."""
    return np.append(field.total_force, field.torque((0.0, 0.0, 1.0)))


@pytest.mark.parametrize(
    ("solid", "azimuth", "twist"),
    [
        (Solid(shape=plane(), friction=0.6), 0.4, 0.0),
        (Solid(shape=ball(8e-3), stiffness=1.5e9, friction=0.4), 2.5, 0.0),
        (Solid(shape=cylinder(6e-3), friction=0.5), 4.0, math.radians(20.0)),
    ],
    ids=["plane", "ball", "twisted rod"],
)
def test_forces_without_noise_come_back(solid: Solid, azimuth: float, twist: float) -> None:
    state = grasped(solid, azimuth, 0.2, twist)
    truth = dome_forces(DOME, state)
    field = read(state.linear, share=0.0)
    assert wrench(field)[:2] == pytest.approx(wrench(truth)[:2], abs=0.01)
    assert wrench(field)[2] == pytest.approx(wrench(truth)[2], rel=0.02)
    assert wrench(field)[3] == pytest.approx(wrench(truth)[3], abs=2e-5)
    assert field.total_normal == pytest.approx(truth.total_normal, rel=0.02)
    assert field.net_friction == pytest.approx(truth.net_friction, abs=0.02)
    # Most of the force is on nodes that touch, and along the object's own normals.
    assert field.normal[truth.contact].sum() > 0.97 * field.total_normal
    assert field.directions is not None
    assert truth.directions is not None
    cosines = (field.directions * truth.directions).sum(axis=1)
    assert field.normal @ cosines > 0.985 * field.total_normal


def test_friction_and_margin_are_read_where_most_of_the_skin_slips() -> None:
    solid = Solid(shape=plane(), friction=0.6)
    state = grasped(solid, 0.4, 0.2)
    field = read(state.linear)
    reading = field.friction_reading
    assert reading is not None
    assert reading.observable
    assert reading.value == pytest.approx(0.6, rel=0.12)
    off = field.safety_margin(reading.value) - dome_forces(DOME, state).safety_margin(0.6)
    # A constant margin of 0.5 would be off by 0.3.
    assert abs(off) < min(0.1, 2.5 * reading.margin_deviation)
    assert reading.margin_deviation < 0.15


def test_friction_is_not_read_off_a_pure_press() -> None:
    state = grasped(Solid(shape=plane(), friction=0.6), 0.0, 1.0)
    field = read(state.linear)
    reading = field.friction_reading
    assert reading is not None
    assert not reading.observable
    assert reading.deviation > 0.3 * reading.value
    assert field.total_friction < 0.01


def test_friction_of_balls_in_partial_slip() -> None:
    """Cattaneo and Mindlin: µp outside the radius that sticks, less by a smaller pressure in it."""
    nodes = np.flatnonzero(np.linalg.norm(POINTS[:, :2], axis=1) < 2.4e-3)
    off = np.linalg.norm(POINTS[nodes, :2], axis=1) / 2.4e-3
    pressure = np.sqrt(np.maximum(1.0 - off**2, 0.0))
    for margin in (0.1, 0.3):
        stick = margin ** (1.0 / 3.0)
        inner = stick * np.sqrt(np.maximum(1.0 - (off / stick) ** 2, 0.0))
        friction = 0.5 * (pressure - inner)[:, None] * np.array([0.6, 0.8, 0.0])
        load = float(np.linalg.norm(friction.sum(axis=0)))
        assert 1.0 - load / (0.5 * pressure.sum()) == pytest.approx(margin, abs=0.03)
        slip = read_slip(DOME, nodes, pressure, friction, load, rim=0.1, settings=SlipSettings())
        assert slip.friction == pytest.approx(0.5, rel=0.12)
        assert slip.deviation < 0.1


@pytest.mark.slow
def test_a_scene_that_is_turned_turns_the_forces() -> None:
    solid, azimuth, turn = Solid(shape=plane(), friction=0.5), 0.3, 2.0 * math.pi / 3.0
    fields = [read(grasped(solid, azimuth + by, 0.3).linear, 3) for by in (0.0, turn)]
    c, s = math.cos(turn), math.sin(turn)
    turned = np.array([[c, -s], [s, c]]) @ fields[0].net_friction[:2]
    assert np.linalg.norm(turned) > 0.2
    assert fields[1].net_friction[:2] == pytest.approx(turned, abs=0.01)
    assert fields[1].total_normal == pytest.approx(fields[0].total_normal, rel=0.02)


def test_the_scatter_of_forces_is_what_their_covariance_says() -> None:
    state = grasped(Solid(shape=plane(), friction=0.6), 0.4, 0.2)
    reading, drawn = reader()
    reading.update(drawn(state.linear))
    fields = [reading.update(drawn(state.linear)) for _ in range(30)]
    scatter = np.std([wrench(field) for field in fields], axis=0)
    assert fields[-1].wrench_covariance is not None
    stated = np.sqrt(np.diag(fields[-1].wrench_covariance))
    # The noise of the rest frame and the calibration's floor, each as large, do not scatter, nor
    # does what the unknown surface leaves, of which z and the torque have more.
    assert (scatter[:2] < stated[:2]).all()
    assert (scatter[:2] > 0.2 * stated[:2]).all()
    assert (scatter[2:] < stated[2:]).all()


def press_beside(side: float, shift: float) -> DomeState:
    """A ball that is pressed at a distance from the apex [m], and shifted along y."""
    poses = np.zeros((3, 6))
    poses[:, 0] = side
    solid = Solid(shape=ball(4e-3))
    start = resting(DOME, solid, Motion(times=[0.0, 1.0], poses=poses[:2]))
    poses[1:, 2] = -1.8e-3
    poses[2, 1] = shift
    motion = Motion(times=np.array([0.0, 0.1, 0.2]), poses=poses)
    return simulate_contact(DOME, solid, motion, dt=0.01, start=start).end


def test_two_contacts_are_read_apart() -> None:
    one, other = press_beside(-5e-3, 0.1e-3), press_beside(5e-3, -0.1e-3)
    reading, drawn = reader()
    reading.update(drawn(one.linear))
    field = reading.update(drawn(one.linear + other.linear))
    for state, side in ((one, POINTS[:, 0] < 0.0), (other, POINTS[:, 0] > 0.0)):
        truth = state.forces.sum(axis=0)
        assert field.directions is not None
        forces = (field.normal[:, None] * field.directions + field.friction)[side].sum(axis=0)
        assert np.linalg.norm(truth) > 0.2
        assert forces == pytest.approx(truth, abs=0.08 * np.linalg.norm(truth))


def test_the_object_presses_and_friction_is_across_its_normals() -> None:
    field = read(grasped(Solid(shape=cylinder(6e-3), friction=0.5), 4.0, 0.2).linear)
    assert field.directions is not None
    assert (field.normal[field.contact] > 0.0).all()
    assert not field.normal[~field.contact].any()
    along = (field.friction * field.directions).sum(axis=1)
    assert abs(along).max() < 1e-9
    assert np.linalg.norm(field.directions[field.contact], axis=1) == pytest.approx(1.0)


@pytest.mark.slow
def test_errors_and_the_zone_are_settings() -> None:
    state = grasped(Solid(shape=plane(), friction=0.6), 0.4, 0.2)

    def with_settings(settings: TractionSettings) -> ForceField:
        drawn = Drawn(DESIGN, DOME)
        reading = TractionReading(sensor_as_designed(SENSOR), drawn(NOTHING), settings)
        return reading.update(drawn(state.linear))

    usual = with_settings(TractionSettings())
    unsure = with_settings(TractionSettings(margin_error=0.3, normal_error=0.1))
    assert usual.friction_reading is not None
    assert unsure.friction_reading is not None
    assert usual.friction_reading.margin_deviation < 0.15 < 0.3
    assert unsure.friction_reading.margin_deviation > 0.3
    assert unsure.totals_covariance[0, 0] > (0.1 * unsure.total_normal) ** 2
    assert usual.totals_covariance[0, 0] < 0.2 * unsure.totals_covariance[0, 0]
    assert np.array_equal(usual.normal, unsure.normal)
    narrow = TractionFitSettings(joining=0.3)
    assert with_settings(TractionSettings(fit=narrow)).contact.sum() < usual.contact.sum()


def test_nothing_touches_at_rest() -> None:
    reading, drawn = reader()
    for _ in range(20):
        field = reading.update(drawn(NOTHING))
        assert not field.contact.any()
    assert math.isnan(field.safety_margin(0.5))


def test_a_change_of_focus_is_no_contact() -> None:
    reading, drawn = reader()
    tracks = drawn(NOTHING)
    field = reading.update(replace(tracks, log_size=tracks.log_size + 0.004))
    assert not field.contact.any()


def test_a_few_markers_that_are_elsewhere_hardly_matter() -> None:
    state = grasped(Solid(shape=plane(), friction=0.6), 0.4, 0.2)
    reading, drawn = reader()
    field = reading.update(drawn(state.linear))
    tracks = drawn(state.linear)
    position = tracks.position.copy()
    near = np.argsort(np.linalg.norm(POINTS[0] - DESIGN.shape.points(DESIGN.places, 0.0), axis=1))
    position[:, near[[3, 11, 19]]] += 4.0
    odd = reading.update(replace(tracks, position=position))
    assert odd.total_normal == pytest.approx(field.total_normal, rel=0.02)
    assert odd.net_friction == pytest.approx(field.net_friction, abs=0.02)


@pytest.mark.slow
def test_markers_that_no_tractions_move_are_refused() -> None:
    reading, drawn = reader()
    tracks = drawn(NOTHING)
    ways = np.random.default_rng(1).normal(size=tracks.position.shape)
    with pytest.raises(NoEstimateError, match="no tractions on the skin explain the markers"):
        reading.update(replace(tracks, position=tracks.position + 2.0 * ways))


def test_a_pull_is_no_contact() -> None:
    """Silicone that is drawn out of the dome: no object does that."""
    state = grasped(Solid(shape=plane(), friction=0.6), 0.0, 1.0)
    with pytest.raises(NoEstimateError, match="no tractions on the skin explain the markers"):
        read(-state.linear)


def test_too_few_markers_are_refused() -> None:
    reading, drawn = reader()
    tracks = drawn(NOTHING)
    visible = tracks.visible.copy()
    visible[:, 30:] = False
    with pytest.raises(NoEstimateError, match="at least 40"):
        reading.update(replace(tracks, visible=visible))


def test_the_same_frames_give_the_same_field_and_reset_forgets() -> None:
    state = grasped(Solid(shape=plane(), friction=0.6), 0.4, 0.2)
    (one, drawn), (other, _) = reader(), reader()
    first, second = drawn(0.5 * state.linear), drawn(state.linear)
    for reading in (one, other):
        reading.update(first)
    assert np.array_equal(one.update(second).normal, other.update(second).normal)
    one.reset()
    fresh, _ = reader()
    fresh.update(first)
    fresh.reset()
    assert np.array_equal(one.update(second).normal, fresh.update(second).normal)


def calibrated(deviations: dict[str, float]) -> SensorCalibration:
    """The design, with silicone that is known to deviations; what is not named is known."""
    known = sensor_as_designed(SENSOR)
    spread = [deviations.get(name, 0.0) ** 2 for name in silicone_names(known.sensor)]
    return replace(known, silicone_covariance=tuple(map(tuple, np.diag(spread).tolist())))


def read_as(known: SensorCalibration, state: DomeState) -> ForceField:
    """What is read off a frame without noise."""
    drawn = Drawn(DESIGN, DOME, 0, 0.0)
    reading = TractionReading(known, drawn(NOTHING))
    for share in (0.5, *[1.0] * 5):
        field = reading.update(drawn(share * state.linear))
    return field


def margin_of(field: ForceField) -> tuple[float, float]:
    """Γ and its deviation."""
    assert field.friction_reading is not None
    reading = field.friction_reading
    return field.safety_margin(reading.value), reading.margin_deviation


@pytest.mark.slow
def test_silicone_that_is_known_adds_nothing() -> None:
    state = grasped(Solid(shape=plane(), friction=0.6), 0.4, 0.2)
    plain, known = read_as(sensor_as_designed(SENSOR), state), read_as(calibrated({}), state)
    assert np.array_equal(plain.normal, known.normal)
    assert np.array_equal(plain.totals_covariance, known.totals_covariance)
    assert np.array_equal(plain.wrench_covariance, known.wrench_covariance)
    assert margin_of(plain) == margin_of(known)


@pytest.mark.slow
def test_an_unsure_modulus_widens_all_forces_by_its_share_and_not_the_margin() -> None:
    state = grasped(Solid(shape=plane(), friction=0.6), 0.4, 0.2)
    plain, known = read_as(calibrated({}), state), read_as(calibrated({"young_kpa": 12.0}), state)
    sums = np.array([plain.total_normal, plain.total_friction])
    more = known.totals_covariance - plain.totals_covariance
    assert more == pytest.approx(0.03**2 * np.outer(sums, sums), rel=1e-6)
    assert known.wrench_covariance is not None
    more = known.wrench_covariance - plain.wrench_covariance
    assert more == pytest.approx(0.03**2 * np.outer(plain.wrench, plain.wrench), rel=1e-6)
    assert margin_of(plain) == margin_of(known)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "by"),
    [
        pytest.param("core_mm", 0.03, marks=pytest.mark.slow),
        pytest.param("poisson", 0.005, marks=pytest.mark.slow),
        pytest.param("magenta_depth_mm", 0.02, marks=pytest.mark.slow),
        ("yellow_depth_mm", 0.03),
    ],
)
def test_unsure_silicone_widens_as_much_as_other_silicone_changes(name: str, by: float) -> None:
    """A deviation widens by about what the same frame reads where the silicone is told that off."""
    state = grasped(Solid(shape=plane(), friction=0.6), 0.4, 0.2)
    plain, known = read_as(calibrated({}), state), read_as(calibrated({name: by}), state)
    values = silicone_of(calibrated({}))
    assert values is not None
    both = [structs.replace(values, **{name: getattr(values, name) + k * by}) for k in (-1, 1)]
    low, high = (read_as(with_silicone(calibrated({}), other), state) for other in both)
    more = math.sqrt((known.totals_covariance - plain.totals_covariance)[0, 0])
    # To first order: nodes at the rim that leave or join the contact are left out.
    off = math.hypot(*(f.total_normal - plain.total_normal for f in (low, high))) / math.sqrt(2.0)
    assert more == pytest.approx(off, rel=0.4)
    assert 0.004 < off / plain.total_normal < 0.06
    off = math.hypot(*(margin_of(f)[0] - margin_of(plain)[0] for f in (low, high))) / math.sqrt(2.0)
    stated = math.sqrt(margin_of(known)[1] ** 2 - margin_of(plain)[1] ** 2)
    assert stated == pytest.approx(off, rel=0.6, abs=0.015)


def test_what_the_covariance_says_is_not_added_twice() -> None:
    drawn = Drawn(DESIGN, DOME)
    rest, known = drawn(NOTHING), replace(calibrated({"young_kpa": 12.0}), stiffness_deviation=0.05)
    assert TractionReading(known, rest).stiffness_deviation == SILICONE_ERROR
    plain = replace(known, silicone_covariance=())
    assert TractionReading(plain, rest).stiffness_deviation == 0.05


@pytest.mark.parametrize("name", ["dome-2020", "dome-2022"])
def test_a_layer_on_the_core_is_refused(name: str) -> None:
    known = sensor_as_designed(name)
    with pytest.raises(UserError, match="use the reconstructor contact"):
        load_reconstructor("traction")(known, None)  # type: ignore[arg-type]


def test_a_pad_is_refused() -> None:
    known = sensor_as_designed("flat-2019")
    with pytest.raises(UserError, match="not a flat pad"):
        load_reconstructor("traction")(known, None)  # type: ignore[arg-type]


@pytest.mark.slow
def test_pictures_are_read_with_honest_intervals() -> None:
    """Objects, loads and defects at random, painted with noise and tracked."""
    inside, off = [], []
    for index in range(6):
        watched = scene(SENSOR, "soft", index)
        found = read_scene("traction", watched)
        assert not found.answers.flagged.any()
        low, high = np.moveaxis(found.answers.interval, -1, 0)
        inside.append((low <= watched.true) & (watched.true <= high))
        off.append(found.answers.value - watched.true)
        assert found.side == pytest.approx(watched.side, abs=0.01)
        assert found.answers.value[:, 0] == pytest.approx(watched.true[:, 0], rel=0.05)
    assert (np.mean(np.concatenate(inside), axis=0) > 0.8).all()
    # The best constant answer is off by 0.35.
    assert math.sqrt((np.concatenate(off)[:, 3] ** 2).mean()) < 0.08
