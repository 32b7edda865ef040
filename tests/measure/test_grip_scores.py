"""Scorecards of grips: scores against analysis, and runs are counted as what they are."""

import math
from typing import Any

import numpy as np
import pytest

from benchmarks.model.pinch_steps import (
    FREQUENCY,
    euler_loss,
    momentum_lacks,
    predicted_loss,
    swing_loss,
)
from chromagrip import load_scene
from chromagrip.loop import COLUMNS
from chromagrip.loop.record import Result
from chromagrip.loop.trace import Trace
from chromagrip.measure.bench import control, loop_dome
from chromagrip.measure.bench import control_pinch as pinch
from chromagrip.measure.engine import measure
from chromagrip.measure.study import Asked
from chromagrip.measure.worlds.coverage import count_frames, coverage_rows, slip_rows
from chromagrip.measure.worlds.scorecard import SCORES, overshoot, scores, settling, together, worst
from chromagrip.output.report import values
from chromagrip.scene.fingers import build_pinch
from chromagrip.thesis import OBJECTS


def result(**columns: Any) -> Result:
    """Run of moisture-1 (its last change is at 1.2 s) with these columns, the others plain."""
    scene = load_scene("moisture-1")
    time = np.arange(scene.frames) * scene.period
    plain = dict.fromkeys(COLUMNS, 0.0) | {"mu_true": 0.5, "normal_true_n": 1.0, "load_n": 0.35}
    plain |= {"margin_true": 0.3, "contact_nodes": 9.0, "grip_n": 1.0, "time_s": time}
    made = {name: np.broadcast_to(value, time.shape) for name, value in (plain | columns).items()}
    return Result(scene=scene, summary={}, trace=Trace(made), folder=None)


TIME = result().trace["time_s"]


def test_a_grip_that_stays_scores_nothing_and_a_ramp_and_a_sawtooth_score_what_they_are() -> None:
    """∫(dF/dt)² of 2 N/s for a second is 4; ±0.01 N at 60 Hz is 0.6 N/s, in the end only."""
    assert scores(result()) == dict.fromkeys(SCORES, 0.0)
    ramp = scores(result(grip_n=np.clip(TIME - 0.5, 0.0, 1.0) * 2.0))
    assert (ramp["energy"], ramp["chatter"]) == (pytest.approx(4.0, rel=1e-6), 0.0)
    sawtooth = 1.0 + 0.01 * (np.arange(len(TIME)) % 2)
    assert scores(result(grip_n=sawtooth))["chatter"] == pytest.approx(0.6, rel=0.02)
    assert scores(result(grip_n=np.where(TIME < 1.5, sawtooth, 1.0)))["chatter"] == 0.0


def test_overshoot_is_what_the_margin_rises_to_after_the_change() -> None:
    def of(margin: np.ndarray) -> float:
        return overshoot(result(margin_true=margin).trace, 1.25)

    assert of(np.interp(TIME, [0.0, 1.2, 1.3, 2.0], [0.9, 0.3, 0.45, 0.28])) == pytest.approx(
        15.0, abs=0.1
    )
    assert of(np.where(TIME > 1.25, 0.2, 0.9)) == of(np.full(len(TIME), np.nan)) == 0.0


def test_settling_is_the_last_exit_after_the_change() -> None:
    def of(margin: np.ndarray) -> float:
        return settling(result(margin_true=margin).trace, 1.2)

    assert of(np.where(TIME < 1.2, 0.9, 0.34)) == 0.0  # what was before does not count
    dip = np.where((TIME > 1.25) & (TIME < 1.5 - 1e-6), 0.1, 0.3)
    assert of(dip) == pytest.approx(0.3, abs=1 / 60)
    twice = np.where((TIME > 1.8) & (TIME < 2.0 - 1e-6), 0.36, dip)
    assert of(twice) == pytest.approx(0.8, abs=1 / 60)
    never = np.full(len(TIME), 0.5)
    assert of(never) == pytest.approx(TIME[-1] - 1.2)
    assert of(np.where(TIME > 2.0, np.nan, 0.3)) == pytest.approx(TIME[-1] - 1.2)


