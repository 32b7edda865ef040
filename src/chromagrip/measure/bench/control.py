"""Scorecards of controllers: the scenes beyond the thesis on both paths, and the 27 objects."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from ...errors import UserError
from ...loop.grasp import grasp
from ...loop.run_folder import Result, run
from ...loop.trace import make_trace, row
from ...output.processes import start_worker
from ...output.rows import Row, reported, within
from ...scene.controllers import CONTROLLERS
from ...scene.scene import Scene, load_scene
from ..worlds.grasps import OBJECTS, WORLDS, calibration, object_changes, seed_of
from ..worlds.scorecard import SCORES, scores, together, worst

#: Scenes beyond the thesis; a number behind the name is its version.
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
#: Seeds of the camera's noise; the truth path has none.
SEEDS = 3
#: Scenes that a quick run sees through the camera, once.
_QUICK = ("jerk-1", "worn-1")
WORST = "worst"

Change = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Task:
    """A run of one controller; `group` and `path` name the runs that are scored together.

    `specimen` is the number of a sensor that is not what its calibration says; None is as designed.
    """

    group: str
    path: str
    controller: str
    scene: str
    changes: Change
    specimen: int | None = None


#: The 27 objects of the thesis.
_OBJECTS: list[Change] = [object_changes(index) for index in range(len(OBJECTS))]
#: What a controller is shown with, whatever the scene: the average of µ that its own scene has.
PRESETS: dict[str, Change] = {"margin-inversion": {"safety_margin.friction_window_s": 0.1}}
MISMATCHED = "objects-mismatched"
#: Grasps of many objects through the camera: scene, changes of each run, seeds.
OBJECT_SETS: dict[str, tuple[str, list[Change], int]] = {
    "objects-100hz": ("camera-100hz", _OBJECTS, 1),
    "objects-60hz": ("margin-60hz", _OBJECTS, SEEDS),
    "objects-30hz": ("margin-30hz", _OBJECTS, SEEDS),
    "objects-bias": ("margin-30hz", [one | {"camera.friction_bias": 0.05} for one in _OBJECTS], 1),
    # Each with a sensor of its own of the mismatched world of `bench force`.
    MISMATCHED: ("margin-60hz", _OBJECTS, 1),
    "objects-jerk": ("jerk-1", _OBJECTS, 1),
    # It is no drop to those of µ 0.3, and more of one than told to those of 0.7.
    "objects-moisture": (
        "moisture-1",
        [one for one in _OBJECTS if one["object.friction"] == 0.5],
        SEEDS,
    ),
}
#: What is asked of a controller through the camera, by set and score.
TARGETS: dict[tuple[str, str, str], tuple[float, float]] = {
    ("safety-margin", "objects-100hz", "gross"): (0.0, 2.0),
    **{
        ("margin-inversion", name, score): (0.0, bound)
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
            MISMATCHED: {"gross": 0.0, "pressure_max": 600.0},
            "objects-bias": {"gross": 0.0},
            "objects-jerk": {"gross": 2.0},
            "objects-moisture": {"settling": 0.5},
        }.items()
        for score, bound in bounds.items()
    },
}


def bench_control(
    quick: bool, progress: Callable[[str], None], controllers: tuple[str, ...] = ()
) -> list[Row]:
    """Rows `scene/path/controller/score`, their worst, and `objects-…/camera/controller/score`.

    Parameters
    ----------
    quick: the truth path, and two scenes through the camera; no sets of objects
    progress: told what is being measured
    controllers: names or module:Class; none are all of ours, with sets of objects only for those of
        whom something is asked there

    Raises
    ------
    UserError
        When there is no such controller.
    """
    todo = tasks(quick, chosen(controllers), bool(controllers))
    found: dict[tuple[str, str, str], list[dict[str, float] | str]] = {}
    with get_context("spawn").Pool(os.cpu_count(), initializer=start_worker) as pool:
        for number, (task, said) in enumerate(zip(todo, pool.imap(ask, todo), strict=True)):
            found.setdefault((task.group, task.path, task.controller), []).append(said)
            progress(f"{task.group}: run {number + 1} of {len(todo)}")
    rows: list[Row] = []
    for (group, path, controller), parts in found.items():
        rows += _rows(group, path, controller, parts, together)
    for path, controller in dict.fromkeys(key[1:] for key in found):
        parts = [one for scene in SCENES for one in found.get((scene, path, controller), [])]
        rows += _rows(WORST, path, controller, parts, worst)
    return rows


def chosen(controllers: Sequence[str]) -> tuple[str, ...]:
    """Each of these controllers once; all of ours if there are none.

    Raises
    ------
    UserError
        When there is no such controller.
    """
    names = tuple(dict.fromkeys(controllers)) or tuple(CONTROLLERS.entries)
    for name in names:
        load_scene(SCENES[0], {"controller": name}).build_controller()
    return names


def tasks(quick: bool, names: Sequence[str], everything: bool) -> list[Task]:
    """Runs of a bench, in the order of its rows.

    Parameters
    ----------
    quick: see `bench_control`
    names: of the controllers
    everything: every set of objects for each of them, not only where something is asked
    """
    runs: list[tuple[str, str, str, Change, int, int | None]] = [
        (scene, path, scene, {}, 1 if path == "truth" or quick else SEEDS, None)
        for path in PATHS
        for scene in (_QUICK if quick and path == "camera" else SCENES)
    ]
    if not quick:
        runs += [
            (group, "camera", scene, changes, seeds, number if group == MISMATCHED else None)
            for group, (scene, each, seeds) in OBJECT_SETS.items()
            for number, changes in enumerate(each)
        ]
    asked = {(name, group) for name, group, _ in TARGETS}
    return [
        Task(
            group=group,
            path=path,
            controller=name,
            scene=scene,
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
        if everything or group not in OBJECT_SETS or (name, group) in asked
        for seed in range(seeds)
    ]


def ask(task: Task) -> dict[str, float] | str:
    """Scores of a run, or why there are none."""
    try:
        scene = load_scene(task.scene, task.changes)
        return scores(run(scene) if task.specimen is None else _with(task.specimen, scene))
    except UserError as error:
        return str(error)


def _with(number: int, scene: Scene) -> Result:
    """A run with a sensor of the mismatched world."""
    rng = np.random.default_rng(seed_of("mismatched", "controlled", number))
    specimen, known = WORLDS["mismatched"](rng), calibration("mismatched")
    with closing(specimen.camera(int(rng.integers(2**32)))) as camera, threadpool_limits(1):
        cv2.setNumThreads(1)
        rows = [row(sample) for sample in grasp(scene, camera, specimen.fingertip, known)]
    return Result(scene=scene, summary={}, trace=make_trace(rows), folder=None)


def _rows(
    group: str,
    path: str,
    controller: str,
    parts: Sequence[dict[str, float] | str],
    join: Callable[[Sequence[dict[str, float]]], dict[str, float]],
) -> Iterator[Row]:
    start = f"{group}/{path}/{controller}"
    stopped = [part for part in parts if isinstance(part, str)]
    if stopped:
        text = f"{len(stopped)} of {len(parts)} runs stopped: {stopped[0]}"
        yield Row(f"{start}/stopped", float(len(stopped)), "runs", text, False)
    done = [part for part in parts if not isinstance(part, str)]
    if not done:
        return
    for score, value in join(done).items():
        bound = TARGETS.get((controller, group, score))
        name, unit = f"{start}/{score}", SCORES[score][0]
        yield reported(name, value, unit) if bound is None else within(name, value, unit, *bound)


def matrix(rows: list[dict[str, Any]]) -> list[list[str]]:
    """Table of scores with a heading: a line for each controller, path and scene or set."""
    found = {row["name"]: row["value"] for row in rows}
    lines = dict.fromkeys(tuple(_parts(name)[:3]) for name in found)
    table = [["", *(f"{score} {unit}" for score, (unit, _) in SCORES.items())]]
    # A controller's scenes stand together, on each path, and the worst of them below.
    order = sorted(lines, key=lambda line: (line[2], PATHS.index(line[1])))
    for group, path, controller in order:
        start = f"{group}/{path}/{controller}"
        cells = [found.get(f"{start}/{score}") for score in SCORES]
        mark = " (stopped)" if f"{start}/stopped" in found else ""
        values = ["–" if value is None else f"{value:.3g}" for value in cells]
        table.append([f"{controller}, {path}: {group}{mark}", *values])
    return table


def _parts(name: str) -> tuple[str, str, str, str]:
    """Group, path, controller and score of a row; the controller may hold slashes."""
    group, path, rest = name.split("/", 2)
    controller, score = rest.rsplit("/", 1)
    return group, path, controller, score


def asked(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows that have a target, and runs that stopped; the others are in the matrix."""
    return [row for row in rows if row["target"] != "reported"]
