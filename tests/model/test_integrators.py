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
    LostContactError,
    ModelError,
    PiercedError,
    State,
    contact_forces,
    equilibrium,
    simulate,
)

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


@cache
def fine_press() -> History:
    """What the dense methods are compared with."""
    return simulate(SMALL, ROUND, press_and_pull(4e-3), dt=1e-6, duration=4e-3, every=4000)


@pytest.mark.parametrize(
    ("method", "dt", "error"),
    [("euler", 2e-6, 1e-3), ("rk45", 1e-3, 2e-4), ("lsoda", 1e-3, 2e-4), ("bdf", 1e-3, 2e-4)],
)
def test_independent_dense_methods_reach_the_same_state(
    method: str, dt: float, error: float
) -> None:
    """The baseline shares parameters with the implicit step, but neither matrix nor integrator."""
    drive = press_and_pull(4e-3)
    found = integrate(method, SMALL, ROUND, drive, dt=dt, duration=4e-3, every=round(4e-3 / dt))
    fine = fine_press()
    moved = abs(end(fine)).max()
    assert end(found) == pytest.approx(end(fine), abs=error * moved)
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


@pytest.mark.stages
@pytest.mark.parametrize(
    ("method", "order", "steps", "speed"),
    [
        ("implicit", 2, (1e-2, 5e-3), 20.0),
        ("lagged", 1, (2e-3, 1e-3), 20.0),
        ("euler", 1, (5e-4, 2.5e-4), 20.0),
        ("rk4", 4, (2e-4, 1e-4), 200.0),
    ],
)
def test_error_falls_at_the_order_of_the_method(
    method: str, order: int, steps: tuple[float, float], speed: float
) -> None:
    """A smooth problem: the contact stays as it is, with next to no friction."""
    truth = smooth_end(speed, 4e-3 / speed, "rk4")
    errors = [abs(smooth_end(speed, dt, method) - truth).max() for dt in steps]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.4)


@cache
def smooth_end(speed: float, dt: float, method: str) -> np.ndarray:
    """Nodes at the end of a smooth swing at that speed [rad/s]."""
    obj = ContactObject(stiffness=500.0, curvature=50.0, friction=1e-12)
    start = replace(equilibrium(SLOW, obj, 2.0), friction=np.zeros(SLOW.nodes))
    span = 4.0 / speed
    t = np.linspace(0.0, span, 20001)
    drive = Drive(times=t, normal=2.0 + 0.03 * np.sin(speed * t) ** 3, lateral=np.zeros(20001))
    every = round(span / dt)
    return end(integrate(method, SLOW, obj, drive, dt=dt, duration=span, every=every, state=start))


@pytest.mark.parametrize("method", ["implicit", "lagged"])
def test_with_contact_and_friction_the_error_falls_at_first_order(method: str) -> None:
    """Below 0.1 ms; above it the default errs less than that line, by its parts of a step."""
    tip = Fingertip(nodes=51)
    drive = press_and_pull(0.1, 2.0, 0.3)
    obj = ContactObject(curvature=50.0)

    def final(dt: float, how: str = method) -> np.ndarray:
        return end(integrate(how, tip, obj, drive, dt=dt, duration=0.1, every=round(0.1 / dt)))

    truth = final(1e-6, "implicit")
    errors = [abs(final(dt) - truth).max() for dt in (1e-3, 1e-4, 1e-5)]
    assert np.log10(errors[1] / errors[2]) > 0.85
    assert errors[0] < 1e-6  # of 100 µm


def test_a_diverging_run_says_at_which_step_and_what_was_predicted() -> None:
    dt = 1.3 * explicit_limit(SMALL, ROUND)
    with pytest.raises(
        ModelError, match=rf"euler diverged at step \d\d+ .* up to {dt / 1.3:.3g} s"
    ):
        integrate("euler", SMALL, ROUND, Drive.constant(1.0), dt=dt, duration=5000 * dt, every=10)


