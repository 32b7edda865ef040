"""Methods against each other, against their order, and where they fail."""

import pickle
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from chromagrip.errors import UserError
from chromagrip.model import (
    ContactObject,
    DivergedError,
    Drive,
    Fingertip,
    History,
    LostContactError,
    PiercedError,
    State,
    contact_forces,
    equilibrium,
    explicit_limit,
    load_state,
    rest_state,
    save_state,
    simulate,
)
from chromagrip.model.chain.assembly import Chain
from chromagrip.model.chain.plant import Implicit
from chromagrip.model.kernels.contact import Contact

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
    found = simulate(
        SMALL, ROUND, drive, dt=dt, duration=4e-3, every=round(4e-3 / dt), method=method
    )
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
    found = simulate(tip, ROUND, drive, dt=2e-6, duration=2e-3, every=1000, method="euler")
    fine = simulate(tip, ROUND, drive, dt=2e-6, duration=2e-3, every=1000)
    assert end(found) == pytest.approx(end(fine), abs=2e-3 * abs(end(fine)).max())


@pytest.mark.slow
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
    """A smooth problem: the contact stays as it is, friction is left out."""
    truth = smooth_end(speed, 4e-3 / speed, "rk4")
    errors = [abs(smooth_end(speed, dt, method) - truth).max() for dt in steps]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.4)


@cache
def smooth_end(speed: float, dt: float, method: str) -> np.ndarray:
    """Nodes at the end of a smooth swing at that speed [rad/s]."""
    obj = ContactObject(stiffness=500.0, curvature=50.0)
    start = equilibrium(SLOW, replace(obj, friction=1e-9), 2.0)
    start = replace(start, friction=np.zeros(SLOW.nodes))
    span = 4.0 / speed
    t = np.linspace(0.0, span, 20001)
    drive = Drive(times=t, normal=2.0 + 0.03 * np.sin(speed * t) ** 3, lateral=np.zeros(20001))
    run = simulate(
        SLOW, obj, drive, dt=dt, duration=span, every=round(span / dt), method=method,
        state=start, friction=False,
    )  # fmt: skip
    return end(run)


@pytest.mark.parametrize("method", ["implicit", "lagged"])
def test_with_contact_and_friction_the_error_falls_at_first_order(method: str) -> None:
    """Below 0.1 ms; above it the default errs less than that line, by its parts of a step."""
    tip = Fingertip(nodes=51)
    drive = press_and_pull(0.1, 2.0, 0.3)
    obj = ContactObject(curvature=50.0)

    def final(dt: float, how: str = method) -> np.ndarray:
        run = simulate(tip, obj, drive, dt=dt, duration=0.1, every=round(0.1 / dt), method=how)
        return end(run)

    truth = final(1e-6, "implicit")
    errors = [abs(final(dt) - truth).max() for dt in (1e-3, 1e-4, 1e-5)]
    assert np.log10(errors[1] / errors[2]) > 0.85
    assert errors[0] < 1e-6  # of 100 µm


def test_a_diverging_run_says_at_which_step_and_what_was_predicted() -> None:
    limit = explicit_limit(SMALL, ROUND, rest_state(SMALL))
    with pytest.raises(DivergedError, match=r"euler diverged at step \d+") as caught:
        simulate(
            SMALL, ROUND, Drive.constant(1.0), dt=1.3 * limit, duration=1.3 * limit * 5000,
            every=10, method="euler",
        )  # fmt: skip
    assert caught.value.limit == pytest.approx(limit)
    assert 10 < caught.value.step < 5000


@pytest.mark.slow
@pytest.mark.parametrize("method", ["euler", "rk4"])
def test_below_the_predicted_limit_explicit_runs_stay_bounded(method: str) -> None:
    limit = explicit_limit(SMALL, ROUND, rest_state(SMALL), method)
    dt = 0.9 * limit
    run = simulate(
        SMALL, ROUND, Drive.constant(0.2), dt=dt, duration=2500 * dt, every=2500, method=method
    )
    assert abs(end(run)).max() < 1e-3


def test_limit_is_that_of_the_rigid_part() -> None:
    """Its row sums to about 50 kN/m at 251 nodes, a rate of 5·10⁵ /s (facts)."""
    limit = explicit_limit(Fingertip(), ContactObject(), rest_state(Fingertip()))
    assert limit == pytest.approx(2 / 5e5, rel=0.1)


@pytest.mark.parametrize("method", ["implicit", "lagged"])
def test_a_saved_state_goes_on_bit_for_bit(method: str, tmp_path: Path) -> None:
    tip = Fingertip(nodes=51)
    drive = press_and_pull(0.02, 2.0, 0.4)

    def run(steps: int, state=None) -> History:  # type: ignore[no-untyped-def]
        return simulate(
            tip,
            ROUND,
            drive,
            dt=1e-3,
            duration=steps * 1e-3,
            every=steps,
            method=method,
            state=state,
        )

    whole = run(20).state(-1)
    save_state(run(8).state(-1), tmp_path / "kept.npz")
    rest = run(12, load_state(tmp_path / "kept.npz")).state(-1)
    assert rest.deformation.nodes.tobytes() == whole.deformation.nodes.tobytes()
    assert rest.friction.tobytes() == whole.friction.tobytes()
    assert rest.rate.tobytes() == whole.rate.tobytes()
    assert (rest.time, rest.step) == (pytest.approx(whole.time), whole.step)


def test_what_is_not_a_state_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.npz"
    path.write_bytes(b"PK")
    with pytest.raises(ValueError, match=r"other\.npz is not a state"):
        load_state(path)


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
        ({"method": "magic"}, "no integrator 'magic'; there is implicit, lagged, euler, rk4"),
        ({"half": True}, "half chain needs a drive and a state without lateral load"),
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
    assert drive.rate(np.array([0.5, 1.0, 9.0]))[:, 0] == pytest.approx([1.0, 2.0, 0.0])


class Halving(Implicit):
    """An integrator from Python: the default in steps of half the length."""

    def march(
        self, ch: Chain, ct: Contact, state: State, drive: Drive, dt: float, steps: int, every: int
    ) -> History:
        return super().march(ch, ct, state, drive, dt / 2, 2 * steps, 2 * every)


@pytest.mark.parametrize("method", [Halving, Halving(), "plugin:Halving"])
def test_an_integrator_may_be_a_class_an_object_or_a_module(
    method: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = ModuleType("plugin")
    module.__dict__["Halving"] = Halving
    monkeypatch.setitem(sys.modules, "plugin", module)
    drive = press_and_pull(0.02)
    run = simulate(SMALL, ROUND, drive, dt=2e-3, duration=0.02, method=method)  # type: ignore[arg-type]
    fine = simulate(SMALL, ROUND, drive, dt=1e-3, duration=0.02, every=2)
    np.testing.assert_array_equal(run.nodes, fine.nodes)


def test_a_dense_integrator_runs_no_half_chain() -> None:
    with pytest.raises(UserError, match="half chain runs with implicit or lagged, not rk4"):
        simulate(SMALL, ROUND, Drive.constant(1.0), dt=1e-3, duration=1e-3, half=True, method="rk4")


def test_a_divergence_reaches_another_process_whole() -> None:
    error = pickle.loads(pickle.dumps(DivergedError("diverged", 7, 1e-4)))
    assert (str(error), error.step, error.limit) == ("diverged", 7, 1e-4)
