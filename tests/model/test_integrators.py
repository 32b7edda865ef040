"""Methods against each other, against their order, and where they fail."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks.model.integrators import explicit_limit, integrate
from chromagrip.model import (
    ContactObject,
    Drive,
    Fingertip,
    History,
    ModelError,
    contact_forces,
    equilibrium,
    simulate,
)
from chromagrip.model.chain import plant

SMALL = Fingertip(nodes=21)
ROUND = ContactObject(stiffness=300.0, curvature=50.0)
#: Heavily damped, so that explicit steps are long enough to show their order.
SLOW = Fingertip(nodes=21, damping_node=20.0, damping_rigid=20.0)


def press_and_pull(duration: float, grip: float = 1.0, load: float = 0.1) -> Drive:
    t = np.linspace(0.0, duration, 201)
    rise = np.sin(0.5 * np.pi * t / duration) ** 2
    return Drive(times=t, normal=grip * rise, lateral=load * rise)


def end(run: History) -> np.ndarray:
    return run.nodes[-1]


@pytest.mark.parametrize(("method", "dt", "error"), [("euler", 2e-6, 1e-3), ("bdf", 1e-3, 2e-4)])
def test_independent_dense_methods_reach_the_same_state(
    method: str, dt: float, error: float
) -> None:
    """The baseline shares parameters with the implicit step, but neither matrix nor integrator."""
    drive, every = press_and_pull(2e-3), round(2e-3 / dt)
    found = integrate(method, SMALL, ROUND, drive, dt=dt, duration=2e-3, every=every)
    fine = simulate(SMALL, ROUND, drive, dt=1e-6, duration=2e-3, every=2000)
    assert end(found) == pytest.approx(end(fine), abs=error * abs(end(fine)).max())
    forces = [contact_forces(SMALL, ROUND, run.state(-1)) for run in (found, fine)]
    assert forces[0].friction.sum() == pytest.approx(forces[1].friction.sum(), abs=2e-4)
    assert forces[0].total_normal == pytest.approx(forces[1].total_normal, rel=1e-3)


@pytest.mark.parametrize("law", ["inverse-poisson", "axial"])
def test_every_spring_law_is_the_same_in_both_codes(law: str) -> None:
    tip = replace(SMALL, law=law)
    drive = press_and_pull(2e-3)
    found = integrate("euler", tip, ROUND, drive, dt=2e-6, duration=2e-3, every=1000)
    fine = simulate(tip, ROUND, drive, dt=2e-6, duration=2e-3, every=1000)
    assert end(found) == pytest.approx(end(fine), abs=2e-3 * abs(end(fine)).max())


def test_a_step_that_is_taken_in_parts_has_the_mean_rates_of_the_whole(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Few rounds of Newton's method are too few for a long step, which is then halved."""
    divided, in_parts = [], plant._in_parts
    monkeypatch.setattr(plant, "_in_parts", lambda *its: divided.append(in_parts(*its)))
    monkeypatch.setattr(plant, "IMPLICIT", plant.IMPLICIT._replace(max_iterations=4))
    run = simulate(SMALL, ROUND, press_and_pull(0.05), dt=1e-2, duration=0.05)
    assert divided
    moved = np.concatenate([run.nodes, run.pose[:, None]], axis=1)
    assert run.rate[1:] == pytest.approx(np.diff(moved, axis=0) / 1e-2, abs=1e-9)
    monkeypatch.undo()
    whole = simulate(SMALL, ROUND, press_and_pull(0.05), dt=1e-2, duration=0.05)
    assert end(run) == pytest.approx(end(whole), abs=0.01 * abs(end(whole)).max())


