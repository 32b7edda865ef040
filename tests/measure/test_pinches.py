"""Scorecards of pinches: outcomes are counted as they are, beside the constant grip that holds."""

import math

import pytest

from benchmarks.model.pinch_steps import (
    FREQUENCY,
    euler_loss,
    momentum_lacks,
    predicted_loss,
    swing_loss,
)
from chromagrip.errors import UserError
from chromagrip.measure.bench.control_pinch import (
    CONSTANT,
    GRIPS,
    LIFT,
    OTHERS,
    WEIGHTS,
    LiftRun,
    Outcome,
    grips_of,
    larger_grips,
    mass_of,
    object_in_hand,
    outcome_of,
    report_of,
    tasks,
)
from chromagrip.measure.engine import measure
from chromagrip.measure.study import Asked
from chromagrip.output.report import values
from chromagrip.scene.fingers import build_pinch
from chromagrip.scene.scene import load_scene
from chromagrip.thesis import OBJECTS


def run(outcome: str = "held", pressure: float = 50.0) -> Outcome:
    return Outcome(
        outcome, pressure, largest=90.0, turn=1.0, elastic=2.0, grip=3.0, energy=4.0, rate=5.0
    )


def lifts(path: str, name: str, *runs: Outcome | str) -> dict[LiftRun, Outcome | str]:
    return {LiftRun(LIFT, path, name, thing, 0): each for thing, each in enumerate(runs)}


def test_outcomes_are_counted_and_a_run_that_stopped_is_none_of_them() -> None:
    runs = lifts("truth", "a", run(), run("dropped"), run("dropped"), run("crushed"), "gave up")
    found = values(report_of(runs, ()).rows)
    case = (LIFT, "truth", "a")
    counts = [found[*case, name] for name in ("runs", "held", "dropped", "turned", "crushed")]
    assert counts == [5, 1, 2, 0, 1]
    assert found[*case, "stopped"] == 1


def held_by(grip: float, *runs: Outcome) -> dict[LiftRun, Outcome | str]:
    """Runs with a constant grip [N]."""
    return {LiftRun(LIFT, "truth", CONSTANT, k, 0, grip): each for k, each in enumerate(runs)}


def test_pressure_is_compared_with_the_constant_grip() -> None:
    runs = lifts("camera", "a", run(pressure=30.0), run(pressure=50.0))
    holds = runs | held_by(3.0, run("dropped", 70.0)) | held_by(4.0, run(pressure=80.0))
    found = values(report_of(holds, (LIFT,)).rows)
    assert found[LIFT, "camera", "a", "gentler"] == pytest.approx(50.0)
    assert found[LIFT, "truth", CONSTANT, "smallest"] == 4.0
    none = runs | held_by(4.0, run(pressure=80.0), run("dropped"))
    assert (LIFT, "camera", "a", "gentler") not in values(report_of(none, (LIFT,)).rows)


def test_the_constant_grip_is_the_smallest_that_lifts_every_object() -> None:
    def outcome(task: LiftRun) -> Outcome:
        assert task.grip is not None
        assert task.thing is not None
        return run("held" if task.grip >= 3.0 + task.thing else "dropped")

    for heaviest, grip in ((2, 5.0), (20, GRIPS[-1])):
        runs: dict[LiftRun, Outcome | str] = {}
        while todo := larger_grips(runs, (LIFT,), (0, heaviest)):
            runs |= {task: outcome(task) for task in todo}
        assert grips_of(runs, LIFT)[-1] == grip
        smallest = values(report_of(runs, (LIFT,)).rows)[LIFT, "truth", CONSTANT, "smallest"]
        assert smallest == (grip if heaviest == 2 else None)


@pytest.mark.parametrize("thing", [0, 1, 2])
def test_objects_have_the_radius_of_the_thesis_across_the_pinch(thing: int) -> None:
    pinch = build_pinch(load_scene(LIFT, object_in_hand(thing)))
    radius = OBJECTS[thing].radius_mm
    across = float(pinch.solid.shape.bounds[1, 2] - pinch.solid.shape.bounds[0, 2])
    expected = 30e-3 if math.isinf(radius) else 2e-3 * radius
    assert across == pytest.approx(expected)


def test_each_friction_comes_with_each_mass() -> None:
    pairs = {(OBJECTS[thing].friction, mass_of(thing)) for thing in range(len(OBJECTS))}
    assert len(pairs) == 9


def test_every_scene_and_controller_is_run() -> None:
    todo = tasks(False, ("margin-inversion", "conservative"))
    assert {task.scene for task in todo} == {LIFT, WEIGHTS, *OTHERS}
    seen = [task for task in todo if task.path == "camera"]
    assert {task.controller for task in seen} == {"margin-inversion"}
    assert len(seen) == 4 * len(OBJECTS)
    assert len(set(todo)) == len(todo)


@pytest.mark.studies
def test_too_small_a_grip_drops_and_a_large_one_holds() -> None:
    small, large = (outcome_of(LiftRun(LIFT, "truth", CONSTANT, 9, 0, grip)) for grip in (1.0, 6.0))
    assert isinstance(small, Outcome)
    assert isinstance(large, Outcome)
    # Both fingers hold 200 g: 2·µ·N has to be above 1.96 N, with µ = 0.5.
    assert (small.outcome, large.outcome) == ("dropped", "held")
    assert large.grip == pytest.approx(6.0, rel=0.02)


def test_a_controller_that_is_none_is_refused_before_anything_runs() -> None:
    with pytest.raises(UserError, match="no controller 'mine'"):
        measure("bench", "control", Asked(methods=("mine",), world="pinch"))


def test_a_step_takes_of_a_swing_what_analysis_says() -> None:
    omega = 2.0 * math.pi * FREQUENCY
    short = (omega * 2.5e-3) ** 4 / 4.0 / (FREQUENCY * 2.5e-3)  # of the first order in the loss
    assert swing_loss(2.5e-3) == pytest.approx(short, rel=0.015)
    assert swing_loss(10e-3) == pytest.approx(predicted_loss(10e-3), rel=0.005)
    assert swing_loss(10e-3) / swing_loss(5e-3) == pytest.approx(8.0, rel=0.1)
    # Backward Euler, step by step: y₁ = y₀ + i·ω·h·y₁.
    size, steps = 1.0 + 0.0j, 80
    for _ in range(steps):
        size /= 1.0 - 1j * omega * 5e-3
    assert 1.0 - abs(size) ** (1.0 / (steps * 5e-3 * FREQUENCY)) == pytest.approx(euler_loss(5e-3))


def test_momentum_changes_by_the_forces_and_the_box_moves_by_it() -> None:
    momentum, place = momentum_lacks("pinch-lift", 4.0, quick=True)
    assert momentum < 1e-12
    assert place < 3e-3  # by the solver's tolerance
