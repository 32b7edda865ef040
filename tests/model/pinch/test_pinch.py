"""A pinch against analysis, conservation, symmetry and one dome alone."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipk

from chromagrip.errors import UserError
from chromagrip.model import Dome, Motion, Solid, dome_forces, simulate_contact
from chromagrip.model.pinch import (
    HandPath,
    Limits,
    Pinch,
    PinchRecord,
    PinchRun,
    RigidBody,
    Shake,
    box_body,
    follow_pinch,
    load_pinch_state,
    pinch_rest,
    save_pinch_state,
    simulate_pinch,
)
from chromagrip.model.shapes import ball, box, plane

COARSE = Dome(pitch=0.7e-3, reach=math.radians(45.0))
OTHER = Dome(radius=10e-3, core=6e-3, pitch=0.9e-3, reach=math.radians(45.0), young=0.3e6)
SIZE = (20e-3, 20e-3, 16e-3)
MASS, G = 0.05, 9.81
LIFT = HandPath(
    times=(0.0, 0.15, 0.35), places=((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (-0.02, 0.0, 0.0))
)
DT = 5e-3


def pinch(second: Dome = COARSE, friction: float = 0.5, **changes: object) -> Pinch:
    solid = Solid(shape=box(SIZE, 1e-3), friction=friction)
    values = {"body": box_body(MASS, SIZE), "hand": LIFT, **changes}
    return Pinch(first=COARSE, second=second, solid=solid, **values)  # type: ignore[arg-type]


def ramp(force: float) -> object:
    return lambda time: force * min(1.0, time / 0.1)


@pytest.fixture(scope="module")
def lifted() -> PinchRun:
    """A box that is lifted by two different fingertips."""
    return simulate_pinch(pinch(OTHER), 0.6, ramp(2.0), DT)


def test_the_table_carries_the_weight_until_the_fingers_do(lifted: PinchRun) -> None:
    before, after = lifted.times < 0.14, lifted.times > 0.5
    assert lifted.supports[before] == pytest.approx(MASS * G, rel=1e-3)
    assert not lifted.supports[after].any()
    held = lifted.forces[after, :, 0].sum(axis=1)
    assert held == pytest.approx(MASS * G, rel=5e-3)


def test_both_fingers_press_with_the_grip(lifted: PinchRun) -> None:
    press = lifted.forces[-1, :, 2] * [-1.0, 1.0]
    assert press == pytest.approx(2.0, rel=1e-3)


def test_momentum_changes_by_the_stored_forces(lifted: PinchRun) -> None:
    momentum = np.array([each.momentum for each in lifted.moving])
    force = MASS * np.array([G, 0.0, 0.0]) - lifted.forces.sum(axis=1)
    force[:, 0] -= lifted.supports
    rate = (1.5 * momentum[2:] - 2.0 * momentum[1:-1] + 0.5 * momentum[:-2]) / DT
    assert not sum(count.halvings for count in lifted.counts)
    assert abs(rate - force[2:]).max() < 1e-6
    # and the places follow that momentum
    place = np.array([each.place for each in lifted.moving])
    velocity = (1.5 * place[2:] - 2.0 * place[1:-1] + 0.5 * place[:-2]) / DT
    assert abs(MASS * velocity - momentum[2:]).max() < 1e-4 * MASS * G * DT * 10
    assert abs(momentum).max() > 1e-3


def test_the_sag_is_that_of_one_fingertip_under_half_the_weight() -> None:
    still = (0.0, 0.0, 0.0)
    slow = HandPath(times=(0.0, 0.15, 0.55), places=(still, still, (-2e-3, 0.0, 0.0)))
    held = simulate_pinch(pinch(hand=slow), 0.6, ramp(2.0), DT)
    loads = np.zeros((3, 6))
    loads[1:, 2] = -2.0
    loads[2, 0] = 0.5 * MASS * G
    motion = Motion(
        times=np.array([0.0, 0.15, 0.6]), poses=np.zeros((3, 6)), free=("x", "z"), loads=loads,
        drag=(5.0, 0.0, 5.0, 0.0, 0.0, 0.0),
    )  # fmt: skip
    one = simulate_contact(COARSE, Solid(shape=plane(), friction=0.5), motion, dt=DT)
    assert held.places[-1, 0] == pytest.approx(one.places[-1, 0], rel=0.03)
    assert held.places[-1, 0] > 5e-5


def test_too_little_friction_lets_it_slide_down() -> None:
    mu, grip = 0.1, 2.0
    free = pinch(friction=mu, table=False, hand=HandPath())
    start = simulate_pinch(replace(free, gravity=(0.0, 0.0, 0.0)), 0.15, ramp(grip), DT).end
    run = simulate_pinch(free, 0.21, ramp(grip), DT, start)
    velocity = np.array([each.momentum[0] for each in run.moving]) / MASS
    late = run.times > 0.17
    found = np.polyfit(run.times[late], velocity[late], 1)[0]
    assert found == pytest.approx(G - 2.0 * mu * grip / MASS, rel=0.03)


def _swing(dt: float, young: float = 4e6) -> tuple[np.ndarray, np.ndarray, float]:
    """Times and angles of a body that swings on a small ball, and its period at first."""
    arm, mass, own, start = 10e-3, 0.01, 1e-6, math.radians(80.0)
    dome = Dome(young=young, pitch=0.15e-3, reach=math.radians(20.0), stiffening=False)
    body = RigidBody(
        mass=mass, inertia=(own,) * 3, centre=(arm * math.cos(start), arm * math.sin(start), 0.0)
    )
    solid = Solid(shape=ball(1e-3), friction=1.0, stiffness=1e10, dahl_stiffness=5e10)
    free = Pinch(first=dome, second=dome, solid=solid, body=body, table=False)
    grip = ramp(0.15)
    rest = simulate_pinch(replace(free, gravity=(0.0, 0.0, 0.0)), 0.1, grip, dt).end  # type: ignore[arg-type]
    run = simulate_pinch(free, 0.55, grip, dt, rest)  # type: ignore[arg-type]
    small = 2.0 * math.pi * math.sqrt((own + mass * arm**2) / (mass * G * arm))
    return run.times, run.turns + start, small


def test_a_swing_about_the_axis_has_the_period_of_a_pendulum() -> None:
    times, angles, small = _swing(DT)
    k = np.flatnonzero(angles[:-1] * angles[1:] <= 0.0)
    crossed = times[k] - angles[k] * (times[k + 1] - times[k]) / (angles[k + 1] - angles[k])
    top = np.array([abs(angles[a:b]).max() for a, b in pairwise(k)])
    assert len(crossed) >= 3
    expected = small / math.pi * ellipk(np.sin(top / 2.0) ** 2)
    assert np.diff(crossed) == pytest.approx(expected, rel=0.03)
    # Friction on the ball takes little of a swing, and the step nearly nothing.
    assert top[0] > math.radians(65.0)
    shorter = _swing(DT / 2.0)[1]
    assert abs(angles).max() == pytest.approx(abs(shorter).max(), rel=0.01)
    assert angles.min() == pytest.approx(shorter.min(), rel=0.015)


def _tumbled(dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Rotation of a free body of three moments after a while, and its angular momentum."""
    spin = np.array([1.0e-5, 3.0e-5, 2.0e-5])
    free = pinch(table=False, gravity=(0.0, 0.0, 0.0), hand=HandPath())
    free = replace(free, body=RigidBody(mass=MASS, inertia=(2e-6, 3e-6, 5e-6)))
    start = pinch_rest(free)
    start = replace(start, moving=replace(start.moving, spin=spin, spin_before=spin))
    run = simulate_pinch(free, 0.1, lambda time: -3.0, dt, start)
    assert not run.forces.any()
    return run.moving[-1].rotation, run.moving[-1].spin