def test_time_at_a_load_that_friction_cannot_hold_pressure_and_gross_slip() -> None:
    load = np.where((TIME > 0.5 + 1e-6) & (TIME < 1.0 + 1e-6), -0.51, 0.49)
    assert scores(result(load_n=load))["overloaded"] == pytest.approx(0.5, abs=1e-6)
    pressure = np.where(TIME < 1.2, 0.0, np.where(TIME < 1.8, 400.0, 600.0))
    seen = scores(result(pressure_pitch_n_per_m=pressure, contact_nodes=pressure))
    assert seen["pressure_max"] == 600.0
    assert seen["pressure_mean"] == pytest.approx(500.0, rel=0.02)
    runs = [scores(result(lateral_displacement_mm=d)) for d in (0.1, 0.19, 0.21, 0.4)]
    assert together(runs)["gross"] == worst(runs)["gross"] == 2.0
    assert together(runs)["displacement"] == 0.4
    energies = [one | {"energy": e} for one, e in zip(runs, (1.0, 2.0, 3.0, 6.0), strict=True)]
    assert (together(energies)["energy"], worst(energies)["energy"]) == (3.0, 6.0)


@pytest.mark.studies
def test_a_run_is_scored_by_the_truth_and_a_bad_grip_shows() -> None:
    """Too little grip in the wet slips grossly."""

    def card(**changes: Any) -> dict[str, float]:
        told = {"controller": "conservative", "path": "truth", **changes}
        case = {"group": "", "path": "truth", "controller": "", "scene": "moisture-1"}
        found = control.score_run(control.ControlRun(**case, changes=told))
        assert isinstance(found, dict)
        return found

    weak = card(**{"conservative.force_n": 1.0})
    assert weak["gross"] == 1.0
    assert weak["overloaded"] == pytest.approx(1.2, abs=0.02)
    assert weak["settling"] == pytest.approx(1.2, abs=1e-9)
    strong = card()
    assert (strong["gross"], strong["overloaded"], strong["energy"]) == (0.0, 0.0, 0.0)
    assert strong["pressure_max"] > 1.5 * weak["pressure_max"]


def test_a_run_that_stops_is_a_row_and_spoils_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(task: control.ControlRun) -> dict[str, float] | str:
        return "the plant broke" if task.scene == "jerk-1" else dict.fromkeys(SCORES, 1.0)

    monkeypatch.setattr(control, "score_run", fails)
    report = measure("bench", "control", Asked(quick=True, methods=("conservative",)), workers=1)
    found = {row.name: row for row in report.rows}
    stopped = found["jerk-1/truth/conservative/stopped"]
    assert (stopped.value, stopped.met) == (1.0, False)
    assert "1 of 1 runs stopped: the plant broke" in stopped.note
    assert found["ramp-1/truth/conservative/displacement"].value == 1.0
    assert "jerk-1/truth/conservative/displacement" not in found
    assert found["worst/truth/conservative/gross"].value == len(control.SCENES) - 1
    assert found["worst/truth/conservative/stopped"].value == 1.0


def test_frames_are_counted_by_where_the_truth_lies() -> None:
    """Γ 0.3 [0.2, 0.4] against a truth inside, below by one, two and three half-widths, and 0.9."""
    true = np.resize([0.3, 0.15, 0.09, 0.5, 0.9, 0.3, 0.3, np.nan, 0.3, 0.3], len(TIME))
    said = np.where(np.arange(len(TIME)) % 10 < 8, 0.3, np.nan)
    interval = {"margin_low": said - 0.1, "margin_high": said + 0.1}
    counted = count_frames(result(margin_true=true, margin_estimated=said, **interval).trace)
    expected = {"frames": 6, "outside": 3, "unsafe": 2, "wrong": 1, "flagged": 2}
    for kind, count in expected.items():
        assert counted[kind] == pytest.approx(0.1 * count * len(TIME), abs=3)


