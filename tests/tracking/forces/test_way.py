"""The reconstructor `way`, on markers of a chain that makes shorter steps."""

from dataclasses import replace

import numpy as np
import pytest

from chromagrip.errors import UserError
from chromagrip.model import (
    ContactObject,
    Copies,
    Drive,
    Fingertip,
    History,
    contact_forces,
    copies_of,
    place_many,
    rest_ensemble,
    simulate,
)
from chromagrip.tracking import NoEstimateError, Tracks
from chromagrip.tracking.forces.chain.learned import Learned
from chromagrip.tracking.forces.chain.settings import FilterSettings
from chromagrip.tracking.forces.chain.way_filter import CONSTANTS, WayFilter
from chromagrip.tracking.forces.chain.way_reading import WayReading

from .drawn import KNOWN, OBJECT, SENSOR, TIP, Specimen, pulled

PERIOD = 0.01


def copies(tip: Fingertip, objects: list[ContactObject]) -> Copies:
    """Copies of a fingertip with these objects."""
    names = ("friction", "curvature", "stiffness", "dahl_stiffness", "dahl_exponent")
    return copies_of(
        tip, **{name: np.array([getattr(obj, name) for obj in objects]) for name in names}
    )


def seen_by(specimen: Specimen, run: History) -> list[Tracks]:
    """Tracks of every instant of a run."""
    found = []
    for k in range(len(run)):
        found.append(specimen.tracks(run.state(k).deformation.seen, 1.0, 100 + k, k * PERIOD))
    return found


def test_placed_copies_go_as_the_chain_under_position_control() -> None:
    """Against the integrator, with positions instead of forces and a tolerance ten times finer."""
    run = pulled()
    drive = Drive(
        times=run.time,
        normal=run.pose[:, 0],
        lateral=run.pose[:, 1],
        normal_control="position",
        lateral_control="position",
    )
    exact = simulate(TIP, OBJECT, drive, dt=PERIOD, duration=float(run.time[-1]), every=1)
    two = copies(TIP, [OBJECT, OBJECT])
    ensemble = rest_ensemble(TIP, 2)
    for pose in run.pose[1:]:
        ensemble, solved = place_many(two, ensemble, np.tile(pose, (2, 1)), PERIOD)
        assert solved.all()
    assert abs(ensemble.nodes - exact.nodes[-1]).max() < 2e-6
    forces = contact_forces(TIP, OBJECT, exact.state(len(exact) - 1))
    for normal, friction in two.sums(ensemble):
        assert normal == pytest.approx(forces.total_normal, rel=2e-3)
        assert friction == pytest.approx(forces.total_friction, rel=5e-3)


@pytest.mark.stages
def test_a_way_finds_object_and_law_and_ends_without_contact() -> None:
    """Of a load in another plane.

    Constants that no member began with are within the members' scatter, which has shrunk.
    """
    specimen = Specimen(turned_by=2.0)
    reading = WayReading(KNOWN, specimen.rest)
    for tracks in seen_by(specimen, pulled()):
        field = reading.update(tracks)
    found, truth = reading._filter, contact_forces(TIP, OBJECT, pulled().state(len(pulled()) - 1))
    told = field.friction_reading
    assert told is not None
    # The error of Γ of a single picture would be some 0.05 (Fisher).
    margin = truth.safety_margin(OBJECT.friction)
    assert field.safety_margin(told.value) == pytest.approx(margin, abs=0.04)
    assert told.margin_deviation < 0.04
    begin = WayFilter(TIP, SENSOR, np.stack([SENSOR.places] * 2), FilterSettings())
    true = np.array([np.log(0.45), 30.0, np.log(400.0)])
    mean, deviation = found.constants.mean(axis=0)[:3], found.constants.std(axis=0)[:3]
    assert len(CONSTANTS) == found.constants.shape[1]
    assert (deviation < 0.3 * begin.constants.std(axis=0)[:3]).all()
    assert (abs(mean - true) < 0.35 * abs(begin.constants[:, :3] - true).mean(0)).all()
    assert np.mean(found.misfits[-10:]) < 0.3
    nothing = specimen.tracks(np.zeros((TIP.nodes, 2)), 1.0, 7)
    assert not reading.update(replace(nothing, time=1.0)).contact.any()
    assert not found.misfits


