"""A pinch against analysis, conservation, symmetry and one dome alone."""

import json
import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipk

from chromagrip.model import Dome, Motion, Solid, dome_forces, simulate_contact, torsion
from chromagrip.model.pinch import (
    Filling,
    HandPath,
    Limits,
    Pinch,
    PinchRecord,
    PinchRun,
    RigidBody,
    Shake,
    box_body,
    follow_pinch,
    pinch_rest,
    simulate_pinch,
)
from chromagrip.model.shapes import ball, box, plane

FIXTURES = Path(__file__).parents[3] / "fixtures"
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


def test_a_body_that_is_filled_as_it_falls() -> None:
    """d(m·v)/dt = m·g with m = m₀·(1 + k·t) has v = g·(t + k·t²/2)/(1 + k·t)."""
    k, duration = 10.0, 0.2
    filling = Filling(times=(0.0, 1.0), masses=(0.0, k * MASS))
    free = pinch(table=False, hand=HandPath(), friction=1e-6, filling=filling)
    run = simulate_pinch(free, duration, lambda _: 0.0, DT)
    velocity = G * (run.times + 0.5 * k * run.times**2) / (1.0 + k * run.times)
    place = np.array([each.place[0] for each in run.moving])
    found = np.diff(place) / DT
    assert found[5:] == pytest.approx(0.5 * (velocity[1:] + velocity[:-1])[5:], rel=5e-3)
    late = run.moving[-1].momentum[0] / (MASS * (1.0 + k * duration))
    assert late == pytest.approx(velocity[-1], rel=1e-2)
    assert velocity[-1] < 0.8 * G * duration  # what is added at rest holds it back


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


@pytest.fixture(scope="module")
def swung() -> tuple[np.ndarray, np.ndarray, float, float]:
    """A body that swings on a small ball between nearly rigid fingertips.

    Returns
    -------
    Times since it was let go [s], angles from straight down [rad], the period of small swings [s],
    and the torsion that friction bears over the normal force [m].
    """
    arm, mass, own, start = 10e-3, 0.01, 1e-6, math.radians(80.0)
    dome = Dome(young=40e6, pitch=0.2e-3, reach=math.radians(20.0), stiffening=False)
    body = RigidBody(
        mass=mass, inertia=(own,) * 3, centre=(arm * math.cos(start), arm * math.sin(start), 0.0)
    )
    solid = Solid(shape=ball(1e-3), friction=1.0, stiffness=1e11, dahl_stiffness=5e11)
    free = Pinch(first=dome, second=dome, solid=solid, body=body, table=False)
    rest = simulate_pinch(
        replace(free, gravity=(0.0, 0.0, 0.0)), 0.1, lambda t: 0.15 * min(1.0, t / 0.08), DT
    ).end
    run = simulate_pinch(free, 0.7, lambda _: 0.15, DT, rest)
    small = 2.0 * math.pi * math.sqrt((own + mass * arm**2) / (mass * G * arm))
    field = dome_forces(dome, rest.first)
    return run.times - 0.1, run.turns + start, small, torsion(field)[2] / field.total_normal


def _halves(times: np.ndarray, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Durations of the half swings, and their amplitudes."""
    k = np.flatnonzero(angles[:-1] * angles[1:] <= 0.0)
    crossed = times[k] - angles[k] * (times[k + 1] - times[k]) / (angles[k + 1] - angles[k])
    return np.diff(crossed), np.array([abs(angles[a:b]).max() for a, b in pairwise(k)])


def test_a_swing_about_the_axis_has_the_period_of_a_pendulum(
    swung: tuple[np.ndarray, np.ndarray, float, float],
) -> None:
    times, angles, small, _ = swung
    halves, tops = _halves(times, angles)
    assert len(halves) >= 2
    assert tops[0] > math.radians(70.0)  # far from small swings, whose period is 12 % less
    assert halves == pytest.approx(small / math.pi * ellipk(np.sin(tops / 2.0) ** 2), rel=0.03)


def test_the_swing_is_that_of_another_engine(
    swung: tuple[np.ndarray, np.ndarray, float, float],
) -> None:
    """MuJoCo with rigid fingers, and the torsion that our contact bears."""
    times, angles, _, length = swung
    theirs = json.loads((FIXTURES / "pinch" / "mujoco.json").read_text(encoding="utf-8"))
    at = [1e-3 * swing["torsion_mm"] for swing in theirs["swings"]]
    halves, tops = _halves(times, angles)
    for k, (half, top) in enumerate(zip(halves, tops, strict=True)):
        durations = [np.diff(swing["crossed_s"])[k] for swing in theirs["swings"]]
        assert half == pytest.approx(np.interp(length, at, durations), rel=0.03)
        angles_there = [math.radians(swing["tops_deg"][k]) for swing in theirs["swings"]]
        assert top == pytest.approx(np.interp(length, at, angles_there), rel=0.03)
    for slide in theirs["slides"]:  # what we are held to below
        held = 2.0 * slide["friction"] * slide["grip_n"] / 0.01
        assert slide["acceleration"] == pytest.approx(G - held, rel=0.01)


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
    for dt in (4e-3, 2e-3):
        rotation, after = _tumbled(dt)
        assert after == pytest.approx(spin, rel=1e-12)
        off.append(abs(rotation.ravel() - exact).max())
    assert off[0] < 1e-3
    assert off[0] / off[1] == pytest.approx(4.0, rel=0.1)


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


def _record(run: PinchRun, its: Pinch) -> PinchRecord:
    fields = (dome_forces(its.first, run.end.first), dome_forces(its.second, run.end.second))
    return follow_pinch(PinchRecord(), its, run.end, fields, Limits())


def test_a_shake_grows_in_its_first_period_and_fades_in_its_last() -> None:
    """At the peaks of its sine, with 10·s³ − 15·s⁴ + 6·s⁵ of the share s of a period."""
    shake = Shake(amplitude=(0.0, 2e-3, 0.0), frequency=5.0, start=0.2, stop=0.8)
    shares = np.array([0.25, 0.75, 1.0, 1.0, 0.75, 0.25])
    smooth = 10.0 * shares**3 - 15.0 * shares**4 + 6.0 * shares**5
    tops = [shake.at(0.2 + (k + 0.5) * 0.1)[1] for k in range(6)]
    assert tops == pytest.approx(2e-3 * smooth * [1, -1, 1, -1, 1, -1], rel=1e-9)
    assert not shake.at(0.2).any()
    assert not shake.at(0.8).any()


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