def test_coverage_is_bootstrapped_over_runs_and_counts_whole_runs() -> None:
    good = {"frames": 100.0, "outside": 5.0, "unsafe": 0.0, "wrong": 0.0, "flagged": 0.0}
    bad = {"frames": 100.0, "outside": 50.0, "unsafe": 50.0, "wrong": 40.0, "flagged": 25.0}
    runs = {"a": [good] * 50, "b": [good] * 40 + [bad] * 10}
    found = {row.name.removeprefix("coverage/camera/"): row for row in coverage_rows(runs)}
    for name, share in (
        ("a/inside", 95.0),
        ("b/inside", 86.0),
        ("all/inside", 90.5),
        ("all/unsafe", 5.0),
        ("all/runs_outside", 10.0),
        ("all/runs_wrong", 10.0),
    ):
        assert found[name].value == pytest.approx(share)
    assert not found["all/runs_wrong"].met
    # A run is inside or outside as a whole: σ = 45·√(0.1·0.9/100) = 1.35 %.
    low, high = (found[f"all/inside_{end}"].value or 0.0 for end in ("low", "high"))
    assert high - low == pytest.approx(2 * 1.645 * 1.35, rel=0.2)


def test_slip_is_judged_where_the_truth_path_holds() -> None:
    slips = {
        "margin-inversion": [(0.1, 0.1), (0.1, 0.3), (0.5, 3.0)],
        "react-to-slip": [(1.3, 1.4), (1.5, 4.0), (0.0, 0.0)],
    }
    found = {row.name: row.value for row in slip_rows(slips)}
    assert found["beyond/camera/margin-inversion/gross_where_truth_holds"] == 50.0
    assert found["beyond/camera/all/gross_where_truth_holds"] == pytest.approx(100.0 / 3.0)
    assert found["beyond/camera/react-to-slip/largest_where_truth_waits"] == 1.4


# ---- two fingers ----


def lift(outcome: str = "held", pressure: float = 50.0) -> pinch.Outcome:
    rest = {"largest": 90.0, "turn": 1.0, "elastic": 2.0, "grip": 3.0, "energy": 4.0, "rate": 5.0}
    return pinch.Outcome(outcome, pressure, **rest)


def lifts(
    path: str, name: str, *runs: pinch.Outcome | str, grip: float | None = None
) -> dict[pinch.LiftRun, pinch.Outcome | str]:
    """Runs of one object after the other, with a constant grip [N] where it is given."""
    return {
        pinch.LiftRun(pinch.LIFT, path, name, thing, 0, grip): each
        for thing, each in enumerate(runs)
    }


def test_outcomes_are_counted_and_a_run_that_stopped_is_none_of_them() -> None:
    runs = lifts("truth", "a", lift(), lift("dropped"), lift("dropped"), lift("crushed"), "gave up")
    found = values(pinch.report_of(runs, ()).rows)
    case = (pinch.LIFT, "truth", "a")
    counts = [found[*case, name] for name in ("runs", "held", "dropped", "turned", "crushed")]
    assert counts == [5, 1, 2, 0, 1]
    assert found[*case, "stopped"] == 1


def test_pressure_is_compared_with_the_smallest_grip_that_lifts_every_object() -> None:
    def constant(grip: float, *outcomes: pinch.Outcome) -> dict[pinch.LiftRun, Any]:
        return lifts("truth", pinch.CONSTANT, *outcomes, grip=grip)

    def told(runs: dict[pinch.LiftRun, Any], *case: str) -> float | None:
        return values(pinch.report_of(runs, (pinch.LIFT,)).rows).get((pinch.LIFT, *case))

    runs = lifts("camera", "a", lift(pressure=30.0), lift(pressure=50.0))
    holds = runs | constant(3.0, lift("dropped", 70.0)) | constant(4.0, lift(pressure=80.0))
    assert told(holds, "camera", "a", "gentler") == pytest.approx(50.0)
    assert told(holds, "truth", pinch.CONSTANT, "smallest") == 4.0
    none = runs | constant(4.0, lift(pressure=80.0), lift("dropped"))
    assert told(none, "camera", "a", "gentler") is None
    for heaviest, grip in ((2, 5.0), (20, pinch.GRIPS[-1])):
        runs = {}
        while todo := pinch.larger_grips(runs, (pinch.LIFT,), (0, heaviest)):
            for task in todo:
                runs[task] = lift("held" if task.grip >= 3.0 + task.thing else "dropped")
        assert pinch.grips_of(runs, pinch.LIFT)[-1] == grip
        smallest = told(runs, "truth", pinch.CONSTANT, "smallest")
        assert smallest == (grip if heaviest == 2 else None)


