"""Figures of the closed loop: what the validation experiment must show, and its speed."""

from collections.abc import Callable, Iterator

from ...loop.run import run
from ...output.report import Report, Row, reported, within
from ...render.drawing import gl_problem
from ...scene.scene import load_scene
from ..environments import environment_rows
from .speed import speed_rows


def bench_loop(quick: bool, progress: Callable[[str], None]) -> Report:
    """Report of the closed loop.

    Parameters
    ----------
    quick: leave out the 1000 Hz run through the camera, the mesh renderer and all rows of speed
    progress: called with the name of each run
    """
    rows = list(_truth_rows(progress))
    runs = [("camera-100hz", "painter")]
    if not quick:
        runs += [("camera-100hz", "pyrender"), ("thesis", "painter")]
    for scene, renderer in runs:
        rows += _camera_rows(scene, renderer, progress)
    for controller in ("react-to-slip", "conservative"):
        progress(f"camera-100hz, {controller}, camera path")
        summary = run(load_scene("camera-100hz", {"controller": controller})).summary
        case = ("camera-100hz", controller)
        rows.append(reported((*case, "margin_rmse"), summary["margin_rmse"], ""))
        rows.append(reported((*case, "displacement"), summary["lateral_displacement_mm"], "mm"))
    if not quick:
        rows += speed_rows(progress)
        rows += environment_rows(progress)
    return Report(rows=tuple(rows), quick=quick)


def _truth_rows(progress: Callable[[str], None]) -> Iterator[Row]:
    results = {}
    for controller in ("safety-margin", "react-to-slip", "conservative"):
        progress(f"thesis, {controller}, truth path")
        scene = load_scene("thesis", {"path": "truth", "controller": controller})
        results[controller] = run(scene)
    slip = {name: one.summary["lateral_displacement_mm"] for name, one in results.items()}
    final = results["safety-margin"].summary["final_margin_true"]
    yield within(("truth", "safety-margin", "final_margin"), final, "", 0.28, 0.32)
    yield within(("truth", "safety-margin", "displacement"), slip["safety-margin"], "mm", 0.0, 0.05)
    events = results["react-to-slip"].summary["slip_reactions"]
    time = events[0]["time_s"] if events else None
    yield within(("truth", "react-to-slip", "reactions"), len(events), "", 1, 1)
    yield within(("truth", "react-to-slip", "time"), time, "s", 1.35, 1.45)
    yield within(
        ("truth", "react-to-slip", "displacement"), slip["react-to-slip"], "mm", 1.25, 1.35
    )
    margin = results["conservative"].trace["margin_true"]
    yield within(("truth", "conservative", "margin_first_load"), margin[990], "", 0.89, 0.91)
    yield within(("truth", "conservative", "margin_second_load"), margin[-1], "", 0.73, 0.75)
    yield within(("truth", "conservative", "displacement"), slip["conservative"], "mm", 0.0, 0.005)


def _camera_rows(scene: str, renderer: str, progress: Callable[[str], None]) -> Iterator[Row]:
    case = (scene, renderer)
    if renderer == "pyrender" and (problem := gl_problem()) is not None:
        yield reported((*case, "not_measured"), None, "", problem)
        return
    progress(f"{scene}, safety-margin, camera path, {renderer}")
    summary = run(load_scene(scene, {"renderer": renderer})).summary
    slip = summary["lateral_displacement_mm"]
    yield within((*case, "displacement"), slip, "mm", 0.0, 0.2)
    for end in ("min", "max"):
        margin = summary[f"margin_true_{end}_last_300ms"]
        yield within((*case, f"margin_late_{end}"), margin, "", 0.15, 0.5)
    yield reported((*case, "margin_rmse"), summary["margin_rmse"], "")
    yield reported((*case, "speed"), summary["frames_per_second"], "frames/s")
