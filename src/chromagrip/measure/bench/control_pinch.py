"""Scorecards of controllers in the scenes of two fingers, and of the constant grip that holds."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ...errors import UserError
from ...loop.run import run
from ...output.report import Bounds, Report, Row, Table, measured, number, reported, values
from ...scene.controllers import CONTROLLERS
from ...scene.scene import load_scene
from ...thesis import OBJECTS
from ..score.intervals import share_interval
from ..study import Asked, Study, controllers_of, study
from ..worlds.pinch_scores import pinch_scores

#: Scene with the 27 objects, and those with the scene's own object.
LIFT = "pinch-lift"
OFFCENTRE = "pinch-offcentre"
OTHERS = (OFFCENTRE, "pinch-tilt", "pinch-shake", "pinch-fragile", "pinch-fill")
#: `pinch-lift` with objects that weigh differently, each µ with each of these masses [g].
WEIGHTS, MASSES = "pinch-lift, weights", (50.0, 200.0, 400.0)
#: The controller that is measured through the cameras with all objects, and seeds of specimens and
#: noise.
SEEN, SEEDS = "margin-inversion", 3
#: The one that holds torsion, through the cameras in the other scenes.
TORSION = "limit-surface"
#: Constant grips that are tried, the smallest first [N].
GRIPS = (3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0)
CONSTANT = "constant"
#: Safety Margin that leaves torsion out.
FRICTION_ONLY = "safety-margin, friction only"
#: Formats of the table's columns that are often nearly 0.
_FORMATS = dict.fromkeys(("turn", "elastic", "gentler"), ".1f")
#: Turn that is asked of the scene held beside its centre of mass [°].
_TURNS = {
    (OFFCENTRE, "camera", TORSION): Bounds(high=5.0),
    (OFFCENTRE, "truth", FRICTION_ONLY): Bounds(low=20.0),
}
_OUTCOMES = ("held", "dropped", "turned", "crushed")


class LiftRun(NamedTuple):
    """A run: scene, path, who controls, number of the object (None is the scene's), seed."""

    scene: str
    path: str
    controller: str
    thing: int | None
    seed: int
    grip: float | None = None


class Outcome(NamedTuple):
    """What a run came to.

    Attributes
    ----------
    outcome: held, dropped, turned or crushed
    pressure, largest: mean pressure of a contact while lifted, over time and at most [kPa]
    turn, elastic: of the object about the axis of the pinch without the skins', and theirs [°]
    grip: mean while lifted [N]
    energy: ∫(dF/dt)² of the command [N²/s]
    rate: frames per second
    """

    outcome: str
    pressure: float
    largest: float
    turn: float
    elastic: float
    grip: float
    energy: float
    rate: float


#: Unit of each score, and how it joins several runs.
SCORES: dict[str, tuple[str, Callable[[Sequence[float]], float]]] = {
    "pressure": ("kPa", lambda each: float(np.mean(each))),
    "largest": ("kPa", lambda each: float(np.mean(each))),
    "turn": ("°", lambda each: float(np.max(each))),
    "elastic": ("°", lambda each: float(np.max(each))),
    "grip": ("N", lambda each: float(np.mean(each))),
    "energy": ("N²/s", lambda each: float(np.mean(each))),
    "rate": ("frames/s", lambda each: float(np.median(each))),
}


def object_in_hand(thing: int) -> dict[str, Any]:
    """One of the 27 objects as changes of a scene: an upright box, cup or pen of that radius."""
    friction, stiffness, radius = OBJECTS[thing]
    changes: dict[str, Any] = {"object.friction": friction, "object.stiffness_kpa": stiffness}
    if math.isfinite(radius):
        changes |= {
            "object.shape": "cylinder",
            "object.size_mm": [radius, 40.0],
            "object.rounding_mm": 1.0,
            "object.turned_deg": [0.0, 0.0, 90.0],
        }
    return changes


def mass_of(thing: int) -> float:
    """Mass of one of the 27 objects where they weigh differently [g]."""
    return MASSES[(thing // 9 + thing // 3 + thing) % 3]


@study("bench", "control", worlds=("pinch",), method="controller")
def pinch_study(asked: Asked) -> Study[LiftRun, Outcome | str]:
    """Controllers of two fingers that lift objects, next to the constant grip that holds them.

    Rows are `SCENE/PATH/CONTROLLER/score`. A quick run has three objects on the truth path, without
    the other scenes.
    """
    names = controllers_of(asked, LIFT, CONTROLLERS.entries)
    things = _things(asked.quick)
    scenes = (LIFT,) if asked.quick else (LIFT, WEIGHTS)
    return Study(
        settings=tasks(asked.quick, names),
        measure=outcome_of,
        result=Outcome | str,
        report=lambda results: report_of(dict(results), scenes),
        words=lambda task: f"{task.scene}, {task.path}, {task.controller}",
        more=lambda results: larger_grips(dict(results), scenes, things),
    )


def larger_grips(
    runs: Mapping[LiftRun, Outcome | str], scenes: Sequence[str], things: Sequence[int]
) -> list[LiftRun]:
    """Runs with the next of GRIPS in each scene in which the last one did not lift every object."""
    todo: list[LiftRun] = []
    for scene in scenes:
        tried = grips_of(runs, scene)
        if len(tried) < len(GRIPS) and not (tried and _lifts_all(runs, scene, tried[-1])):
            grip = GRIPS[len(tried)]
            todo += [LiftRun(scene, "truth", CONSTANT, thing, 0, grip) for thing in things]
    return todo


def grips_of(runs: Mapping[LiftRun, Outcome | str], scene: str) -> list[float]:
    """Constant grips that were tried in a scene, the smallest first [N]."""
    return sorted({task.grip for task in runs if task.scene == scene and task.grip is not None})


def _lifts_all(runs: Mapping[LiftRun, Outcome | str], scene: str, grip: float) -> bool:
    """Whether a constant grip [N] lifts every object."""
    mine = [run for task, run in runs.items() if (task.scene, task.grip) == (scene, grip)]
    return all(isinstance(run, Outcome) and run.outcome == "held" for run in mine)


def tasks(quick: bool, names: Sequence[str]) -> list[LiftRun]:
    """Runs of all but the constant grip."""
    things = _things(quick)
    todo = [LiftRun(LIFT, "truth", name, thing, 0) for name in names for thing in things]
    if quick:
        return todo
    todo += [LiftRun(WEIGHTS, "truth", name, thing, 0) for name in names for thing in things]
    todo += [LiftRun(scene, "truth", name, None, 0) for scene in OTHERS for name in names]
    if "safety-margin" in names:
        todo.append(LiftRun(OFFCENTRE, "truth", FRICTION_ONLY, None, 0))
    if SEEN in names:
        todo += [
            LiftRun(scene, "camera", SEEN, thing, seed)
            for scene, seeds in ((LIFT, SEEDS), (WEIGHTS, 1))
            for seed in range(seeds)
            for thing in things
        ]
    if TORSION in names:
        todo += [LiftRun(scene, "camera", TORSION, None, 0) for scene in OTHERS]
    return todo


def _things(quick: bool) -> Sequence[int]:
    return (0, 13, 26) if quick else range(len(OBJECTS))


def outcome_of(task: LiftRun) -> Outcome | str:
    """What a run came to, or why it stopped."""
    changes: dict[str, Any] = {"path": task.path, "seed": task.seed}
    if task.thing is not None:
        changes |= object_in_hand(task.thing)
        if task.scene == WEIGHTS:
            changes["pinch.mass_g"] = mass_of(task.thing)
    if task.grip is not None:
        changes |= {"controller": "conservative", "conservative.force_n": task.grip}
    elif task.controller == FRICTION_ONLY:
        changes |= {"controller": "safety-margin", "held_margin": "friction"}
    else:
        changes["controller"] = task.controller
    try:
        scene = load_scene(LIFT if task.scene == WEIGHTS else task.scene, changes)
        result = run(scene)
    except UserError as error:
        return str(error)
    trace, summary, found = result.trace, result.summary, pinch_scores(result)
    lifted = trace["time_s"] > scene.pinch.lifts_at
    return Outcome(
        outcome=str(summary["outcome"]),
        pressure=found["pressure_mean"],
        largest=found["pressure_max"],
        turn=found["turn"],
        elastic=float(abs(trace["elastic_deg"]).max()),
        grip=float(trace["applied_n"][lifted].mean()),
        energy=found["energy"],
        rate=float(summary["frames_per_second"]),
    )


def report_of(runs: Mapping[LiftRun, Outcome | str], scenes: Sequence[str]) -> Report:
    """Report of runs; of the constant grips of these scenes, that of the last one tried."""
    grips: dict[str, float | None] = {}
    last = {scene: grips_of(runs, scene)[-1] for scene in scenes}
    for scene, tried in last.items():
        grips[scene] = tried if _lifts_all(runs, scene, tried) else None
    runs = {task: run for task, run in runs.items() if task.grip in (None, last.get(task.scene))}
    cases = dict.fromkeys((task.scene, task.path, task.controller) for task in runs)
    rows: list[Row] = []
    for case in cases:
        rows += _rows(case, [run for task, run in runs.items() if task[:3] == case])
    found = values(rows)
    for scene, grip in grips.items():
        note = "" if grip is not None else f"none up to {GRIPS[-1]:g} N lifts every object"
        rows.append(reported((scene, "truth", CONSTANT, "smallest"), grip, "N", note))
    for scene, path, controller in cases:
        constant = found.get((scene, "truth", CONSTANT, "pressure"))
        mine = found.get((scene, path, controller, "pressure"))
        if controller != CONSTANT and constant and grips.get(scene) and mine is not None:
            gentler = 100.0 * (1.0 - mine / constant)
            best = scene == LIFT and controller == SEEN and path == "camera"
            target = Bounds(low=30.0) if best else None
            rows.append(measured((scene, path, controller, "gentler"), gentler, "%", target))
    return Report(rows=tuple(rows), tables=(_table(rows, cases),), notes=NOTES)


def _rows(case: tuple[str, str, str], runs: Sequence[Outcome | str]) -> Iterator[Row]:
    complete = [run for run in runs if isinstance(run, Outcome)]
    stopped = [run for run in runs if isinstance(run, str)]
    yield reported((*case, "runs"), len(runs), "runs")
    strict = case == (LIFT, "camera", SEEN)
    for name in _OUTCOMES:
        count = sum(run.outcome == name for run in complete)
        target = Bounds(high=0.0) if strict and name in ("dropped", "crushed") else None
        low, high = share_interval(count, len(runs))
        note = f"of {len(runs)}; 90 % interval of the share {low:.1%} to {high:.1%}"
        yield measured((*case, name), count, "runs", target, note if target else "")
    if stopped:
        yield reported((*case, "stopped"), len(stopped), "runs", stopped[0])
    for score, (unit, join) in SCORES.items():
        each = [getattr(run, score) for run in complete]
        target = _TURNS.get(case) if score == "turn" else None
        yield measured((*case, score), join(each) if each else None, unit, target)


def _table(rows: Sequence[Row], cases: Mapping[tuple[str, str, str], None]) -> Table:
    found = values(rows)
    columns = {
        "runs": "runs", **dict.fromkeys(_OUTCOMES, "runs"),
        **{name: unit for name, (unit, _) in SCORES.items()}, "gentler": "%",
    }  # fmt: skip
    header = ("", *(name if unit == "runs" else f"{name} {unit}" for name, unit in columns.items()))
    lines = [
        (
            ", ".join(case),
            *(number(found.get((*case, name)), _FORMATS.get(name, ".3g")) for name in columns),
        )
        for case in cases
    ]
    return Table(header, tuple(lines))


#: Explanation of the scores.
NOTES = (
    "`pinch-lift` with the 27 objects: 200 g as an upright box, cup of 40 mm or pen of 10 mm; "
    "weights: each µ with 50, 200 and 400 g. The other scenes have their own object. dropped, "
    "turned, crushed: see docs/pinch.md.",
    "pressure: mean pressure of a contact while lifted, over time and the largest; means over the "
    "runs. turn: the largest about the axis of the pinch, without the elastic twist, which stands "
    "beside it. grip: mean while lifted. energy: ∫(dF/dt)² of the command. rate: with two runs at "
    "a time.",
    "constant: the smallest grip of 3, 4, 5, 6, 8, 10, 12 N that lifts every object with the true "
    "forces. gentler: by how much the pressure is lower than under it.",
)
