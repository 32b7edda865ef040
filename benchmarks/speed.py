"""Rows of `chromagrip bench loop` on speed: frames per second, and their error of Γ."""

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from benchmarks.environments import environment_rows
from benchmarks.fidelity_table import FINE, GROUPS, held_margin
from benchmarks.parts import Part, parts_study
from benchmarks.sensors import sensor_rows
from benchmarks.timing import clock, run_child
from chromagrip.errors import UserError
from chromagrip.loop.fidelity import Fidelity
from chromagrip.loop.grasp import grasp
from chromagrip.loop.run import run
from chromagrip.measure.bench.control import PATHS
from chromagrip.measure.charts.chart import Chart
from chromagrip.measure.charts.loop import (
    CAMERA,
    SCENE,
    TRUTH,
    chart_of,
    loop_chart,
    margin_error,
    rms,
)
from chromagrip.measure.reproduce.parts import PARTS, Plan, reproduce
from chromagrip.measure.study import ALL, Asked, Study, study
from chromagrip.measure.worlds.grasps import object_changes
from chromagrip.output.processes import map_processes, one_thread
from chromagrip.output.report import Bounds, Row, at_least, at_most, measured, reported
from chromagrip.render import add_noise
from chromagrip.render.drawing import gl_problem
from chromagrip.scene.scene import Scene, load_scene, scene_names
from chromagrip.sensing.observers import ForceObserver
from chromagrip.sensing.reader import known_sensor
from chromagrip.sensing.sensor import open_camera
from chromagrip.thesis import OBJECTS
from chromagrip.tracking import Palette, load_tracker

_CONTROLLER = {"controller": "margin-inversion"}
#: Changes to a loop of freely available parts: a mesh renderer and weighted centroids.
_OBVIOUS = {"renderer": "pyrender", "tracker": "centroid"}
#: Stages of a frame on the camera path; the rest is the node model, the controller and the loop.
STAGES = ("picture", "noise", "tracking", "forces", "the rest")
#: Number of objects that the table of fidelities does not hold.
_UNSEEN = 26
#: Tolerances of Γ that their fidelity is planned for.
_TOLERANCES = (0.07, 0.10, 0.15)
#: Range of their friction coefficients.
_FRICTION = (0.3, 0.7)
#: Range of their Young's moduli [kPa].
_STIFFNESS = (16.0, 200.0)
#: Range of their radii [mm].
_RADIUS = (5.0, 60.0)
#: Range of the camera's noise [grey levels].
_NOISE = (1.0, 6.0)
#: Tolerance of Γ that the scenes of the library are planned for.
_TOLERANCE = 0.10
#: Calls of a stage, the fastest of which counts.
_CALLS = 200
#: Pairs of runs with one and two processes.
_PAIRS = 5
#: Grasps of each process in such a run.
_GRASPS = 4
#: A grasp with a dome of silicone.
_DOME = ("--scene", "chromatouch-2020", "--set=duration_s=0.2")
#: Starts of the command on each path.
_STARTS = 5
#: Frames of the long run.
_LONG = 100_000
#: Frames of a run at whose end everything that is kept is allocated.
_SETTLED = 1000


@study("project", "speed")
def speed_study(asked: Asked) -> Study[Part, tuple[Row, ...]]:
    """Speed of the loop and its error, plans, processes, memory, start-up, environments, sensors.

    A quick run has the parts of a frame and the start-up alone.
    """
    parts: dict[str, Callable[[bool], Iterator[Row]]] = {
        "frame by parts": lambda _: _obvious_rows(),
        "start-up": lambda _: _start_rows(),
    }
    if not asked.quick:
        parts |= {
            "chart": lambda _: _chart_rows(_loop_chart()),
            "27 objects": lambda _: _holding_rows(),
            "least times": lambda _: _floor_rows(),
            "plans": lambda _: _planned_rows(),
            "library": lambda _: _library_rows(),
            "processes": lambda _: _process_rows(),
            "memory": lambda _: _memory_rows(),
            "environments": lambda _: environment_rows(),
            "sensors": lambda _: sensor_rows(),
            "reproduce": lambda _: _reproduce_rows(),
        }
    return parts_study(parts, asked)


def _loop_chart() -> Chart:
    made = loop_chart(ALL)
    return chart_of([(one, made.measure(one)) for one in made.timed])


