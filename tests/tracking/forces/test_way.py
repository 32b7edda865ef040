"""The reconstructor `way`, on markers that another response and shorter steps of the chain draw."""

from dataclasses import replace

import numpy as np
import pytest

from chromagrip.errors import UserError
from chromagrip.model import (
    ContactObject,
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
from chromagrip.tracking.forces.chain.settings import WaySettings
from chromagrip.tracking.forces.chain.way_fit import Followed, WayFit, WayFrame
from chromagrip.tracking.forces.chain.way_reading import WayReading

from .test_learned import KNOWN, SENSOR, TIP, Specimen

PERIOD = 0.01
#: An object that is none of the starts; its friction law is not that with which a search starts.
OBJECT = ContactObject(friction=0.45, stiffness=400.0, curvature=30.0)


def grasp_of(duration: float = 0.5) -> History:
    """A press of 2 N in 0.1 s, then a pull that ends with Γ of about 0.3."""
    times = np.array([0.0, 0.1, 0.4, duration])
    drive = Drive(
        times=times,
        normal=np.array([0.02, 2.0, 2.0, 2.0]),
        lateral=np.array([0.0, 0.0, 0.62, 0.62]),
    )
    return simulate(TIP, OBJECT, drive, dt=2e-3, duration=duration, every=round(PERIOD / 2e-3))


def seen_by(specimen: Specimen, run: History) -> list[Tracks]:
    """Tracks of every instant of a run."""
    found = []
    for k in range(len(run)):
        tracks = specimen.tracks(run.state(k).deformation.seen, 1.0, 100 + k)
        found.append(replace(tracks, time=k * PERIOD))
    return found


@pytest.fixture(scope="module")
def run() -> History:
    return grasp_of()


def test_placed_copies_go_as_the_chain_under_position_control(run: History) -> None:
    """Against the integrator, with positions instead of forces and a tolerance ten times finer."""
    drive = Drive(
        times=run.time,
        normal=run.pose[:, 0],
        lateral=run.pose[:, 1],
        normal_control="position",
        lateral_control="position",
    )
    exact = simulate(TIP, OBJECT, drive, dt=PERIOD, duration=float(run.time[-1]), every=1)
    copies = copies_of(TIP, [OBJECT, OBJECT], np.ones(2))
    ensemble = rest_ensemble(TIP, 2)
    for pose in run.pose[1:]:
        ensemble, solved = place_many(copies, ensemble, np.tile(pose, (2, 1)), PERIOD)
        assert solved.all()
    assert abs(ensemble.nodes - exact.nodes[-1]).max() < 2e-6
    forces = contact_forces(TIP, OBJECT, exact.state(len(exact) - 1))
    for normal, friction in copies.sums(ensemble):
        assert normal == pytest.approx(forces.total_normal, rel=2e-3)
        assert friction == pytest.approx(forces.total_friction, rel=5e-3)


def test_a_membrane_of_its_own_changes_a_copy_as_it_changes_the_chain() -> None:
    stiffer = replace(TIP, membrane_stiffness=1.2 * TIP.membrane_stiffness)
    mixed = copies_of(TIP, [OBJECT, OBJECT], np.array([1.0, 1.2]))
    alone = copies_of(stiffer, [OBJECT], np.ones(1))
    pose = np.array([[0.5e-3, 0.1e-3]])
    both, _ = place_many(mixed, rest_ensemble(TIP, 2), np.tile(pose, (2, 1)), PERIOD)
    one, _ = place_many(alone, rest_ensemble(stiffer, 1), pose, PERIOD)
    np.testing.assert_allclose(both.nodes[1], one.nodes[0], atol=1e-12)
    assert abs(both.nodes[0] - one.nodes[0]).max() > 1e-6


@pytest.mark.parametrize("turned", [0.0, 2.0])
def test_a_way_tells_margin_and_friction(run: History, turned: float) -> None:
    """Of a load in any plane; the error of a single picture would be some 0.05 (Fisher)."""
    specimen = Specimen(turned_by=turned)
    reading = WayReading(KNOWN, specimen.rest)
    for tracks in seen_by(specimen, run):
        field = reading.update(tracks)
    truth = contact_forces(TIP, OBJECT, run.state(len(run) - 1))
    margin = truth.safety_margin(OBJECT.friction)
    told = field.friction_reading
    assert told is not None
    assert told.observable
    assert field.safety_margin(told.value) == pytest.approx(margin, abs=0.04)
    assert told.margin_deviation < 0.04
    assert field.total_normal == pytest.approx(truth.total_normal, rel=0.05)
    assert field.total_friction == pytest.approx(truth.total_friction, abs=0.02)


def test_frames_without_contact_end_a_way(run: History) -> None:
    specimen = Specimen()
    reading = WayReading(KNOWN, specimen.rest)
    for tracks in seen_by(specimen, run)[:20]:
        reading.update(tracks)
    assert reading._way.frames
    nothing = specimen.tracks(np.zeros((TIP.nodes, 2)), 1.0, 7)
    assert not reading.update(replace(nothing, time=1.0)).contact.any()
    assert not reading._way.frames


def test_a_way_that_no_contact_explains_is_doubted(run: History) -> None:
    """Every other frame shows the skin as it would be under the opposite load.

    The answer is then that of the read-out, with its interval, or none.
    """
    specimen = Specimen()
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


def test_copies_leave_what_their_constants_change(run: History) -> None:
    """With the true constants at copy 0, the sum of squares has its minimum near it."""
    specimen, settings = Specimen(), WaySettings()
    reading = WayReading(KNOWN, specimen.rest)
    fit = WayFit(TIP, SENSOR, reading._shifts.places, 0.0, settings)
    law = [np.log(OBJECT.dahl_stiffness), OBJECT.dahl_exponent, 0.0]
    truth = np.array([np.log(0.45), 30.0, np.log(400.0), *law])
    wrong = truth + np.array([0.16, 16.0, -0.24, 0.0, 0.0, 0.0])
    frames = [
        WayFrame(dt=PERIOD, shifts=reading._read(tracks), weight=1.0)
        for tracks in seen_by(specimen, run)[1:]
    ]

    def followed(constants: np.ndarray) -> tuple[Followed, np.ndarray, float]:
        way = fit.begin(constants)
        for frame in frames:
            fit.advance(way, frame)
        gram = way.gram(np.ones(way.done))
        return way, gram, float(fit.costs(way, gram)[0])

    there, off = followed(truth), followed(wrong)
    assert there[2] < 0.5 * off[2]
    # A step from the wrong constants leads to better ones, by much of what it promises.
    found = fit.quadratic(off[0], off[1])
    assert found.gain > 0.3 * (off[2] - there[2])
    assert followed(fit.moved(wrong, found.step))[2] < off[2] - 0.3 * found.gain


def test_a_way_needs_flat_or_round_objects() -> None:
    patchy = replace(OBJECT, patches=((0.0, 1.0), (1e-3, 0.5)))
    with pytest.raises(UserError, match="flat and round objects of one friction"):
        copies_of(Fingertip(), [patchy], np.ones(1))
