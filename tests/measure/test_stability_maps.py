"""Maps of stability but the loop's: outcomes, boundaries by analysis, and what pictures say."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from benchmarks.model import chain_map as model
from benchmarks.model import dome_map as dome
from chromagrip.loop.trace import Trace
from chromagrip.measure.engine import measure
from chromagrip.measure.stability import cells as loop_cells
from chromagrip.measure.stability import force, track
from chromagrip.measure.stability.grips import cells as grips
from chromagrip.measure.stability.grips import predicted
from chromagrip.measure.stability.grips import study as grip_study
from chromagrip.measure.stability.grips.maps import maps
from chromagrip.measure.study import Asked
from chromagrip.measure.worlds.dome.readings import Reading
from chromagrip.measure.worlds.force_scores import Answers
from chromagrip.measure.worlds.track_scores import Constant

# ---- grips of a dome and of two fingers ----

WORLDS = get_args(grips.World)
CONSTANT = grips.GripSetting(world="pinch", controller="conservative")
GRIP = 6.0  # of the controller `conservative` [N]


@pytest.mark.studies
@pytest.mark.parametrize("more", [False, True])
def test_boundaries_by_analysis_are_those_of_runs(more: bool) -> None:
    """Weight against friction, torque against the limit surface, rate against the linear loop."""
    found = grips.cell(
        replace(CONSTANT, mass_g=(1.1 if more else 0.9) * predicted.heaviest(0.5, GRIP))
    )
    assert found.outcome == ("dropped" if more else "holds")
    assert found.grip_n == GRIP
    share = 1.4 if more else 0.8
    found = grips.cell(replace(CONSTANT, offset_mm=share * predicted.farthest(CONSTANT, GRIP)))
    assert found.outcome == ("turned" if more else "holds")
    base = replace(CONSTANT, controller="safety-margin", latency_frames=2)
    rate = (0.8 if more else 1.5) * predicted.slowest_rate(base)
    assert (grips.cell(replace(base, rate_hz=rate)).outcome == "holds") != more


def test_the_torsion_of_a_press_is_that_of_hertz_at_a_light_grip() -> None:
    """3π/16 of the contact's radius, a³ = 3FR/4E*; the layer's thickness spreads it a little."""
    body, force = CONSTANT.scene().build_dome(), 0.3
    modulus = body.young / (1.0 - body.poisson**2)
    radius = (0.75 * force * body.radius / modulus) ** (1.0 / 3.0)
    torsion = predicted.pressed("pinch", force).torsion
    assert torsion == pytest.approx(3.0 * math.pi / 16.0 * radius, rel=0.1)
    # and what a heavier object leaves of it: nothing where the weight alone is too much
    masses = (1.01 * predicted.heaviest(0.5, GRIP), 100.0, 200.0)
    lost, light, heavy = (predicted.farthest(replace(CONSTANT, mass_g=m), GRIP) for m in masses)
    assert math.isnan(lost)
    assert light > 2.0 * heavy


def test_what_a_controller_reaches_while_the_object_slides() -> None:
    tau = predicted.slide_time(CONSTANT)  # of a rise by 60 mm in a second, with the least jerk
    assert 10.0 * tau**3 - 15.0 * tau**4 + 6.0 * tau**5 == pytest.approx(5.0 / 60.0, rel=1e-6)
    names = ("conservative", "react-to-slip", "margin-inversion", "safety-margin")
    assert [predicted.reached(replace(CONSTANT, controller=name)) for name in names] == [
        GRIP,
        6.0,  # three steps of 1 N, at 1.3, 2.6 and 3.9 mm
        15.0,
        # On the table Γ is 1, and the grip opens to its floor.
        pytest.approx(2.0 + 0.3 * (1.0 + 60.0 * (tau - 2.0 / 60.0))),
    ]
    # 600 g are 1.96 times what 3 N bear: two rises by 1/0.7.
    heavy = replace(CONSTANT, controller="margin-inversion", mass_g=600.0)
    slowest = predicted.slowest_reaction
    assert slowest(heavy) == pytest.approx(2.0 * 2.0 / tau)
    assert slowest(replace(heavy, controller="safety-margin")) == pytest.approx(2.0 / tau)
    assert math.isnan(slowest(replace(heavy, mass_g=200.0)))


@pytest.mark.parametrize("world", WORLDS)
def test_a_lighter_load_needs_a_faster_camera(world: grips.World) -> None:
    base = grips.GripSetting(world=world, controller="safety-margin")
    light, late = replace(base, load_n=1.0, mass_g=100.0), replace(base, latency_frames=3)
    gains = [predicted.linear(one).plant.gain for one in (light, base)]
    # Γ = 1 − F/(µN) changes by F/(µN²) = µ(1 − Γ)²/F with the grip.
    assert gains == pytest.approx(
        [0.7**2 * one.friction / predicted.pull(one) for one in (light, base)]
    )
    assert predicted.slowest_rate(base) < predicted.slowest_rate(light)
    assert predicted.slowest_rate(base) < predicted.slowest_rate(late)


@pytest.mark.studies
def test_every_grip_is_drawn_and_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[grips.GripSetting] = []

    def quick_cell(setting: grips.GripSetting) -> grips.GripCell:
        ran.append(setting)
        assert setting.scene().path == "truth"
        names = list(grips.OUTCOMES)
        return grips.GripCell(**vars(setting), outcome=names[len(ran) % len(names)], note="a, b")

    monkeypatch.setattr(grip_study, "cell", quick_cell)
    asked = Asked(quick=True, world="pinch", methods=("react-to-slip",))
    report = measure("stability", "loop", asked, out=tmp_path, workers=1)
    assert len(ran) == len(set(ran))
    plan = maps("pinch", True, ("react-to-slip",))
    names = {f"{name}.{end}" for name in plan for end in ("csv", "png", "svg")}
    assert {path.name for path in tmp_path.iterdir()} == names | {"results.json", "index.html"}
    cells = sum(len(which.settings()) for which in plan.values())
    assert sum(row.value or 0 for row in report.rows) == cells
    assert {one.controller for one in ran} >= {"react-to-slip", "safety-margin"}


# ---- outcomes and pictures ----


def test_the_worst_outcome_counts() -> None:
    assert grips.outcome("held", 0.1) == "holds"
    assert grips.outcome("held", 0.5) == "swings"
    assert grips.outcome("turned", 0.5) == "turned"
    time = np.arange(0.0, 3.0, 0.01)
    wave = 2.0 + np.where(time < 1.5, 1.0, 0.4) * np.cos(2.0 * np.pi * 10.0 * time)
    swings, mean = grips.at_the_end(Trace({"time_s": time, "grip_n": wave}))
    assert swings == pytest.approx(0.4, rel=0.03)  # 2 × 0.4 of 2 N
    assert mean == pytest.approx(2.0, rel=0.01)
    assert dome.outcome(0.01, 0.0, 0) == "accurate"
    assert dome.outcome(0.01, 0.5, 0) == "accurate, steps halved"
    assert dome.outcome(0.03, 0.5, 0) == "inaccurate"
    assert dome.outcome(0.01, 0.5, 1) == "not converged"
    assert dome.outcome(math.nan, 0.0, 0) == "not judged"


@pytest.mark.parametrize("kind", [loop_cells, grips, model, dome, force])
def test_outcomes_differ_in_colour_and_letter_and_the_best_has_none(kind: Any) -> None:
    colours, letters, _ = zip(*kind.OUTCOMES.values(), strict=True)
    assert len(set(letters)) == len(set(colours)) == len(letters)
    assert [bool(letter) for letter in letters] == [False] + [True] * (len(letters) - 1)


# ---- the models' steps ----


def test_a_dome_is_inaccurate_in_long_steps_and_not_in_short_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    small = dome.settings(dome.Grid(("ball",), (0.7,), (1e9,), (100e-6, 400e-6)))
    short, long = dome.cells(small)
    assert (short.outcome, long.outcome) == ("accurate", "inaccurate")
    assert short.error < 0.01 < 0.03 < long.error
    (note,) = dome.report([short, long]).notes
    assert note.startswith("the dome is inaccurate at 400 µm a step on a ball of 1e+09 N/m³ (")

    def fails(*_: object, **__: object) -> None:
        raise dome.ConvergenceError("no")

    monkeypatch.setattr(dome, "simulate_contact", fails)
    (cell,) = dome.cells(small[1:])
    assert (cell.outcome, cell.note) == ("not converged", "no")


@pytest.mark.studies
def test_an_explicit_method_fails_where_theory_says_and_the_default_does_not() -> None:
    small = model.Grid(
        nodes=(21,),
        stiffness=(160.0,),
        steps={"implicit": (1e-3, 1e-2), "euler": (0.9, 1.5)},
        budget=20_000,
    )
    group = model.ChainGroup(tuple(model.settings(small)), small.budget)
    found = {(cell.method, cell.step_s < cell.limit_s): cell for cell in model.cells(group)}
    assert found["euler", True].outcome == "accurate"
    assert found["euler", False].outcome in ("chattering", "diverged", "inaccurate")
    assert found["implicit", False].outcome == "accurate"
    assert found["implicit", False].step_s == 1e-2
    (dear,) = model.cells(model.ChainGroup(group.settings[-1:], 10))
    assert (dear.outcome, "too many evaluations" in dear.note) == ("not run", True)


# ---- reconstructors on domes ----

#: (ΣFn, ΣFf, µ, Γ) of two frames.
TRUE = np.array([[2.0, 0.4, 0.5, 0.6], [2.0, 0.9, 0.5, 0.1]])
WRONG = "wrong, narrow and unflagged"


@pytest.mark.parametrize(
    ("normal", "margin", "half", "flagged", "outcome", "percent"),
    [
        ([0.19, 0.0], [0.0, 0.09], 0.0, [False, False], "accurate", 9.5),
        ([0.3, 0.0], [0.0, 0.0], 0.16, [False, False], "off, inside twice its interval", 15),
        ([0.3, 0.0], [0.0, 0.0], 0.14, [False, False], WRONG, 15),
        ([0.0, 0.0], [0.0, 0.3], 0.14, [False, False], WRONG, 0),
        ([9.0, 0.1], [9.0, 0.0], 0.0, [True, False], "frames flagged", 5),
        ([9.0, 0.4], [9.0, 0.0], 0.0, [True, False], WRONG, 20),
        ([9.0, 9.0], [9.0, 9.0], 0.0, [True, True], "frames flagged", math.nan),
    ],
)
def test_the_worst_outcome_of_a_reading_counts(
    normal: list[float], margin: list[float], half: float, flagged: list[bool], outcome: str,
    percent: float,
) -> None:  # fmt: skip
    """Of one that is off in ΣFn [N] and Γ by so much, with intervals of that half-width."""
    value = TRUE + np.stack([normal, np.zeros(2), np.zeros(2), margin], axis=1)
    interval = np.stack([value - half, value + half], axis=-1)
    answers, one = Answers(value=value, interval=interval, flagged=np.array(flagged)), np.ones(1)
    reading = Reading(answers=answers, side=np.zeros((2, 2)), spent=one, each=one, late=one > 1.0)
    found, off, _, lost, frames = force.judged(reading, TRUE)
    assert found == outcome
    assert off == pytest.approx(percent, nan_ok=True)
    assert (lost, frames) == (sum(flagged), 2)


def test_a_map_of_forces_is_drawn_with_ones_own_and_names_what_is_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def made(setting: force.ForceCondition) -> list[force.ForceCell]:
        case = (setting.dial, setting.value)
        return [
            force.ForceCell(setting.design, name, *case, outcome, 31.0, 0.4, 0, 4, "")
            for name, outcome in zip(setting.methods, (WRONG, "accurate", WRONG), strict=True)
        ]

    class Own(Constant):
        """Reads nothing."""

    monkeypatch.setattr(force, "cells", made)
    asked = Asked(quick=True, methods=(Own,))
    report = measure("stability", "force", asked, out=tmp_path, workers=1)
    names = {"map.png", "map.csv", "results.json", "index.html"}
    assert {path.name for path in tmp_path.iterdir()} == names
    counts = [row.value for row in report.rows if row.score == "accurate"]
    assert sorted(counts) == [0, 0, 3]
    bad = force.ForceCell("thesis", "contact", "noise", "4", WRONG, 31.0, 0.4, 0, 4, "")
    gone = replace(bad, method="sequential", dial="grip", value="3", outcome="not held", note="no")
    assert force.report([bad, gone]).notes == (
        f"contact on thesis is {WRONG} at noise 4: ΣFn 31 % off, Γ 0.40",
        "thesis, grip 3: no",
    )


# ---- trackers ----


@pytest.mark.parametrize(
    ("rights", "value", "note"),
    [
        ((99.0, 96.0, 80.0), 2.0, "fails at 4"),
        ((77.0, 99.0), None, "fails already at the easiest setting (1): 77 % right, 95 % needed"),
    ],
)
def test_where_a_tracker_holds_is_said(
    rights: tuple[float, ...], value: float | None, note: str
) -> None:
    curve = [
        track.TrackCell("mine", "noise", 2.0**k, 4, right, 0.1, 0, "")
        for k, right in enumerate(rights)
    ]
    (row,) = track.report(curve).rows
    assert (row.name, row.value, row.note) == ("mine/noise/holds_up_to", value, note)