def test_a_free_body_tumbles_as_euler_says_with_second_order() -> None:
    inertia, spin = np.array([2e-6, 3e-6, 5e-6]), np.array([1.0e-5, 3.0e-5, 2.0e-5])

    def rates(_: float, values: np.ndarray) -> np.ndarray:
        rotation = values.reshape(3, 3)
        omega = rotation @ ((rotation.T @ spin) / inertia)
        return np.cross(omega, rotation, axisb=0, axisc=0).ravel()

    exact = solve_ivp(rates, (0.0, 0.1), np.eye(3).ravel(), rtol=1e-10, atol=1e-12).y[:, -1]
    off = []
    for dt in (4e-3, 2e-3, 1e-3):
        rotation, after = _tumbled(dt)
        assert after == pytest.approx(spin, rel=1e-12)
        off.append(abs(rotation.ravel() - exact).max())
    assert off[0] < 0.02
    assert off[1] / off[2] > 3.0


def test_a_mirrored_pinch_is_the_mirror_image() -> None:
    runs = [
        simulate_pinch(pinch(body=box_body(MASS, SIZE, (0.0, y, 0.0))), 0.4, ramp(2.0), DT)
        for y in (4e-3, -4e-3)
    ]
    assert runs[0].turns == pytest.approx(-runs[1].turns, abs=2e-4)
    assert runs[0].turns[-1] < -0.01  # +y hangs down: gravity along +x turns it backwards
    assert runs[0].places[:, :2] == pytest.approx(runs[1].places[:, :2] * [1, -1], abs=5e-6)
    # Both fingertips are the same, and so is what they do.
    for run in runs:
        assert run.forces[:, 0, :2] == pytest.approx(run.forces[:, 1, :2], abs=3e-3)