def test_every_object_is_lifted_with_its_radius_across_the_pinch() -> None:
    for thing in (0, 1, 2):
        built = build_pinch(load_scene(pinch.LIFT, pinch.object_in_hand(thing)))
        radius, (low, high) = OBJECTS[thing].radius_mm, built.solid.shape.bounds[:, 2]
        assert high - low == pytest.approx(30e-3 if math.isinf(radius) else 2e-3 * radius)
    # Each friction comes with each mass.
    assert len({(OBJECTS[k].friction, pinch.mass_of(k)) for k in range(len(OBJECTS))}) == 9


@pytest.mark.studies
def test_too_small_a_grip_drops_and_a_large_one_holds() -> None:
    """Both fingers hold 200 g: 2·µ·N has to be above 1.96 N, with µ = 0.5."""
    small, large = (
        pinch.outcome_of(pinch.LiftRun(pinch.LIFT, "truth", pinch.CONSTANT, 9, 0, grip))
        for grip in (1.0, 6.0)
    )
    assert (small.outcome, large.outcome) == ("dropped", "held")
    assert large.grip == pytest.approx(6.0, rel=0.02)


def test_a_step_takes_of_a_swing_what_analysis_says() -> None:
    omega = 2.0 * math.pi * FREQUENCY
    assert swing_loss(10e-3) == pytest.approx(predicted_loss(10e-3), rel=0.005)
    # Of the first order in the loss, where a step is short.
    short = (omega * 5e-3) ** 4 / 4.0 / (FREQUENCY * 5e-3)
    assert predicted_loss(5e-3) == pytest.approx(short, rel=0.06)
    assert predicted_loss(10e-3) / predicted_loss(5e-3) == pytest.approx(8.0, rel=0.1)
    # Backward Euler, step by step: y₁ = y₀ + i·ω·h·y₁.
    size, steps = 1.0 + 0.0j, 80
    for _ in range(steps):
        size /= 1.0 - 1j * omega * 5e-3
    assert 1.0 - abs(size) ** (1.0 / (steps * 5e-3 * FREQUENCY)) == pytest.approx(euler_loss(5e-3))


def test_momentum_changes_by_the_forces_and_the_box_moves_by_it() -> None:
    momentum, place = momentum_lacks("pinch-lift", 4.0, quick=True)
    assert momentum < 1e-12
    assert place < 3e-3  # by the solver's tolerance


# ---- built domes ----

SET = "chromatouch-2020"
FRAMES = {"frames": 100.0, "outside": 10.0, "unsafe": 5.0, "wrong": 2.0, "flagged": 25.0}


def held(margin: float = 0.3, counts: dict[str, float] = FRAMES) -> loop_dome.GripOutcome:
    return loop_dome.GripOutcome(lost=False, margin=margin, force=5.0, counts=counts)


LOST = loop_dome.GripOutcome(lost=True, margin=0.0, force=15.0, counts=FRAMES)


def scored(*runs: tuple[str, int, int, loop_dome.GripOutcome | str]) -> dict[str, float | None]:
    """Scores of runs, each its path, object, seed and outcome."""
    results = [(loop_dome.DomeGripRun(SET, *case), outcome) for *case, outcome in runs]
    return {name[-1]: value for name, value in values(loop_dome.report_of(results).rows).items()}


def test_what_slides_with_the_true_forces_is_told_apart() -> None:
    found = scored(
        ("truth", 0, 0, held(counts=dict.fromkeys(FRAMES, 1000.0))),
        ("truth", 1, 0, LOST),
        ("camera", 0, 0, LOST),
        ("camera", 0, 1, held()),
        ("camera", 1, 0, LOST),
        ("camera", 1, 1, "the dome gave up"),
    )
    assert (found["runs"], found["lost"]) == (4.0, 3.0)
    assert (found["lost_by_truth"], found["lost_where_truth_holds"]) == (1.0, 1.0)
    assert found["stopped"] == 1.0
    # Frames of the camera alone are counted.
    assert found["inside"] == pytest.approx(90.0)
    assert found["wrong"] == pytest.approx(2.0)
    assert found["flagged"] == pytest.approx(20.0)


def test_margins_are_judged_of_the_runs_that_hold() -> None:
    outcomes = [*map(held, (0.30, 0.44, 0.16, 0.50)), LOST]
    found = scored(*(("camera", k, 0, outcome) for k, outcome in enumerate(outcomes)))
    assert found["within"] == pytest.approx(75.0)
    assert found["error"] == pytest.approx(0.14)


# ---- speed ----
