"""Figures of the closed loop: what the validation experiment must show, on both paths."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

from ...loop.record import Result
from ...loop.run import run
from ...output.report import Report, Row, reported, within
from ...render.drawing import gl_problem
from ...scene.scene import load_scene
from ..study import Asked, Study, controllers_of, study


class LoopRun(NamedTuple):
    """A run of the experiment.

    Attributes
    ----------
    path, scene, controller: of the run
    renderer: of its pictures; empty is the scene's
    """

    path: str
    scene: str
    controller: str
    renderer: str = ""


@study("bench", "loop", method="controller")
def loop_study(asked: Asked) -> Study[LoopRun, tuple[Row, ...]]:
    """Experiment of the thesis in the closed loop: safety margins and slips on both paths.

    A quick run leaves out the 1000 Hz run through the camera and the mesh renderer. Controllers
    that are chosen are run in the same scenes.
    """
    own = controllers_of(asked, "thesis", ())
    runs = [LoopRun("truth", "thesis", name) for name in (*_TRUTH, *own)]
    runs.append(LoopRun("camera", "camera-100hz", "safety-margin", "painter"))
    if not asked.quick:
        runs.append(LoopRun("camera", "camera-100hz", "safety-margin", "pyrender"))
        runs.append(LoopRun("camera", "thesis", "safety-margin", "painter"))
    others = ("react-to-slip", "conservative", *own)
    runs += [LoopRun("camera", "camera-100hz", name) for name in others]
    return Study(
        settings=runs,
        measure=rows_of,
        result=tuple[Row, ...],
        report=lambda results: Report(rows=tuple(row for _, rows in results for row in rows)),
        words=lambda one: " ".join(filter(None, one)),
    )


def rows_of(setting: LoopRun) -> tuple[Row, ...]:
    """Figures of a run."""
    if setting.path == "truth":
        return tuple(_TRUTH.get(setting.controller, _reported)(setting))
    return tuple(_margins(setting) if setting.renderer else _reported(setting))


def _reported(setting: LoopRun) -> Iterator[Row]:
    """Figures of a run without targets."""
    changes = {"path": setting.path, "controller": setting.controller}
    summary = run(load_scene(setting.scene, changes)).summary
    case = ("truth" if setting.path == "truth" else setting.scene, setting.controller)
    if setting.path == "truth":
        yield reported((*case, "final_margin"), summary["final_margin_true"], "")
    else:
        yield reported((*case, "margin_rmse"), summary["margin_rmse"], "")
    yield reported((*case, "displacement"), summary["lateral_displacement_mm"], "mm")


def _safety_margin(setting: LoopRun) -> Iterator[Row]:
    summary = _on_truth(setting).summary
    case, slip = ("truth", "safety-margin"), summary["lateral_displacement_mm"]
    yield within((*case, "final_margin"), summary["final_margin_true"], "", 0.28, 0.32)
    yield within((*case, "displacement"), slip, "mm", 0.0, 0.05)


def _react_to_slip(setting: LoopRun) -> Iterator[Row]:
    summary = _on_truth(setting).summary
    case, slip = ("truth", "react-to-slip"), summary["lateral_displacement_mm"]
    events = summary["slip_reactions"]
    time = events[0]["time_s"] if events else None
    yield within((*case, "reactions"), len(events), "", 1, 1)
    yield within((*case, "time"), time, "s", 1.35, 1.45)
    yield within((*case, "displacement"), slip, "mm", 1.25, 1.35)


def _conservative(setting: LoopRun) -> Iterator[Row]:
    result = _on_truth(setting)
    case, margin = ("truth", "conservative"), result.trace["margin_true"]
    slip = result.summary["lateral_displacement_mm"]
    yield within((*case, "margin_first_load"), margin[990], "", 0.89, 0.91)
    yield within((*case, "margin_second_load"), margin[-1], "", 0.73, 0.75)
    yield within((*case, "displacement"), slip, "mm", 0.0, 0.005)


#: Figures of the controllers that the thesis compares, on the truth path.
_TRUTH: dict[str, Callable[[LoopRun], Iterator[Row]]] = {
    "safety-margin": _safety_margin,
    "react-to-slip": _react_to_slip,
    "conservative": _conservative,
}


def _on_truth(setting: LoopRun) -> Result:
    return run(load_scene(setting.scene, {"path": "truth", "controller": setting.controller}))


def _margins(setting: LoopRun) -> Iterator[Row]:
    """Figures of Safety Margin through the camera."""
    case = (setting.scene, setting.renderer)
    if setting.renderer == "pyrender" and (problem := gl_problem()) is not None:
        yield reported((*case, "not_measured"), None, "", problem)
        return
    summary = run(load_scene(setting.scene, {"renderer": setting.renderer})).summary
    slip = summary["lateral_displacement_mm"]
    yield within((*case, "displacement"), slip, "mm", 0.0, 0.2)
    for end in ("min", "max"):
        margin = summary[f"margin_true_{end}_last_300ms"]
        yield within((*case, f"margin_late_{end}"), margin, "", 0.15, 0.5)
    yield reported((*case, "margin_rmse"), summary["margin_rmse"], "")
    yield reported((*case, "speed"), summary["frames_per_second"], "frames/s")
