"""Figures measured in one call, each beside its target: the tables in docs/ are printed by this."""

from collections.abc import Callable, Iterator
from typing import Any

from ...errors import UserError
from ...loop.run_folder import Result, run
from ...output.rows import Row, report, reported, within
from ...render.drawing.gl import gl_problem
from ...scene.scene import load_scene
from .control import bench_control
from .dataset import bench_dataset
from .force import bench_force
from .model import bench_model
from .render import bench_render
from .speed import speed_rows
from .track import bench_track


def bench_loop(quick: bool, progress: Callable[[str], None]) -> list[Row]:
    """Rows of the closed loop: what the validation experiment must show, and how fast it runs.

    Parameters
    ----------
    quick: leave out the 1000 Hz run through the camera, the mesh renderer and all on speed
    progress: told what is being run
    """
    rows = list(_truth_rows(progress))
    runs = [("camera-100hz", "painter")]
    if not quick:
        runs += [("camera-100hz", "pyrender"), ("thesis", "painter")]
    for scene, renderer in runs:
        rows += _camera_rows(scene, renderer, progress)
    for controller in ("react-to-slip", "conservative"):
        progress(f"camera-100hz, {controller}, camera path")
        result = run(load_scene("camera-100hz", {"controller": controller}))
        name = f"camera-100hz/{controller}"
        rows.append(_measured(f"{name}/margin_rmse", result, "margin_rmse", ""))
        rows.append(_measured(f"{name}/displacement", result, "lateral_displacement_mm", "mm"))
    return rows if quick else [*rows, *speed_rows(progress)]


def _truth_rows(progress: Callable[[str], None]) -> Iterator[Row]:
    results = {}
    for controller in ("safety-margin", "react-to-slip", "conservative"):
        progress(f"thesis, {controller}, truth path")
        scene = load_scene("thesis", {"path": "truth", "controller": controller})
        results[controller] = run(scene)
    hold = results["safety-margin"].summary
    yield within("truth/safety-margin/final_margin", hold["final_margin_true"], "", 0.28, 0.32)
    yield within(
        "truth/safety-margin/displacement", hold["lateral_displacement_mm"], "mm", 0.0, 0.05
    )
    react = results["react-to-slip"].summary
    events = react["slip_reactions"]
    yield within("truth/react-to-slip/reactions", float(len(events)), "", 1, 1)
    time = events[0]["time_s"] if events else None
    yield within("truth/react-to-slip/time", time, "s", 1.35, 1.45)
    yield within(
        "truth/react-to-slip/displacement", react["lateral_displacement_mm"], "mm", 1.25, 1.35
    )
    trace = results["conservative"].trace
    before = float(trace["margin_true"][990])
    yield within("truth/conservative/margin_first_load", before, "", 0.89, 0.91)
    yield within(
        "truth/conservative/margin_second_load", float(trace["margin_true"][-1]), "", 0.73, 0.75
    )
    constant = results["conservative"].summary["lateral_displacement_mm"]
    yield within("truth/conservative/displacement", constant, "mm", 0.0, 0.005)


def _camera_rows(scene: str, renderer: str, progress: Callable[[str], None]) -> list[Row]:
    name = f"{scene}/{renderer}"
    if renderer == "pyrender" and (problem := gl_problem()) is not None:
        return [Row(f"{name}/not_measured", None, "", problem, False)]
    progress(f"{scene}, safety-margin, camera path, {renderer}")
    result = run(load_scene(scene, {"renderer": renderer}))
    summary = result.summary
    return [
        within(f"{name}/displacement", summary["lateral_displacement_mm"], "mm", 0.0, 0.2),
        within(f"{name}/margin_late_min", summary["margin_true_min_last_300ms"], "", 0.15, 0.5),
        within(f"{name}/margin_late_max", summary["margin_true_max_last_300ms"], "", 0.15, 0.5),
        _measured(f"{name}/margin_rmse", result, "margin_rmse", ""),
        _measured(f"{name}/speed", result, "frames_per_second", "frames/s"),
    ]


def _measured(name: str, result: Result, key: str, unit: str) -> Row:
    """A figure of the summary, reported as it is."""
    return reported(name, result.summary[key], unit)


PARTS: dict[str, Callable[..., list[Row]]] = {
    "loop": bench_loop,
    "model": bench_model,
    "render": bench_render,
    "track": bench_track,
    "force": bench_force,
    "control": bench_control,
    "dataset": bench_dataset,
}


def bench(
    part: str,
    quick: bool,
    progress: Callable[[str], None],
    trackers: tuple[str, ...] = (),
    reconstructors: tuple[str, ...] = (),
    controllers: tuple[str, ...] = (),
) -> dict[str, Any]:
    """Measure a part: the machine, and a row per figure.

    Raises
    ------
    UserError
        When trackers, reconstructors or controllers are given for a part without any, or are not
        there.
    """
    chosen = {
        "track": ("--tracker", trackers),
        "force": ("--reconstructor", reconstructors),
        "control": ("--controller", controllers),
    }
    for its_part, (option, names) in chosen.items():
        if names and part != its_part:
            raise UserError(f"{option} goes with bench {its_part}, not with bench {part}")
    more = (chosen[part][1],) if part in chosen else ()
    return report(PARTS[part](quick, progress, *more), quick)