def _chart_rows(chart: Chart) -> Iterator[Row]:
    """The fastest methods that read Γ off images as well as the best, and within 0.1."""
    points = [point for point in chart.points if "tracker" in point.settings]
    best = next(point for point in points if point.ours)
    for name, error, target in (
        ("default", None, None),
        ("best-error", best.errors["margin_error"], Bounds(low=100.0)),
        ("error-0.10", 0.10, Bounds(low=300.0)),
        ("error-0.06", 0.06, Bounds(low=450.0)),
    ):
        able = [p for p in points if error is not None and p.errors["margin_error"] <= error]
        point = min(able, key=lambda p: p.milliseconds) if able else best
        case = ("speed", name, point.name)
        yield reported((*case, "margin_error"), point.errors["margin_error"], "")
        yield reported((*case, "displacement"), point.errors["displacement"], "mm")
        yield measured((*case, "speed"), 1e3 / point.milliseconds, "frames/s", target)


def _holding_rows() -> Iterator[Row]:
    """The 27 objects with the cheapest fidelity of each path."""
    for path, fidelity, target in (
        ("truth", TRUTH[-1], Bounds(low=1000.0)),
        ("camera", CAMERA[0], Bounds(low=300.0)),
        ("camera", CAMERA[1], Bounds(low=300.0)),
        ("camera", CAMERA[-1], Bounds(low=300.0)),
    ):
        held, speeds = 0, []
        for index in range(len(OBJECTS)):
            changes = {"path": path, **_CONTROLLER, **object_changes(index), **fidelity.changes}
            summary = run(load_scene(SCENE, changes)).summary
            held += not summary["gross_slip"]
            speeds.append(summary["frames_per_second"])
        case = ("speed", "objects", f"{path}, {fidelity.name}")
        yield at_least((*case, "held"), held, "of 27", 27)
        yield measured((*case, "speed"), float(np.median(speeds)), "frames/s", target)


def _obvious_rows() -> Iterator[Row]:
    """Pyrender, weighted centroids and the same model over the default: each stage and the sum."""
    if (problem := gl_problem()) is not None:
        yield reported(("speed", "obvious", "not_measured"), None, "", problem)
        return
    parts = {}
    for name, changes in {"default": {}, "obvious": _OBVIOUS}.items():
        parts[name] = frame_parts(load_scene(SCENE, {**_CONTROLLER, **changes}))
        for part, spent in parts[name].items():
            yield reported(("speed", "frame", name, part), spent, "ms")
    for part, spent in parts["obvious"].items():
        yield reported(("speed", "obvious", part), spent / parts["default"][part], "×")
    ratio = sum(parts["obvious"].values()) / sum(parts["default"].values())
    yield at_least(("speed", "obvious", "whole"), ratio, "×", 10.0)


def frame_parts(scene: Scene) -> dict[str, float]:
    """Mean time of each stage of a frame [ms], in a run of a scene through the camera.

    A second tracker, estimator and camera repeat the work of the run's own, frame after frame.
    """
    spent = dict.fromkeys(STAGES, 0.0)
    known, noise = known_sensor(scene), scene.camera.noise_levels
    tracker = load_tracker(scene.tracker)(Palette.of_sensor(known.sensor), noise)
    window = scene.safety_margin.friction_window_s
    with one_thread():
        with closing(open_camera(scene)) as camera:
            samples = grasp(scene, camera)
            state = next(samples).state
            rest = tracker.reset(camera.expose_rest(state, scene.camera.rest_frames))
            forces = ForceObserver(known, rest, scene.reconstructor, window)
            states = [state]
            while True:
                with clock(spent, "the rest"):
                    sample = next(samples, None)
                if sample is None:
                    break
                if sample.frame is None:
                    continue  # it was dropped
                states.append(sample.state)
                with clock(spent, "tracking"):
                    tracks = tracker.update(sample.frame)
                with clock(spent, "forces"):
                    forces.observe(sample.state.time, tracks)
        # Afterwards, as two open renderers would slow each other down.
        quiet = replace(scene, camera=replace(scene.camera, noise_levels=0.0))
        with closing(open_camera(quiet)) as camera:
            camera.expose(states[0], 0)
            for index, state in enumerate(states[1:]):
                with clock(spent, "picture"):
                    frame = camera.expose(state, index)
                with clock(spent, "noise"):
                    add_noise(frame.image, noise, scene.seed, index)
    # Until here "the rest" is the time of all stages together.
    spent["the rest"] -= sum(spent[stage] for stage in STAGES[:-1])
    return {stage: 1e3 * seconds / (scene.frames - 1) for stage, seconds in spent.items()}


