import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from chromagrip.model.kernels.friction import dahl_path, dahl_step, dahl_tangent

NORMAL, MU, SIGMA = 0.03, 0.5, 5000.0
LIMIT = MU * NORMAL

forces = st.floats(-LIMIT, LIMIT)
slips = st.floats(-5e-5, 5e-5)
exponents = st.sampled_from([0.5, 0.7, 1.0, 1.5])


def dahl_ode(force: float, slip: float, exponent: float) -> float:
    """The Dahl equation (thesis Eq. 5) integrated with small steps."""
    sign = math.copysign(1.0, slip)

    def rate(_: float, f: np.ndarray) -> np.ndarray:
        z = 1.0 - sign * f / LIMIT
        return sign * SIGMA * np.abs(z) ** exponent * np.sign(z)

    solution = solve_ivp(rate, (0.0, abs(slip)), [force], rtol=1e-10, atol=1e-14, max_step=1e-7)
    return float(solution.y[0, -1])


@pytest.mark.parametrize("exponent", [0.5, 0.7, 1.0, 1.5])
@pytest.mark.parametrize(("start", "slip"), [(-0.8, -2e-6), (-0.8, 4e-6), (0.6, 1e-6)])
def test_closed_form_solves_the_dahl_equation(exponent: float, start: float, slip: float) -> None:
    end, _ = dahl_step(start * LIMIT, slip, NORMAL, MU, SIGMA, exponent)
    assert end == pytest.approx(dahl_ode(start * LIMIT, slip, exponent), abs=2e-5 * LIMIT)


@given(forces, slips, exponents)
def test_never_leaves_the_cone(force: float, slip: float, exponent: float) -> None:
    end, secant = dahl_step(force, slip, NORMAL, MU, SIGMA, exponent)
    assert abs(end) <= LIMIT * (1 + 1e-12)
    assert secant >= 0.0


@given(forces, st.floats(1e-9, 2e-5), st.floats(0.05, 0.95), exponents)
def test_one_step_equals_two_in_the_same_direction(
    force: float, slip: float, share: float, exponent: float
) -> None:
    whole, _ = dahl_step(force, slip, NORMAL, MU, SIGMA, exponent)
    half, _ = dahl_step(force, share * slip, NORMAL, MU, SIGMA, exponent)
    parts, _ = dahl_step(half, (1 - share) * slip, NORMAL, MU, SIGMA, exponent)
    assert parts == pytest.approx(whole, abs=1e-9 * LIMIT)


def test_long_slip_reaches_coulomb() -> None:
    for exponent in (0.5, 0.7, 1.0):
        end, _ = dahl_step(0.0, 1e-3, NORMAL, MU, SIGMA, exponent)
        assert end == pytest.approx(LIMIT, rel=1e-9)


def test_unloading_clips_to_the_new_cone() -> None:
    end, _ = dahl_step(LIMIT, 0.0, NORMAL / 2, MU, SIGMA, 0.7)
    assert end == pytest.approx(LIMIT / 2)
    assert dahl_step(LIMIT, 1e-6, 0.0, MU, SIGMA, 0.7) == (0.0, 0.0)


@settings(max_examples=20)
@given(
    st.lists(st.tuples(slips, st.floats(0.2, 3.0)), min_size=1, max_size=12),
    exponents,
)
def test_a_closed_path_with_changing_normal_force_dissipates(
    path: list[tuple[float, float]], exponent: float
) -> None:
    force, before, work = 0.0, NORMAL, 0.0
    corners = [*path, (-sum(slip for slip, _ in path), 1.0)]
    for slip, load in corners:
        for k in range(200):
            normal = before + (load * NORMAL - before) / (200 - k)
            end, _ = dahl_path(force, slip / 200, before, normal, MU, SIGMA, exponent)
            assert abs(end) <= MU * normal * (1 + 1e-12)
            work += 0.5 * (force + end) * slip / 200
            force, before = end, normal
    turned = 3 * LIMIT * sum(abs(slip) for slip, _ in corners)
    assert work > -1e-2 * turned - (3 * LIMIT) ** 2 / SIGMA


@pytest.mark.parametrize("exponent", [0.5, 1.0, 1.5])
@pytest.mark.parametrize(("slip", "normal"), [(4e-6, NORMAL), (2e-5, NORMAL), (1e-6, NORMAL / 10)])
def test_first_contact_is_that_of_many_small_steps(
    slip: float, normal: float, exponent: float
) -> None:
    """A node that comes into contact within one step remembers what it would in a thousand."""
    many, before = 0.0, -normal / 2  # a third of the step to close the gap
    for k in range(1, 1001):
        now = -normal / 2 + 1.5 * normal * k / 1000
        many, _ = dahl_path(many, slip / 1000, before, now, MU, SIGMA, exponent)
        before = now
    once, _ = dahl_path(0.0, slip, -normal / 2, normal, MU, SIGMA, exponent)
    assert once == pytest.approx(many, abs=0.06 * MU * normal)


@pytest.mark.parametrize("exponent", [0.7, 1.0, 1.5])
@pytest.mark.parametrize("force", [-0.5, 0.0, 0.8])
def test_tangent_is_the_slope_of_the_law(force: float, exponent: float) -> None:
    start = force * LIMIT
    end, _ = dahl_step(start, 1e-12, NORMAL, MU, SIGMA, exponent)
    tangent = dahl_tangent(start, 1e-12, NORMAL, MU, SIGMA, exponent)
    assert tangent == pytest.approx((end - start) / 1e-12, rel=1e-3)