@pytest.mark.stages
@pytest.mark.parametrize(
    ("method", "order", "dt", "speed"),
    [
        ("implicit", 2, 1e-2, 20.0),
        ("lagged", 1, 2e-3, 20.0),
        ("euler", 1, 5e-4, 20.0),
        ("rk4", 4, 2e-4, 200.0),
    ],
)
def test_error_falls_at_the_order_of_the_method(
    method: str, order: int, dt: float, speed: float
) -> None:
    """A smooth swing at that speed [rad/s]: the contact stays as it is, with next to no friction.

    The swing is solved by Runge's and Kutta's method with small steps.
    """
    obj = ContactObject(stiffness=500.0, curvature=50.0, friction=1e-12)
    start = replace(equilibrium(SLOW, obj, 2.0), friction=np.zeros(SLOW.nodes))
    t = np.linspace(0.0, 4.0 / speed, 20001)
    drive = Drive(times=t, normal=2.0 + 0.03 * np.sin(speed * t) ** 3, lateral=0.0 * t)

    def swung(how: str, dt: float) -> np.ndarray:
        steps = round(t[-1] / dt)
        run = integrate(how, SLOW, obj, drive, dt=dt, duration=t[-1], every=steps, state=start)
        return end(run)

    truth = swung("rk4", 4e-3 / speed)
    errors = [abs(swung(method, part) - truth).max() for part in (dt, 0.5 * dt)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.4)


def test_an_explicit_method_diverges_beyond_its_predicted_limit_and_not_below() -> None:
    limit = explicit_limit(Fingertip(), ContactObject())
    assert limit == pytest.approx(2 / 5e5, rel=0.1)  # row sums of some 50 kN/m over the damping
    dt, drive = explicit_limit(SMALL, ROUND), Drive.constant(0.2)
    below = integrate("euler", SMALL, ROUND, drive, dt=0.9 * dt, duration=900 * dt, every=1000)
    assert abs(end(below)).max() < 1e-3
    with pytest.raises(ModelError, match=f"up to {dt:.3g} s"):
        integrate("euler", SMALL, ROUND, drive, dt=1.3 * dt, duration=6500 * dt, every=10)


@pytest.mark.parametrize("method", ["implicit", "lagged"])
def test_with_contact_and_friction_the_error_falls_at_first_order(method: str) -> None:
    """Below 0.1 ms; above it the default errs less than that line, by its parts of a step."""
    truth = pulled_end(2e-6, "implicit")
    errors = [abs(pulled_end(dt, method) - truth).max() for dt in (1e-3, 1e-4, 1e-5)]
    assert np.log10(errors[1] / errors[2]) > 0.85
    assert errors[0] < 1e-6  # of 100 µm


@cache
def pulled_end(dt: float, method: str) -> np.ndarray:
    tip, obj = Fingertip(nodes=51), ContactObject(curvature=50.0)
    drive = press_and_pull(0.1, 2.0, 0.3)
    return end(integrate(method, tip, obj, drive, dt=dt, duration=0.1, every=round(0.1 / dt)))


def test_a_position_is_followed_and_costs_the_force_that_reaches_it() -> None:
    tip, obj = Fingertip(nodes=51), ContactObject()
    by_force = equilibrium(tip, obj, 2.0)
    depth = by_force.deformation.rigid_part
    t = np.array([0.0, 0.05, 0.5])
    drive = Drive(
        times=t, normal=np.array([0.0, depth, depth]), lateral=np.zeros(3),
        normal_control="position", lateral_control="position",
    )  # fmt: skip
    run = simulate(tip, obj, drive, dt=1e-3, duration=0.5, every=500)
    assert run.pose[-1] == pytest.approx([depth, 0.0], abs=1e-15)
    assert contact_forces(tip, obj, run.state(-1)).normal.sum() == pytest.approx(2.0, rel=2e-3)


def test_a_time_given_twice_is_a_jump() -> None:
    drive = Drive(times=[0.0, 1.0, 1.0, 2.0], normal=[0.0, 1.0, 5.0, 7.0], lateral=[0, 0, 0, 0])
    assert drive.at(np.array([0.5, 1.0, 1.5, 9.0]))[:, 0] == pytest.approx([0.5, 5.0, 6.0, 7.0])