def _floor_rows() -> Iterator[Row]:
    """Least time of each stage, and the speed of a loop that would take no longer."""
    floors = frame_floors(load_scene(SCENE, _CONTROLLER))
    for stage, least in floors.items():
        yield reported(("speed", "floor", stage), least, "ms")
    yield reported(("speed", "floor", "speed"), 1e3 / sum(floors.values()), "frames/s")


def frame_floors(scene: Scene) -> dict[str, float]:
    """Least time of each stage of a frame [ms]: of skin that holds still, again and again.

    No stage of a run is faster: there markers move, and the stages push each other out of the
    processor's cache. "the rest" is a frame of the same scene on the truth path.
    """
    known, noise = known_sensor(scene), scene.camera.noise_levels
    tracker = load_tracker(scene.tracker)(Palette.of_sensor(known.sensor), noise)
    quiet = replace(scene, camera=replace(scene.camera, noise_levels=0.0))
    truth = run(replace(scene, path="truth")).summary["frames_per_second"]
    with one_thread(), closing(open_camera(scene)) as camera, closing(open_camera(quiet)) as clean:
        samples = grasp(scene, camera)
        state = next(samples).state
        rest = tracker.reset(camera.expose_rest(state, scene.camera.rest_frames))
        forces = ForceObserver(known, rest, scene.reconstructor, scene.period)
        for sample in samples:
            if sample.frame is not None:
                frame, state = sample.frame, sample.state
                tracks = tracker.update(frame)
        still = clean.expose(state, 0)
        work = {
            "picture": lambda: clean.expose(state, 0),
            "noise": lambda: add_noise(still.image, noise, scene.seed, 0),
            "tracking": lambda: tracker.update(frame),
            "forces": lambda: forces.observe(frame.time, tracks),
        }
        least = {stage: 1e3 * _least(do) for stage, do in work.items()}
    return least | {"the rest": 1e3 / truth}


def _least(work: Callable[[], object]) -> float:
    """Least time of many calls [s]."""
    times = []
    for _ in range(_CALLS):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return min(times)


def _planned_rows() -> Iterator[Row]:
    """Share of the fidelities planned for objects outside the table that keep their tolerance."""
    rng = np.random.default_rng(95)
    kept: list[bool] = []
    for index in range(_UNSEEN):
        changes: dict[str, float] = {
            "object.friction": float(rng.uniform(*_FRICTION)),
            "object.stiffness_kpa": float(np.exp(rng.uniform(*np.log(_STIFFNESS)))),
            "object.radius_mm": float(np.exp(rng.uniform(*np.log(_RADIUS)))),
            "camera.noise_levels": float(np.exp(rng.uniform(*np.log(_NOISE)))),
            "seed": 1000 + index,
        }
        scene = load_scene(SCENE, changes | _CONTROLLER)
        errors: dict[Fidelity, float] = {}
        for tolerance in _TOLERANCES:
            try:
                chosen = Fidelity.auto(tolerance, scene).fidelity
            except UserError:
                continue  # no fidelity is known to keep this tolerance
            if chosen not in errors:
                errors[chosen] = _error(chosen, changes)
            kept.append(errors[chosen] <= tolerance)
    yield reported(("speed", "plan", "planned"), len(kept), "of unseen objects and tolerances")
    yield at_least(("speed", "plan", "held"), 100.0 * float(np.mean(kept)), "%", 95.0)


def _error(fidelity: Fidelity, changes: dict[str, float]) -> float:
    """RMS error of Γ, by its estimate and by the chain together."""
    result = run(load_scene(SCENE, changes | _CONTROLLER | fidelity.changes))
    chain = GROUPS["chain"]
    plant = rms(held_margin(chain, fidelity, changes) - held_margin(chain, FINE, changes))
    return float(np.hypot(margin_error(result.trace), plant))