@pytest.mark.stages
def test_a_way_that_no_contact_explains_is_doubted() -> None:
    """Every other frame shows the skin as it would be under the opposite load.

    The answer is then that of the read-out, with its interval, or none.
    """
    specimen, run = Specimen(), pulled()
    reading, alone, refused = WayReading(KNOWN, specimen.rest), Learned(KNOWN, specimen.rest), 0
    for k, tracks in enumerate(seen_by(specimen, run)):
        if k >= 20 and k % 2:
            seen = run.state(k).deformation.seen[::-1] * [-1.0, 1.0]
            tracks = replace(specimen.tracks(seen, 1.0, k), time=k * PERIOD)
        field = alone.update(tracks)
        try:
            told = reading.update(tracks)
        except NoEstimateError:
            refused += 1
            continue
        if k > 40:
            assert told.friction_reading is not None
            assert field.friction_reading is not None
            before = field.friction_reading.margin_deviation
            assert told.friction_reading.margin_deviation > 0.7 * before
    assert refused < 30


@pytest.mark.parametrize("curvature", [230.0, -60.0])
def test_copies_touch_where_objects_do(curvature: float) -> None:
    """A round or hollow object that the fingertip fits in is first touched by the apex."""
    obj = replace(OBJECT, curvature=curvature)
    alone = copies(TIP, [obj])
    assert alone.contacts[0, 6] == pytest.approx(TIP.radius, abs=1e-12)
    just, _ = place_many(alone, rest_ensemble(TIP, 1), np.array([[-1e-6, 0.0]]), PERIOD)
    assert alone.sums(just)[0, 0] == 0.0
    pressed, _ = place_many(alone, rest_ensemble(TIP, 1), np.array([[100e-6, 0.0]]), PERIOD)
    assert alone.sums(pressed)[0, 0] > 0.0
    with pytest.raises(UserError, match="too narrow for a fingertip"):
        copies(TIP, [OBJECT, replace(OBJECT, curvature=-900.0)])


def test_combining_members_is_the_analysis_of_a_linear_filter() -> None:
    """On linear markers the mean and covariance are those of Kalman's filter, where nothing binds.

    Limits on the gain of information are set aside, and no spread is kept.
    """
    free = FilterSettings(
        members=8,
        steepest=1e12,
        longest=1e12,
        relaxed=0.0,
        inflation=1.0,
        least_spread=(0.0,) * 5,
        low=(-1e3,) * 5,
        high=(1e3,) * 5,
    )
    whole = WayFilter(TIP, SENSOR, np.stack([SENSOR.places] * 2), free)
    rng = np.random.default_rng(5)
    slopes = 0.01 * rng.standard_normal((40, 5)) / whole.constants.std(axis=0)
    before, seen = whole.constants.copy(), rng.standard_normal(40)
    mean, apart = before.mean(axis=0), before - before.mean(axis=0)
    covariance = apart.T @ apart / 7.0
    gain = covariance @ slopes.T @ np.linalg.inv(slopes @ covariance @ slopes.T + np.eye(40))
    whole.misfits.append(0.0)
    whole._assimilate(whole.ensemble, seen - before @ slopes.T, 1.0)
    np.testing.assert_allclose(
        whole.constants.mean(axis=0), mean + gain @ (seen - slopes @ mean), rtol=1e-9
    )
    after = np.cov(whole.constants.T)
    np.testing.assert_allclose(
        after, covariance - gain @ slopes @ covariance, rtol=1e-7, atol=1e-12
    )