def test_a_tilted_hand_rests_the_weight_on_the_lower_finger() -> None:
    """The drive pushes both fingertips alike; the weight goes to the one below."""
    turns = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.5 * math.pi, 0.0))
    tilt = replace(LIFT, times=(0.0, 0.15, 0.5), turns=turns)
    run = simulate_pinch(pinch(hand=tilt), 0.8, ramp(2.0), DT)
    press = run.forces[-1, :, 2] * [-1.0, 1.0]
    assert press.mean() == pytest.approx(2.0, rel=2e-3)
    assert abs(press[0] - press[1]) == pytest.approx(MASS * G, rel=0.02)


def test_shaking_asks_for_the_force_of_the_acceleration() -> None:
    shake = Shake(amplitude=(0.0, 1e-3, 0.0), frequency=5.0, start=0.2, stop=0.8)
    hand = HandPath(shake=shake)
    free = pinch(hand=hand, table=False, gravity=(0.0, 0.0, 0.0))
    run = simulate_pinch(free, 0.8, ramp(2.0), DT)
    middle = (run.times > 0.42) & (run.times < 0.58)
    largest = abs(run.forces[middle, :, 1].sum(axis=1)).max()
    assert largest == pytest.approx(MASS * 1e-3 * (2.0 * math.pi * 5.0) ** 2, rel=0.05)


def test_a_run_that_is_restored_in_the_middle_has_the_same_bytes(tmp_path) -> None:  # type: ignore[no-untyped-def]
    whole = simulate_pinch(pinch(OTHER), 0.3, ramp(2.0), DT)
    half = simulate_pinch(pinch(OTHER), 0.15, ramp(2.0), DT)
    save_pinch_state(tmp_path / "half.npz", half.end)
    rest = simulate_pinch(pinch(OTHER), 0.3, ramp(2.0), DT, load_pinch_state(tmp_path / "half.npz"))
    assert rest.end.moving.place.tobytes() == whole.end.moving.place.tobytes()
    assert rest.end.second.linear.tobytes() == whole.end.second.linear.tobytes()
    (tmp_path / "none.npz").write_bytes(b"")
    with pytest.raises(UserError, match="no state of a pinch"):
        load_pinch_state(tmp_path / "none.npz")


def _record(run: PinchRun, its: Pinch) -> PinchRecord:
    fields = (dome_forces(its.first, run.end.first), dome_forces(its.second, run.end.second))
    return follow_pinch(PinchRecord(), its, run.end, fields, Limits())


def test_outcomes() -> None:
    its = pinch(body=box_body(MASS, SIZE, (0.0, 1e-3, 0.0)))
    held = _record(simulate_pinch(its, 0.5, ramp(2.0), DT), its)
    assert held.outcome(Limits()) == "held"
    assert held.slide < 0.1e-3  # of a sag of .15 mm
    assert 0.5 * held.elastic < held.turn < 0.0
    assert held.outcome(Limits(pressure=0.9 * held.pressure)) == "crushed"
    assert _record(simulate_pinch(its, 0.5, ramp(0.1), DT), its).outcome(Limits()) == "dropped"
    aside = pinch(body=box_body(MASS, SIZE, (0.0, 9e-3, 0.0)))
    turned = _record(simulate_pinch(aside, 0.5, ramp(1.0), DT), aside)
    assert turned.outcome(Limits()) == "turned"


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"drag": 0.0}, "drag of the drive"),
        ({"gravity": (0.0, 0.0, 0.0)}, "stands on no table"),
        ({"solid": Solid(shape=plane())}, "object with an end"),
    ],
)
def test_what_makes_no_pinch_is_refused(changes: dict[str, object], sentence: str) -> None:
    with pytest.raises(UserError, match=sentence):
        replace(pinch(), **changes)  # type: ignore[arg-type]
