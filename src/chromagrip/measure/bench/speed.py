"""Rows of `chromagrip bench loop` on speed: frames per second, and what they cost in Γ."""

import tempfile
import time
from collections.abc import Callable, Iterator
from multiprocessing import get_context
from multiprocessing.pool import Pool
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import UserError
from ...loop.fidelity import Fidelity
from ...loop.run_folder import run
from ...output.processes import start_worker
from ...output.rows import Row, at_least, at_most, reported
from ...render.drawing.gl import gl_problem
from ...scene.scene import load_scene, scene_names
from ..charts.chart import Chart, Point
from ..charts.loop import chart_loop
from ..reproduce.parts import PARTS, Plan, reproduce
from ..worlds.fidelity_table import CAMERA, FINE, SCENE, TRUTH, held_margin, margin_error, rms
from ..worlds.frame_parts import frame_parts
from ..worlds.grasps import OBJECTS, object_changes
from .child import run_child
from .control import PATHS

Progress = Callable[[str], None]

_CONTROLLER = {"controller": "margin-inversion"}
#: The obvious way: what a renderer, a detector and a model that one finds make of it.
_OBVIOUS = {"renderer": "pyrender", "tracker": "blob"}
#: Unseen objects: how many, how far their properties go, and which tolerances of Γ are planned for.
_UNSEEN, _TOLERANCES = 26, (0.07, 0.10, 0.15)
_FRICTION, _STIFFNESS, _RADIUS, _NOISE = (0.3, 0.7), (16.0, 200.0), (5.0, 60.0), (1.0, 6.0)
#: Of scenes of the library, the same for every fidelity.
_TOLERANCE = 0.10
_PAIRS, _GRASPS = 5, 4
_STARTS = 5
#: Frames of the long run, and of one in which everything that is kept has been made.
_LONG, _SETTLED = 100_000, 1000


def speed_rows(progress: Progress) -> Iterator[Row]:
    """Speed of the loop against its error, of what is planned, of processes; memory; start-up."""
    chart = chart_loop(False, lambda what: progress(f"chart: {what}"))
    yield from _chart_rows(chart)
    yield from _holding_rows(progress)
    yield from _obvious_rows(progress)
    yield from _planned_rows(progress)
    yield from _library_rows(progress)
    yield from _process_rows(progress)
    yield from _memory_rows(progress)
    yield from _start_rows(progress)
    yield from _reproduce_rows(progress)


def _chart_rows(chart: Chart) -> Iterator[Row]:
    """The fastest through the camera that reads Γ as well as the best, and to within 0.1."""
    seen = [point for point in chart.points if "tracker" in point.settings]
    best = next(point for point in seen if point.ours)

    def fastest(error: float) -> Point:
        able = [point for point in seen if point.errors["margin_error"] <= error]
        return min(able, key=lambda point: point.milliseconds)

    for name, point, asked in (
        ("default", best, 0.0),
        ("best-error", fastest(best.errors["margin_error"]), 100.0),
        ("error-0.10", fastest(0.10), 300.0),
    ):
        start = f"speed/{name}/{point.name}"
        yield reported(f"{start}/margin_error", point.errors["margin_error"], "")
        yield reported(f"{start}/displacement", point.errors["displacement"], "mm")
        yield at_least(f"{start}/speed", 1e3 / point.milliseconds, "frames/s", asked)


def _holding_rows(progress: Progress) -> Iterator[Row]:
    """The 27 objects by the cheapest fidelity of each path."""
    for path, fidelity, asked in (
        ("truth", TRUTH[-1], 1000.0),
        ("camera", CAMERA[-1], 0.0),
    ):
        held, speeds = 0, []
        for number in range(len(OBJECTS)):
            progress(f"27 objects, {path}, {fidelity.name}: {number + 1}")
            changes = {"path": path, **_CONTROLLER, **object_changes(number), **fidelity.changes}
            scene = load_scene(SCENE, changes)
            summary = run(scene).summary
            held += not summary["gross_slip"]
            speeds.append(summary["frames_per_second"])
        start = f"speed/objects/{path}, {fidelity.name}"
        yield at_least(f"{start}/held", held, "of 27", 27)
        yield at_least(f"{start}/speed", float(np.median(speeds)), "frames/s", asked)


def _obvious_rows(progress: Progress) -> Iterator[Row]:
    """The default over pyrender, a blob detector and the same model: the loop, and each stage."""
    if (problem := gl_problem()) is not None:
        yield Row("speed/obvious/not_measured", None, "", problem, False)
        return
    parts = {}
    for name, changes in {"default": {}, "obvious": _OBVIOUS}.items():
        progress(f"a frame, part by part: {name}")
        parts[name] = frame_parts(load_scene(SCENE, {**_CONTROLLER, **changes}))
        for part, spent in parts[name].items():
            yield reported(f"speed/frame/{name}/{part}", spent, "ms")
    for part, spent in parts["obvious"].items():
        yield reported(f"speed/obvious/{part}", spent / parts["default"][part], "×")
    ratio = sum(parts["obvious"].values()) / sum(parts["default"].values())
    yield at_least("speed/obvious/whole", ratio, "×", 10.0)


