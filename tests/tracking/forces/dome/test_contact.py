"""A contact is read off the markers of a dome: forces, friction, and what it refuses."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from chromagrip.model import (
    DomeState,
    FrictionReading,
    Motion,
    Solid,
    dome_forces,
    margin_within,
    simulate_contact,
)
from chromagrip.model.dome import resting
from chromagrip.model.shapes import Shape, ball, box, plane
from chromagrip.tracking import ContactSettings, NoEstimateError, Tracks
from chromagrip.tracking.forces.dome.contact import ContactReading

from ..drawn import DESIGN, DOME, DOME_KNOWN, GRIP, Drawn, grasped

Array = NDArray[np.float64]


def read(states: tuple[DomeState, ...], seed: int = 0) -> ContactReading:
    """Reading after all frames."""
    drawn = Drawn(DESIGN, DOME, seed)
    reading = ContactReading(DOME_KNOWN, drawn())
    for state in states[:-1]:
        reading.update(drawn(state.linear))
    reading.field = reading.update(drawn(states[-1].linear))  # type: ignore[attr-defined]
    return reading


def test_force_direction_friction_and_margin_are_read_of_a_ball() -> None:
    azimuth, friction = 2.5, 0.4
    solid = Solid(shape=ball(12e-3), stiffness=2e9, friction=friction)
    states = grasped(solid, azimuth, 0.2, frames=16)
    field = read(states).field  # type: ignore[attr-defined]
    truth = dome_forces(DOME, states[-1])
    assert field.total_normal == pytest.approx(truth.total_normal, rel=0.06)
    assert field.net_friction == pytest.approx(truth.net_friction, abs=0.06)
    along = math.atan2(*field.net_friction[1::-1])
    assert math.remainder(along - azimuth, 2 * math.pi) == pytest.approx(0.0, abs=0.05)
    reading = field.friction_reading
    assert reading is not None
    assert reading.observable
    assert reading.value == pytest.approx(friction, rel=0.25)
    off = field.safety_margin(reading.value) - truth.safety_margin(friction)
    assert abs(off) < min(0.15, 2.5 * reading.margin_deviation)
    assert reading.margin_deviation < 0.15


@pytest.mark.stages
@pytest.mark.parametrize(
    ("shape", "margin", "torque"),
    [(plane(), 1.0, 2.5e-3), (ball(12e-3), 0.6, 1e-3)],
    ids=["turned", "ball"],
)
def test_torque_and_force_are_read_with_their_intervals(
    shape: Shape, margin: float, torque: float
) -> None:
    states = grasped(Solid(shape=shape, friction=0.6), 0.4, margin, torque=torque)
    field = read(states).field  # type: ignore[attr-defined]
    truth = dome_forces(DOME, states[-1])
    assert truth.wrench[3] == pytest.approx(torque, rel=0.1)
    deviation = np.sqrt(np.diag(field.wrench_covariance))
    assert (abs(field.wrench - truth.wrench) < 2.5 * deviation).all()
    # Narrow enough to tell whether there is a torque, and in which direction a pull.
    assert deviation[3] < 0.25 * abs(torque)
    assert (deviation[:3] < 0.1 * abs(truth.wrench[2])).all()
    # Forces and torque go up and down together with an error of µ: the matrix is a covariance.
    assert np.linalg.eigvalsh(field.wrench_covariance).min() >= 0.0
    reading = field.friction_reading
    assert reading is not None
    limit = margin_within(field, reading.value)
    assert limit == pytest.approx(margin_within(truth, 0.6), abs=0.15)
    # Torsion shows µ where Γ is 1, too.
    assert reading.observable


@pytest.mark.parametrize("noise_px", [0.05, 3.0])
def test_a_press_that_noise_hides_is_inside_the_interval_of_nothing(noise_px: float) -> None:
    """Whatever the noise is, either a press of 3 N is read, or "nothing" holds it."""
    states = grasped(Solid(shape=plane()), 0.0, 1.0)
    drawn = Drawn(DESIGN, DOME)
    noise = np.diag([noise_px**2, noise_px**2, (0.1 * noise_px) ** 2] * 2)

    def tracks(linear: Array | None = None) -> Tracks:
        clear = drawn(linear)
        return replace(clear, covariance=np.broadcast_to(noise, clear.covariance.shape))

    rest = tracks()
    field = ContactReading(DOME_KNOWN, rest).update(tracks(states[-1].linear))
    deviation = math.sqrt(field.totals_covariance[0, 0])
    assert abs(field.total_normal - GRIP) < 2.5 * deviation
    assert field.contact.any() == (noise_px < 0.1)
    assert field.total_friction < 0.05
    assert field.friction_reading is None or not field.friction_reading.observable
    assert np.isfinite(field.wrench_covariance).all()


@pytest.mark.stages
def test_two_contacts_are_refused() -> None:
    """Forces of two presses side by side: no object of one curvature leaves such an image."""
    poses = np.zeros((2, 6))
    linear = 0.0
    for side in (-1.0, 1.0):
        poses[:, 0] = side * 6e-3
        start = resting(DOME, Solid(shape=ball(4e-3)), Motion(times=[0.0, 1.0], poses=poses))
        down = poses.copy()
        down[1, 2] = -2.4e-3
        run = simulate_contact(
            DOME,
            Solid(shape=ball(4e-3)),
            Motion(times=np.array([0.0, 0.1]), poses=down),
            dt=0.01,
            start=start,
        )
        linear = linear + run.end.linear
    drawn = Drawn(DESIGN, DOME)
    reading = ContactReading(DOME_KNOWN, drawn())
    with pytest.raises(NoEstimateError, match="no contact of a smooth, convex object"):
        reading.update(drawn(linear))


@pytest.mark.parametrize(
    "pose",
    [
        (0.0, 0.0, 0.0, 0.0, math.pi / 4, 0.0),
        pytest.param((9e-3, 6e-3, 0.0, 0.0, 0.0, 0.4), marks=pytest.mark.stages),
    ],
    ids=["edge", "beside"],
)
def test_an_edge_is_refused(pose: tuple[float, ...]) -> None:
    """A box on its edge, and one whose edge passes beside the middle of the contact."""
    solid = Solid(shape=box(24e-3, rounding=0.4e-3), friction=0.6)
    with pytest.raises(NoEstimateError, match="no contact of a smooth, convex object"):
        read(grasped(solid, 0.4, 0.2, pose=pose))


def test_mu_is_observable_by_the_deviation_of_its_logarithm() -> None:
    """Not by that of µ, which is smaller: µ is 0.6."""
    reading = read(grasped(Solid(shape=plane(), friction=0.6), 0.4, 0.2))
    memory = reading._memory
    logarithm = math.sqrt(memory.covariance[2, 2])

    def friction(observed: float) -> FrictionReading:
        reading._settings = ContactSettings(observed=observed)
        field = reading._field(memory.last, memory.now.contact, memory.covariance)
        assert field.friction_reading is not None
        return field.friction_reading

    assert friction(1.01 * logarithm).observable
    assert not friction(0.99 * logarithm).observable
    found = friction(0.3)
    assert found.deviation == pytest.approx(found.value * logarithm)
    assert found.value < 0.8


def test_a_refused_contact_is_searched_again_less_and_less_often(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """At once only where its markers have moved far, and for the next contact."""
    linear = grasped(Solid(shape=plane(), friction=0.6), 0.4, 0.2)[12].linear
    drawn = Drawn(DESIGN, DOME)
    rest = drawn()
    settings = ContactSettings(search_every=8, search_patience=2, same=0.0)
    reading, searched = ContactReading(DOME_KNOWN, rest, settings), []

    def found(shifts: object) -> bool:
        searched.append(frame)
        return False

    monkeypatch.setattr(reading, "_found", found)
    for frame in range(30):
        with pytest.raises(NoEstimateError, match="no contact of a smooth, convex object"):
            reading.update(drawn((0.75 + 0.25 * (0.41 * frame % 1.0)) * linear))
    assert searched == [0, 1, 3, 5, 9, 13, 21, 29]
    searched.clear()
    frame = 30
    for share in (0.9, 1.0, 0.3, 0.31, 0.3):
        frame += 1
        with pytest.raises(NoEstimateError):
            reading.update(drawn(share * linear))
    assert searched == [33]
    frame = 35
    reading.update(rest)
    with pytest.raises(NoEstimateError):
        reading.update(drawn(linear))
    assert searched == [33, 35]