def _library_rows() -> Iterator[Row]:
    """Time of the default over that of the planned fidelity, for the scenes of the library."""
    ratios: dict[str, list[float]] = {"camera": [], "truth": []}
    for name in scene_names():
        for path, of_path in ratios.items():
            usual = Fidelity() if path == "camera" else TRUTH[0]
            try:
                scene = load_scene(name, {"path": path})
                planned = Fidelity.auto(_TOLERANCE, scene).fidelity
            except UserError:
                continue  # it has no pictures, or no fidelity is known to keep this tolerance
            if scene.body != usual.body:
                continue  # it would say nothing of these
            times = [_milliseconds(name, path, fidelity) for fidelity in (usual, planned)]
            of_path.append(times[0] / times[1])
    for path, of_path in ratios.items():
        yield reported(("speed", "plan", path, "scenes"), len(of_path), "of the library")
        yield reported(("speed", "plan", path, "cheaper"), float(np.median(of_path)), "×")
    both = [ratio for of_path in ratios.values() for ratio in of_path]
    yield at_least(("speed", "plan", "cheaper"), float(np.median(both)), "×", 3.0)


def _milliseconds(name: str, path: str, fidelity: Fidelity) -> float:
    result = run(load_scene(name, {"path": path, **fidelity.changes}))
    return 1e3 / result.summary["frames_per_second"]


def _process_rows() -> Iterator[Row]:
    """Grasps per second of two processes over those of one, in pairs that take turns."""
    _seconds(2)  # starts the workers
    ratios = []
    for _index in range(_PAIRS):
        ratios.append(2.0 * _seconds(1) / _seconds(2))
    yield at_least(("speed", "processes", "two_over_one"), float(np.median(ratios)), "×", 1.9)


def _seconds(workers: int) -> float:
    begin = time.perf_counter()
    list(map_processes(_grasps, [_GRASPS] * workers, workers))
    return time.perf_counter() - begin


def _grasps(count: int) -> None:
    for _ in range(count):
        run(load_scene(SCENE, _CONTROLLER))


def _memory_rows() -> Iterator[Row]:
    """Largest memory of a whole `chromagrip grasp`, and how it grows with the frames."""
    yield at_most(("speed", "memory", "grasp"), _grasp([])[1], "MB", 300.0)
    yield at_most(("speed", "memory", "grasp, dome"), _grasp(list(_DOME))[1], "MB", 500.0)
    with tempfile.TemporaryDirectory() as folder:
        more = ["--out", f"{folder}/run"]
        yield at_most(("speed", "memory", "grasp with its folder"), _grasp(more)[1], "MB", 400.0)
    for path, fidelity, frames in (
        ("camera", CAMERA[-1], _LONG // 10),
        ("truth", TRUTH[-1], _LONG),
    ):
        changes = [f"--set={key}={value}" for key, value in fidelity.changes.items()]
        peaks = [
            _grasp(["--path", path, *changes, f"--set=duration_s={count / 60.0}"])[1]
            for count in (_SETTLED, frames)
        ]
        case = ("speed", "memory", f"{path}, {frames} frames")
        yield at_most((*case, "peak"), peaks[1], "MB", 400.0)
        yield reported((*case, "growth"), peaks[1] - peaks[0], "MB")


def _start_rows() -> Iterator[Row]:
    """Whole `chromagrip grasp` of a few frames, once everything is compiled."""
    for path in PATHS:
        times = []
        for _turn in range(_STARTS):
            times.append(_grasp(["--path", path, "--set=duration_s=0.05"])[0])
        yield at_most(("speed", "start-up", path), min(times), "s", 1.0)
    yield at_most(("speed", "start-up", "second scene"), _second_scene(), "s", 0.15)


def _second_scene() -> float:
    """Least time of a grasp of a few frames with another object in the same process [s]."""
    changes: dict[str, object] = {**_CONTROLLER, "duration_s": 0.05}
    times = []
    for index in range(_STARTS + 1):
        scene = load_scene(SCENE, changes | object_changes(index))
        begin = time.perf_counter()
        run(scene)
        times.append(time.perf_counter() - begin)
    return min(times[1:])


def _grasp(options: list[str]) -> tuple[float, float]:
    """Duration [s] and largest memory [MB] of `chromagrip grasp` in a process of its own."""
    scene = [] if "--scene" in options else ["--scene", SCENE]
    return run_child(["grasp", *scene, "--json", *options])


def _reproduce_rows() -> Iterator[Row]:
    """The thesis, on the truth path and through the camera at 1000 Hz, in two processes."""
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        reproduce(
            list(PARTS),
            Plan(quick=False, camera="thesis"),
            Path(folder),
            True,
            2,
            lambda text: None,
        )
    yield at_most(("speed", "reproduce"), (time.perf_counter() - begin) / 60.0, "min", 9.0)