def _planned_rows(progress: Progress) -> Iterator[Row]:
    """Whether what is planned for objects that no table knows keeps its tolerance."""
    rng = np.random.default_rng(95)
    kept: list[bool] = []
    for number in range(_UNSEEN):
        drawn = {
            "object.friction": rng.uniform(*_FRICTION),
            "object.stiffness_kpa": np.exp(rng.uniform(*np.log(_STIFFNESS))),
            "object.radius_mm": np.exp(rng.uniform(*np.log(_RADIUS))),
            "camera.noise_levels": np.exp(rng.uniform(*np.log(_NOISE))),
            "seed": 1000 + number,
        }
        obj = {key: int(value) if key == "seed" else float(value) for key, value in drawn.items()}
        scene = load_scene(SCENE, obj | _CONTROLLER)
        errors: dict[Fidelity, float] = {}
        for tolerance in _TOLERANCES:
            try:
                chosen = Fidelity.auto(tolerance, scene).fidelity
            except UserError:
                continue  # says that nothing is known to keep it
            if chosen not in errors:
                progress(f"unseen object {number + 1} of {_UNSEEN}: {chosen.name}")
                errors[chosen] = _error(chosen, obj)
            kept.append(errors[chosen] <= tolerance)
    yield reported("speed/plan/planned", len(kept), "of unseen objects and tolerances")
    yield at_least("speed/plan/held", 100.0 * float(np.mean(kept)), "%", 95.0)


def _error(fidelity: Fidelity, obj: dict[str, Any]) -> float:
    """RMS error of Γ: as it was read, and of the chain."""
    result = run(load_scene(SCENE, obj | _CONTROLLER | fidelity.changes))
    chain = rms(held_margin(fidelity, obj) - held_margin(FINE, obj))
    return float(np.hypot(margin_error(result.trace), chain))


def _library_rows(progress: Progress) -> Iterator[Row]:
    """How much cheaper than the default is what is planned for the scenes of the library."""
    ratios: dict[str, list[float]] = {"camera": [], "truth": []}
    for name in scene_names():
        for path, found in ratios.items():
            scene = load_scene(name, {"path": path})
            try:
                choice = Fidelity.auto(_TOLERANCE, scene)
            except UserError:
                continue
            progress(f"{name}, {path}: {choice.fidelity.name}")
            usual = Fidelity() if path == "camera" else TRUTH[0]
            times = [_milliseconds(name, path, f) for f in (usual, choice.fidelity)]
            found.append(times[0] / times[1])
    for path, found in ratios.items():
        yield reported(f"speed/plan/{path}/scenes", len(found), "of the library")
        yield reported(f"speed/plan/{path}/cheaper", float(np.median(found)), "×")
    both = [ratio for found in ratios.values() for ratio in found]
    yield at_least("speed/plan/cheaper", float(np.median(both)), "×", 3.0)


def _milliseconds(name: str, path: str, fidelity: Fidelity) -> float:
    result = run(load_scene(name, {"path": path, **fidelity.changes}))
    return 1e3 / result.summary["frames_per_second"]


def _process_rows(progress: Progress) -> Iterator[Row]:
    """Grasps a second of two processes over those of one, in pairs that take turns."""
    context, ratios = get_context("spawn"), []
    with context.Pool(2, initializer=start_worker) as pool:
        pool.map(_grasps, [1, 1], chunksize=1)
        for number in range(_PAIRS):
            progress(f"processes, pair {number + 1} of {_PAIRS}")
            alone, together = _seconds(pool, 1), _seconds(pool, 2)
            ratios.append(2.0 * alone / together)
    yield at_least("speed/processes/two_over_one", float(np.median(ratios)), "×", 1.9)


def _seconds(pool: Pool, processes: int) -> float:
    begin = time.perf_counter()
    pool.map(_grasps, [_GRASPS] * processes, chunksize=1)
    return time.perf_counter() - begin


def _grasps(count: int) -> None:
    for _ in range(count):
        run(load_scene(SCENE, _CONTROLLER))


def _memory_rows(progress: Progress) -> Iterator[Row]:
    """Largest memory of a whole `chromagrip grasp`, and how it grows with the frames."""
    progress("memory: a grasp")
    yield at_most("speed/memory/grasp", _grasp([])[1], "MB", 400.0)
    with tempfile.TemporaryDirectory() as folder:
        more = ["--out", f"{folder}/run"]
        yield at_most("speed/memory/grasp with its folder", _grasp(more)[1], "MB", 400.0)
    for path, fidelity, frames in (
        ("camera", CAMERA[-1], _LONG // 10),
        ("truth", TRUTH[-1], _LONG),
    ):
        progress(f"memory: {frames} frames, {path} path")
        changes = [f"--set={key}={value}" for key, value in fidelity.changes.items()]
        peaks = [
            _grasp(["--path", path, *changes, f"--set=duration_s={count / 60.0}"])[1]
            for count in (_SETTLED, frames)
        ]
        start = f"speed/memory/{path}, {frames} frames"
        yield at_most(f"{start}/peak", peaks[1], "MB", 400.0)
        yield reported(f"{start}/growth", peaks[1] - peaks[0], "MB")


def _start_rows(progress: Progress) -> Iterator[Row]:
    """Whole `chromagrip grasp` of a few frames, once everything is compiled."""
    for path in PATHS:
        times = []
        for turn in range(_STARTS):
            progress(f"start-up, {path}, {turn + 1} of {_STARTS}")
            times.append(_grasp(["--path", path, "--set=duration_s=0.05"])[0])
        yield at_most(f"speed/start-up/{path}", float(np.median(times)), "s", 2.0)


def _grasp(options: list[str]) -> tuple[float, float]:
    """Duration [s] and largest memory [MB] of `chromagrip grasp` in a process of its own."""
    return run_child(["grasp", "--scene", SCENE, "--json", *options])


def _reproduce_rows(progress: Progress) -> Iterator[Row]:
    """The thesis, on the truth path and through the camera at 1000 Hz, in two processes."""
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        reproduce(list(PARTS), Plan(quick=False, camera="thesis"), Path(folder), True, 2, progress)
    yield at_most("speed/reproduce", (time.perf_counter() - begin) / 60.0, "min", 15.0)
