"""Scorecards of controllers: the scenes beyond the thesis on both paths, and the 27 objects."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...errors import UserError
from ...loop.columns import Rows
from ...loop.grasp import grasp
from ...loop.record import Result
from ...loop.run import run
from ...loop.trace import make_trace
from ...output.report import Bounds, Report, Row, Table, at_most, measured, number, values
from ...scene.controllers import CONTROLLERS
from ...scene.scene import Scene, load_scene
from ...thesis import OBJECTS
from ..study import Asked, Results, Study, controllers_of, study
from ..worlds.coverage import BEYOND, count_frames, coverage_rows, slip_rows
from ..worlds.grasps import WORLDS, calibration, object_changes, seed_of
from ..worlds.scorecard import NOTES, SCORES, scores, together, worst

#: Scenes beyond the thesis; the number at the end is the version of a scene.
SCENES = (
    "ramp-1",
    "sine-1",
    "jerk-1",
    "moisture-1",
    "patchy-1",
    "creep-1",
    "fill-1",
    "worn-1",
)
PATHS = ("truth", "camera")
#: Number of seeds of the camera's noise; the truth path has no noise.
SEEDS = 3
#: Scenes that a quick run repeats through the camera, with one seed.
_QUICK = ("jerk-1", "worn-1")
WORST = "worst"

#: Changes of a scene by dotted key.
Change = Mapping[str, Any]
#: Scores of a run by name.
Scores = dict[str, float]


@dataclass(frozen=True, kw_only=True)
class ControlRun:
    """A run of one controller.

    Attributes
    ----------
    group, path: runs with the same ones are scored together
    controller: name or module:Class
    scene, changes: see `load_scene`
    specimen: number of a sensor that differs from its calibration; None is as designed
    """

    group: str
    path: str
    controller: str
    scene: str
    changes: Change
    specimen: int | None = None


@dataclass(frozen=True, kw_only=True)
class ObjectSet:
    """Grasps of many objects through the camera.

    Attributes
    ----------
    scene: of all grasps
    changes: of the scene, for each object
    seeds: of the camera's noise, for each object
    mismatched: each object is gripped with a sensor of its own of the mismatched world
    scenes: for controllers that have another one
    truth: each object is gripped on the truth path too, once
    """

    scene: str
    changes: Sequence[Change]
    seeds: int = 1
    mismatched: bool = False
    scenes: Mapping[str, str] = field(default_factory=dict)
    truth: bool = False


#: The 27 objects of the thesis.
_OBJECTS: list[Change] = [object_changes(index) for index in range(len(OBJECTS))]
#: Changes of every scene for a controller: here its average of µ.
PRESETS: dict[str, Change] = {"margin-inversion": {"safety_margin.friction_window_s": 0.1}}
OBJECT_SETS = {
    "objects-100hz": ObjectSet(scene="camera-100hz", changes=_OBJECTS),
    "objects-60hz": ObjectSet(scene="margin-60hz", changes=_OBJECTS, seeds=SEEDS),
    "objects-30hz": ObjectSet(scene="margin-30hz", changes=_OBJECTS, seeds=SEEDS),
    "objects-bias": ObjectSet(
        scene="margin-30hz",
        changes=[{**changes, "camera.friction_bias": 0.05} for changes in _OBJECTS],
    ),
    "objects-mismatched": ObjectSet(scene="margin-60hz", changes=_OBJECTS, mismatched=True),
    "objects-jerk": ObjectSet(scene="jerk-1", changes=_OBJECTS),
    # The scene's drop of µ starts at 0.5: it is none for objects of µ 0.3, and larger for 0.7.
    "objects-moisture": ObjectSet(
        scene="moisture-1",
        changes=[changes for changes in _OBJECTS if changes["object.friction"] == 0.5],
        seeds=SEEDS,
    ),
    "beyond": ObjectSet(
        scene="margin-60hz",
        changes=BEYOND,
        seeds=SEEDS,
        scenes={"safety-margin": "camera-100hz"},
        truth=True,
    ),
}
#: Controllers that are judged beyond the thesis's objects: those that change the grip.
JUDGED_BEYOND = ("safety-margin", "margin-inversion", "react-to-slip")
#: Targets through the camera, by controller, set and score.
TARGETS: dict[tuple[str, str, str], Bounds] = {
    ("safety-margin", "objects-100hz", "gross"): Bounds(0.0, 2.0),
    **{
        ("margin-inversion", name, score): Bounds(0.0, bound)
        for name, bounds in {
            "objects-60hz": {
                "gross": 0.0,
                "displacement": 0.10,
                "settling": 0.45,
                "overshoot": 30.0,
                "pressure_max": 520.0,
                "chatter": 0.3,
            },
            "objects-30hz": {"gross": 0.0, "displacement": 0.20, "pressure_max": 540.0},
            "objects-mismatched": {"gross": 0.0, "pressure_max": 600.0},
            "objects-bias": {"gross": 0.0},
            "objects-jerk": {"gross": 2.0},
            "objects-moisture": {"settling": 0.5},
        }.items()
        for score, bound in bounds.items()
    },
}


@study("bench", "control", method="controller", example="--controller conservative --quick")
def control_study(asked: Asked) -> Study[ControlRun, Scores | str]:
    """Controllers in scenes beyond the thesis and with 27 objects, on both paths.

    Rows are `scene/path/controller/score`, their worst, and those of sets of objects. A quick run
    has the truth path, two scenes through the camera, and no sets. Of the sets of objects, a
    controller that is not chosen has only those that it has targets for.
    """
    names = controllers_of(asked, SCENES[0], CONTROLLERS.entries)
    return Study(
        settings=tasks(asked.quick, names, asked.methods),
        measure=score_run,
        result=Scores | str,
        report=report_of,
        words=lambda task: f"{task.group}, {task.path}, {task.controller}",
    )


def report_of(results: Results[ControlRun, Scores | str]) -> Report:
    """Report of runs."""
    runs: dict[tuple[str, str, str], list[Scores | str]] = {}
    beyond: list[tuple[ControlRun, Scores]] = []
    for task, result in results:
        runs.setdefault((task.group, task.path, task.controller), []).append(result)
        if task.group == "beyond" and not isinstance(result, str):
            beyond.append((task, result))
    rows: list[Row] = []
    for case, parts in runs.items():
        rows += _rows(case, parts, together)
    for path, controller in dict.fromkeys(case[1:] for case in runs):
        parts = [part for scene in SCENES for part in runs.get((scene, path, controller), [])]
        rows += _rows((WORST, path, controller), parts, worst)
    rows += beyond_rows(beyond)
    return Report(rows=tuple(rows), tables=(matrix(rows),), notes=NOTES)


def tasks(quick: bool, names: Sequence[str], chosen: Collection[object] = ()) -> list[ControlRun]:
    """Runs of a bench, in the order of its rows.

    Parameters
    ----------
    quick: without sets, and with few scenes through the camera
    names: of the controllers
    chosen: controllers that have every set of objects, not only those with targets
    """
    runs: list[tuple[str, str, str, Change, int, int | None]] = [
        (scene, path, scene, {}, 1 if path == "truth" or quick else SEEDS, None)
        for path in PATHS
        for scene in (_QUICK if quick and path == "camera" else SCENES)
    ]
    if not quick:
        runs += [
            (name, path, each.scene, changes, seeds, k if each.mismatched else None)
            for name, each in OBJECT_SETS.items()
            for path, seeds in (("truth", 1 if each.truth else 0), ("camera", each.seeds))
            for k, changes in enumerate(each.changes)
        ]
    judged = {(name, group) for name, group, _ in TARGETS}
    judged |= {(name, "beyond") for name in JUDGED_BEYOND}
    return [
        ControlRun(
            group=group,
            path=path,
            controller=name,
            scene=OBJECT_SETS[group].scenes.get(name, scene) if group in OBJECT_SETS else scene,
            changes={
                "controller": name,
                "path": path,
                "seed": seed,
                **PRESETS.get(name, {}),
                **changes,
            },
            specimen=specimen,
        )
        for name in names
        for group, path, scene, changes, seeds, specimen in runs
        if name in chosen or group not in OBJECT_SETS or (name, group) in judged
        for seed in range(seeds)
    ]


def score_run(task: ControlRun) -> Scores | str:
    """Scores of a run, or the reason why there are none."""
    try:
        scene = load_scene(task.scene, dict(task.changes))
        result = run(scene) if task.specimen is None else _run_with(task.specimen, scene)
        return scores(result) | count_frames(result.trace)
    except UserError as error:
        return str(error)


def _run_with(index: int, scene: Scene) -> Result:
    """A run with a sensor of the mismatched world."""
    rng = np.random.default_rng(seed_of("mismatched", "controlled", index))
    specimen, known = WORLDS["mismatched"](rng), calibration("mismatched")
    with closing(specimen.camera(int(rng.integers(2**32)))) as camera:
        samples = grasp(scene, camera, specimen.fingertip, known)
        lines = [*map(Rows(scene).line, samples)]
    return Result(scene=scene, summary={}, trace=make_trace(lines), folder=None)


def beyond_rows(runs: Sequence[tuple[ControlRun, Mapping[str, float]]]) -> list[Row]:
    """Slip by camera against that of the truth path, and the intervals of Γ over time."""
    held = {_case(task): run["displacement"] for task, run in runs if task.path == "truth"}
    slips: dict[str, list[tuple[float, float]]] = {}
    counted: dict[str, list[Mapping[str, float]]] = {}
    for task, run_scores in runs:
        if task.path == "camera":
            counted.setdefault(task.controller, []).append(run_scores)
            if _case(task) in held:
                pair = (held[_case(task)], run_scores["displacement"])
                slips.setdefault(task.controller, []).append(pair)
    return slip_rows(slips) + coverage_rows(counted) if counted else []


def _case(task: ControlRun) -> str:
    """Changes of a task but for its path and seed."""
    changes = {key: value for key, value in task.changes.items() if key not in ("path", "seed")}
    return repr(sorted(changes.items()))


def _rows(
    case: tuple[str, str, str],
    parts: Sequence[dict[str, float] | str],
    join: Callable[[Sequence[dict[str, float]]], dict[str, float]],
) -> Iterator[Row]:
    """Scores of runs of one case (group, path, controller), and the number of runs that stopped."""
    group, _, controller = case
    stopped = [part for part in parts if isinstance(part, str)]
    if stopped:
        note = f"{len(stopped)} of {len(parts)} runs stopped: {stopped[0]}"
        yield at_most((*case, "stopped"), len(stopped), "runs", 0.0, note)
    complete = [part for part in parts if not isinstance(part, str)]
    for score, value in (join(complete) if complete else {}).items():
        target = TARGETS.get((controller, group, score))
        yield measured((*case, score), value, SCORES[score][0], target)


def matrix(rows: Sequence[Row]) -> Table:
    """Table of scores: a line for each controller, path, and scene or set."""
    found = values(rows)
    # A controller's scenes stand together, on each path, and the worst of them below.
    cases = sorted(
        dict.fromkeys(row.subject for row in rows),
        key=lambda case: (case[2], PATHS.index(case[1])),
    )
    lines = []
    for case in cases:
        group, path, controller = case
        mark = " (stopped)" if (*case, "stopped") in found else ""
        cells = [number(found.get((*case, score))) for score in SCORES]
        lines.append((f"{controller}, {path}: {group}{mark}", *cells))
    header = ("", *(f"{score} {unit}" for score, (unit, _) in SCORES.items()))
    return Table(header, tuple(lines))
