"""Contact of a dome against analysis, conservation, symmetry and independent methods."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from chromagrip.model import (
    ConvergenceError,
    Dome,
    Motion,
    Solid,
    dome_forces,
    limit_margin,
    press_and_move,
    simulate_contact,
    solid_stiffness,
)
from chromagrip.model.dome.dome import lattice
from chromagrip.model.dome.solid import touched
from chromagrip.model.dome.stepper import Stepper, displacements
from chromagrip.model.kernels.dome.dahl_vector_kernels import dahl_vector
from chromagrip.model.kernels.dome.touch_kernels import Pose, Stiffening, touch
from chromagrip.model.kernels.friction import dahl_step
from chromagrip.model.shapes import Shape, ball, cylinder, plane, torus

FIXTURES = Path(__file__).parents[3] / "fixtures"
COARSE = Dome(pitch=0.7e-3, reach=math.radians(45.0))
#: Nearly a half space under its small contact.
THICK = Dome(
    core=0.6e-3, young=1e6, poisson=0.49, pitch=0.2e-3, reach=math.radians(20.0), stiffening=False
)


def _dahl(
    old: tuple[float, float], slip: tuple[float, float], limit: float, n: float
) -> np.ndarray:
    out = np.empty(8)
    dahl_vector(*old, *slip, limit, 50.0, n, False, out)
    return out


@given(
    force=st.floats(-1.5, 1.5),
    slip=st.floats(-0.2, 0.2).filter(lambda s: abs(s) > 1e-6),
    limit=st.floats(0.1, 2.0),
    n=st.sampled_from([0.0, 0.5, 0.7, 1.0, 1.5]),
    angle=st.floats(0.0, 6.28),
)
def test_in_one_line_friction_is_that_of_the_chain(
    force: float, slip: float, limit: float, n: float, angle: float
) -> None:
    c, s = math.cos(angle), math.sin(angle)
    expected, _ = dahl_step(force, slip, limit, 1.0, 50.0, n)
    found = _dahl((force * c, force * s), (slip * c, slip * s), limit, n)[:2]
    assert found == pytest.approx([expected * c, expected * s], abs=1e-9)


@given(
    old=st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
    slip=st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)),
    limit=st.floats(0.1, 2.0),
    n=st.sampled_from([0.0, 0.7, 1.0]),
)
def test_friction_stays_in_the_cone(
    old: tuple[float, float], slip: tuple[float, float], limit: float, n: float
) -> None:
    assert np.hypot(*_dahl(old, slip, limit, n)[:2]) <= limit * (1.0 + 1e-12)


@settings(max_examples=50)
@given(
    old=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    slip=st.tuples(st.floats(0.002, 0.01), st.floats(-0.01, 0.01)),
)
def test_the_tangent_is_the_derivative(old: tuple[float, float], slip: tuple[float, float]) -> None:
    step = 1e-7
    out = _dahl(old, slip, 1.0, 0.7)
    for k in range(2):
        moved = [slip[0] + step * (k == 0), slip[1] + step * (k == 1)]
        slope = (_dahl(old, (moved[0], moved[1]), 1.0, 0.7)[:2] - out[:2]) / step
        assert slope == pytest.approx(out[[2 + k, 4 + k]], abs=2e-2)
    by_limit = (_dahl(old, slip, 1.0 + step, 0.7)[:2] - out[:2]) / step
    assert by_limit == pytest.approx(out[6:], abs=2e-3)


@pytest.fixture(scope="module")
def rigid_press() -> tuple[Solid, Motion]:
    """A rigid plane without friction, 0.1 mm deep, which then twists."""
    solid = Solid(
        shape=plane(), stiffness=1e12, friction=1e-9, dahl_stiffness=1e12, dahl_exponent=0.0
    )
    return solid, press_and_move(0.1e-3, twist=0.4)


@pytest.mark.elements
def test_hertz(rigid_press: tuple[Solid, Motion]) -> None:
    """F = 4/3·E*·√R·d^1.5 and a² = R·d; this finite dome is some per cent stiffer.

    How much, is known from finite elements (`fixtures/hyperelastic`).
    """
    solid, _ = rigid_press
    fine = replace(THICK, pitch=0.14e-3)
    run = simulate_contact(fine, solid, press_and_move(0.1e-3), 0.01, keep=10)
    modulus = fine.young / (1.0 - fine.poisson**2)
    for state, finite in zip(run.states[3::3], (1.0578, 1.0761, 1.0914), strict=True):
        depth = 1e-3 * state.time
        field = dome_forces(fine, state)
        hertz = 4.0 / 3.0 * modulus * math.sqrt(fine.radius) * depth**1.5
        assert field.total_normal == pytest.approx(finite * hertz, rel=0.01)
        touching = lattice(fine).areas[field.contact].sum()
        radius = math.sqrt(touching / math.pi)
        assert radius == pytest.approx(math.sqrt(fine.radius * depth), abs=fine.spacing)


@pytest.mark.parametrize(
    ("case", "law", "low", "high", "error"),
    [
        # From two nodes' radius on; too wide a load for a node would make them stiffer.
        ("8/6 nu 0.48 plane slip", "linear", 0.1, 0.4, 0.04),
        ("8/6 nu 0.48 ball 5 slip", "linear", 0.1, 0.4, 0.04),
        # From .3 to .6 of the silicone; shallower contacts are a few nodes wide.
        ("8/6 nu 0.48 plane slip", "hyperelastic", 0.3, 0.6, 0.05),
        ("12/9 nu 0.49 plane slip", "hyperelastic", 0.3, 0.6, 0.05),
        ("14/9.8 nu 0.485 ball 30 slip", "hyperelastic", 0.3, 0.6, 0.05),
    ],
)
def test_forces_at_depths_are_those_of_finite_elements(
    case: str, law: str, low: float, high: float, error: float
) -> None:
    found = json.loads((FIXTURES / "hyperelastic" / "presses.json").read_text(encoding="utf-8"))
    press = found["cases"][case]
    dome = Dome(
        radius=1e-3 * press["radius"], core=1e-3 * press["core"], poisson=press["nu"],
        reach=math.radians(50.0), stiffening=law != "linear",
    )  # fmt: skip
    shape = plane() if press["ball"] is None else ball(1e-3 * press["ball"])
    smooth = Solid(shape=shape, stiffness=1e12, friction=1e-6, dahl_stiffness=1e11)
    motion = press_and_move(high * dome.thickness, press_s=0.04 * high)
    run = simulate_contact(dome, smooth, motion, 1e-3, keep=1)
    compared = 0
    for share, force in zip(found["depths"], press[law]["force"], strict=True):
        if low <= share <= high:
            compared += 1
            (step,) = np.flatnonzero(np.isclose(run.times, 0.04 * share))
            expected = force * 1e-6 * dome.young
            assert -run.total_forces[step, 2] == pytest.approx(expected, rel=error)
    assert compared >= 3


def test_torsion_and_partial_slip(rigid_press: tuple[Solid, Motion]) -> None:
    """Full slip has 3π/16·µ·P·a; under a shift, c/a = (1 − Q/µP)^⅓ sticks (Cattaneo–Mindlin)."""
    smooth, twist = rigid_press
    solid = Solid(
        shape=plane(), stiffness=1e12, friction=0.5, dahl_stiffness=1e11, dahl_exponent=0.0
    )
    pressed = simulate_contact(THICK, smooth, twist, 0.01, keep=21).states[9]
    assert pressed.time == pytest.approx(0.1)
    end = simulate_contact(THICK, solid, twist, 5e-3, start=pressed, keep=1).end
    normal = dome_forces(THICK, end).total_normal
    modulus = THICK.young / (1.0 - THICK.poisson**2)
    a = (0.75 * normal * THICK.radius / modulus) ** (1.0 / 3.0)
    torque = dome_forces(THICK, end).torque((0.0, 0.0, 1.0))
    assert torque == pytest.approx(3.0 * math.pi / 16.0 * 0.5 * normal * a, rel=0.03)
    assert limit_margin(THICK, solid, end) == pytest.approx(0.0, abs=1e-3)
    shift = press_and_move(0.1e-3, shift=(110e-6, 0.0))
    run = simulate_contact(THICK, solid, shift, 2.5e-3, start=pressed, keep=40)
    seen = 0
    for state in run.states:
        field = dome_forces(THICK, state)
        share = field.total_friction / (0.5 * field.total_normal)
        if not 0.3 < share < 0.95:
            continue
        seen += 1
        friction = np.linalg.norm(field.friction, axis=1)
        sticks = field.contact & (friction < 0.995 * 0.5 * field.normal)
        c = math.sqrt(lattice(THICK).areas[sticks].sum() / math.pi)
        assert c == pytest.approx(a * (1.0 - share) ** (1.0 / 3.0), abs=THICK.spacing)
    assert seen > 5


@pytest.mark.parametrize("stiffness", [1e8, 1e13])
def test_any_stiffness_converges(stiffness: float) -> None:
    solid = Solid(shape=plane(), stiffness=stiffness, dahl_stiffness=min(max(stiffness, 5e9), 1e11))
    motion = press_and_move(0.4e-3, shift=(0.4e-3, 0.0), twist=0.3)
    run = simulate_contact(COARSE, solid, motion, 5e-3)
    assert run.rounds.mean() < 6.0
    assert run.unconverged == 0


def test_a_free_ball_comes_to_rest_with_its_weight() -> None:
    motion = Motion(
        times=np.array([0.0, 0.4]), poses=np.zeros((2, 6)),
        free=("x", "y", "z", "rx", "ry", "rz"), mass=0.05, inertia=(1e-6,) * 3,
        drag=(1.0, 1.0, 1.0, 1e-4, 1e-4, 1e-4), gravity=(0.0, 0.0, -9.81),
    )  # fmt: skip
    run = simulate_contact(COARSE, Solid(shape=ball(5e-3)), motion, 4e-3)
    assert -run.total_forces[-1, 2] == pytest.approx(0.05 * 9.81, rel=1e-3)
    steady = run.total_forces[-10:]
    assert np.ptp(steady, axis=0).max() < 1e-4


def test_a_force_is_reached_on_a_free_axis() -> None:
    loads = np.zeros((3, 6))
    loads[1:, 2] = -1.5
    motion = Motion(
        times=np.array([0.0, 0.1, 0.3]), poses=np.zeros((3, 6)), free=("z",), loads=loads,
        drag=(0.0, 0.0, 5.0, 0.0, 0.0, 0.0),
    )  # fmt: skip
    for solid in (Solid(shape=plane()), Solid(shape=plane(), stiffness=1e12)):
        run = simulate_contact(COARSE, solid, motion, 4e-3)
        assert -run.total_forces[-1, 2] == pytest.approx(1.5, rel=1e-4)


def test_viscosity_slows_the_skin_and_is_gone_at_rest() -> None:
    """Kelvin–Voigt: more force while it is pressed, the elastic one after many time constants."""
    motion = Motion(
        times=np.array([0.0, 0.05, 0.4]),
        poses=np.array([[0.0] * 6, [0, 0, -0.4e-3, 0, 0, 0], [0, 0, -0.4e-3, 0, 0, 0]]),
    )
    common = {"pitch": 0.7e-3, "reach": math.radians(45.0)}
    slow = simulate_contact(Dome(relaxation=0.03, **common), Solid(shape=plane()), motion, 5e-3)
    quick = simulate_contact(Dome(**common), Solid(shape=plane()), motion, 5e-3)
    assert slow.total_forces[9, 2] < 1.1 * quick.total_forces[9, 2] < 0.0
    assert slow.total_forces[-1, 2] == pytest.approx(quick.total_forces[-1, 2], rel=0.01)


def test_forces_add_up_to_the_totals() -> None:
    run = simulate_contact(
        COARSE, Solid(shape=ball(10e-3)), press_and_move(0.4e-3, shift=(0.2e-3, 0.0)), 5e-3
    )
    assert solid_stiffness(200e3) == pytest.approx(1e9, rel=0.01)  # as the chain's object
    field = dome_forces(COARSE, run.end)
    torque = [field.torque(axis) for axis in np.eye(3)]
    assert torque == pytest.approx(run.total_torques[-1], abs=1e-9)
    assert 0.0 < field.safety_margin(0.5) < 1.0
    assert limit_margin(COARSE, run.solid, run.end) <= field.safety_margin(0.5) + 1e-6


@pytest.mark.parametrize("shape", [ball(3e-3), torus(4e-3, 0.5e-3), cylinder(2e-3, 6e-3, 0.5e-3)])
def test_the_slope_of_a_node_is_its_derivative(shape: Shape) -> None:
    """On curved objects, by differences: the normal turns, and the friction with it and the object.

    An object that turns in the step moves the place that a node's slip is counted from.
    """
    solid = Solid(shape=shape, stiffness=1e9, dahl_stiffness=2e8, dahl_exponent=0.5)
    still = np.eye(3)
    down = np.array([0.0, 0.0, shape.reach_down()])
    before = Rotation.from_rotvec([0.0, 0.0, -0.5]).as_matrix()
    pose = Pose(before, down + np.array([2e-5, 1e-5, 4e-5]), still, down)
    law = Stiffening(2.0, 1.4, 2e-3)

    def at(now: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        linear, slope = np.empty(3), np.empty((3, 3))
        assert touch(
            touched(solid), pose, law, 1.6e-7, np.array([1e-4, 2e-5, 6e-5]), now,
            2e-4 - now[2], np.array([0.0, 0.0, 1.0]), np.array([1e-4, -2e-4, 0.0]), False, False,
            True, np.empty(3), np.empty(11), linear, np.empty(3), slope, np.empty(2),
        )  # fmt: skip
        return linear, slope

    now = np.array([1e-4, 3e-5, 8e-5])
    _, slope = at(now)
    step = 1e-8
    for k in range(3):
        move = step * np.eye(3)[k]
        change = (at(now + move)[0] - at(now - move)[0]) / (2.0 * step)
        assert change == pytest.approx(slope[:, k], abs=0.02 * abs(slope).max())


def test_a_skin_that_creeps_comes_to_the_same_rest() -> None:
    """A step of a ball by creeping, as over an edge, and a plain one: the same equilibrium."""
    solid = Solid(shape=ball(5e-3), friction=0.5)
    motion = press_and_move(0.4e-3, shift=(0.1e-3, 0.0), press_s=0.02, move_s=0.02)
    start = simulate_contact(COARSE, solid, motion, 1e-3, keep=40).states[24]
    ends = []
    for step in (Stepper.advance, Stepper._creep):
        stepper = Stepper(COARSE, solid, motion, start)
        count = step(stepper, start.time + 1e-3)
        assert count.unconverged == 0
        state = stepper.state()
        elastic = displacements(COARSE, state)[state.near]
        assert state.displacement[state.near] == pytest.approx(elastic, abs=1e-8)
        assert not state.memory.any()
        ends.append(state.forces)
    assert ends[1] == pytest.approx(ends[0], abs=0.03 * abs(ends[0]).max())


def test_a_rigid_object_is_never_said_not_to_touch() -> None:
    """A node's own Newton hops out of a rigid object, which once counted as no contact."""
    dome = Dome(pitch=0.6e-3, reach=math.radians(45.0))
    solid = Solid(shape=ball(10e-3), stiffness=1e13, dahl_stiffness=5e13, dahl_exponent=0.0)
    try:
        run = simulate_contact(dome, solid, press_and_move(0.4e-3), 0.1)
    except ConvergenceError:
        return  # it says so
    assert run.total_forces[-1, 2] < -0.5