@pytest.mark.stages
@pytest.mark.parametrize("method", ["euler", "rk4"])
def test_below_the_predicted_limit_explicit_runs_stay_bounded(method: str) -> None:
    dt = 0.9 * explicit_limit(SMALL, ROUND, method=method)
    drive = Drive.constant(0.2)
    run = integrate(method, SMALL, ROUND, drive, dt=dt, duration=2500 * dt, every=2500)
    assert abs(end(run)).max() < 1e-3


def test_limit_is_that_of_the_rigid_part() -> None:
    """Its row sums to about 50 kN/m at 251 nodes, a rate of 5·10⁵ /s (facts)."""
    limit = explicit_limit(Fingertip(), ContactObject())
    assert limit == pytest.approx(2 / 5e5, rel=0.1)


def test_a_run_goes_on_from_a_state_bit_for_bit() -> None:
    tip, drive = Fingertip(nodes=51), press_and_pull(0.02, 2.0, 0.4)

    def run(steps: int, state: State | None = None) -> State:
        return simulate(
            tip, ROUND, drive, dt=1e-3, duration=steps * 1e-3, every=steps, state=state
        ).state(-1)

    whole, rest = run(20), run(12, run(8))
    assert rest.deformation.nodes.tobytes() == whole.deformation.nodes.tobytes()
    assert rest.friction.tobytes() == whole.friction.tobytes()
    assert rest.rate.tobytes() == whole.rate.tobytes()
    assert (rest.time, rest.step) == (pytest.approx(whole.time), whole.step)


def test_the_same_run_gives_the_same_bytes() -> None:
    runs = [simulate(SMALL, ROUND, press_and_pull(0.02), dt=1e-3, duration=0.02) for _ in range(2)]
    assert runs[0].nodes.tobytes() == runs[1].nodes.tobytes()


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


def test_a_load_without_contact_is_refused() -> None:
    with pytest.raises(LostContactError, match=r"load of 0\.5 N at t = 0\.001 s"):
        simulate(SMALL, ROUND, Drive.constant(0.0, 0.5), dt=1e-3, duration=1e-3)


def test_a_grip_that_no_force_of_the_object_carries_is_refused() -> None:
    soft_and_sharp = ContactObject(stiffness=80.0, curvature=200.0)
    with pytest.raises(PiercedError, match="went through the object"):
        simulate(Fingertip(nodes=101), soft_and_sharp, Drive.constant(30.0), dt=1e-3, duration=0.5)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"dt": 0.0}, "dt and duration must be finite and above 0 s"),
        ({"dt": 3e-3}, "whole number of recorded steps"),
    ],
)
def test_impossible_runs_are_named(changes: dict[str, object], words: str) -> None:
    settings = {"dt": 1e-3, "duration": 0.01} | changes
    with pytest.raises(ValueError, match=words):
        simulate(SMALL, ROUND, Drive.constant(1.0, 0.1), **settings)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"normal": [1.0]}, "as many values as times"),
        ({"normal": [1.0, np.nan]}, "drive normal must be finite"),
        ({"times": [1.0, 0.0]}, "must not decrease"),
        ({"normal_control": "speed"}, "must be force or position, got 'speed'"),
    ],
)
def test_impossible_drives_are_named(changes: dict[str, object], words: str) -> None:
    settings = {"times": [0.0, 1.0], "normal": [1.0, 1.0], "lateral": [0.0, 0.0]} | changes
    with pytest.raises(ValueError, match=words):
        Drive(**settings)  # type: ignore[arg-type]


def test_a_time_given_twice_is_a_jump() -> None:
    drive = Drive(times=[0.0, 1.0, 1.0, 2.0], normal=[0.0, 1.0, 5.0, 7.0], lateral=[0, 0, 0, 0])
    assert drive.at(np.array([0.5, 1.0, 1.5, 9.0]))[:, 0] == pytest.approx([0.5, 5.0, 6.0, 7.0])
