"""Time per frame of the closed loop against the error of Γ and the slip, by its methods."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from ...loop.run import run
from ...scene.scene import grasp_command, load_scene
from ..worlds.fidelity_table import CAMERA, TRUTH, margin_error
from .chart import Axis, Chart, Peer, Point

_SCENE = "margin-60hz"
_CONTROLLER: dict[str, object] = {"controller": "margin-inversion"}
#: Of the thesis's 27: flat and hard, in between, sharp and soft.
_OBJECTS: tuple[dict[str, object], ...] = (
    {"object.friction": 0.5, "object.stiffness_kpa": 200.0},
    {"object.friction": 0.3, "object.stiffness_kpa": 32.0, "object.radius_mm": 20.0},
    {"object.friction": 0.7, "object.stiffness_kpa": 16.0, "object.radius_mm": 5.0},
)
#: Repeats, and those of a quick run.
_TURNS = 3
_QUICK_TURNS = 1
#: Start of the names of settings that are given the true forces.
_TRUTH = "truth path"
AXES = (
    Axis(key="margin_error", label="Γ, RMS error", unit=""),
    Axis(key="displacement", label="largest slip [mm]", unit="mm"),
)
#: Trackers that are combined with reconstructors, the default first. They measure the sizes of
#: markers, without which no reconstructor reads a normal force.
_TRACKERS = ("fit", "sparse", "quick")
_RECONSTRUCTORS = ("sequential", "gp", "stiffness")


def settings(quick: bool) -> dict[str, dict[str, object]]:
    """Changes of the scene, by the name of a setting."""
    trackers = _TRACKERS[:2] if quick else _TRACKERS
    reconstructors = _RECONSTRUCTORS[:2] if quick else _RECONSTRUCTORS
    changes: dict[str, dict[str, object]] = {
        f"{tracker}, {reconstructor}": {"tracker": tracker, "reconstructor": reconstructor}
        for tracker, reconstructor in product(trackers, reconstructors)
    }
    changes[_TRUTH] = {"path": "truth"}
    # The coarse steps that `plan` chooses from, too.
    for fidelity in () if quick else (*CAMERA, *TRUTH):
        if fidelity.step_ms > 1.0:
            chain = f"{fidelity.nodes} nodes, {fidelity.step_ms:g} ms"
            path: dict[str, object] = {} if fidelity.tracker else {"path": "truth"}
            changes[f"{fidelity.tracker or _TRUTH}, {chain}"] = path | fidelity.changes
    return changes


def chart_loop(quick: bool, progress: Callable[[str], None]) -> Chart:
    """Measure the loop with trackers and reconstructors on the fronts of theirs."""
    points = [
        Point(
            name=name,
            times=[],
            errors={},
            ours=name == "fit, sequential",
            settings=", ".join(f"{key} {value}" for key, value in changes.items()),
            command=grasp_command(_SCENE, _CONTROLLER | changes),
        )
        for name, changes in settings(quick).items()
    ]
    for turn in range(_QUICK_TURNS if quick else _TURNS):
        for point, changes in zip(points, settings(quick).values(), strict=True):
            progress(f"{point.name}, turn {turn + 1}")
            _measure(point, changes, _OBJECTS[:1] if quick else _OBJECTS)
    truth = [point for point in points if point.name.startswith(_TRUTH)]
    return Chart(
        part="loop",
        title="The closed loop at 60 Hz: 400 markers in two layers, 640×480",
        per="frame",
        points=[point for point in points if point not in truth],
        axes=[replace(axis, peers=_peers(axis, truth)) for axis in AXES],
        compared="forces of the model, no picture",
    )


def _measure(
    point: Point, changes: dict[str, object], objects: Sequence[dict[str, object]]
) -> None:
    """Run the loop with each object, and add its time and its errors to a point."""
    squares, slip, spent = [], 0.0, []
    for obj in objects:
        result = run(load_scene(_SCENE, {**_CONTROLLER, **changes, **obj}))
        spent.append(1e3 / result.summary["frames_per_second"])
        squares.append(margin_error(result.trace) ** 2)
        slip = max(slip, float(result.trace["lateral_displacement_mm"][-1]))
    point.times.append(float(np.median(spent)))
    point.errors.update(margin_error=float(np.sqrt(np.mean(squares))), displacement=slip)


def _peers(axis: Axis, truth: Sequence[Point]) -> tuple[Peer, ...]:
    """Loops on the truth path, which no method through the camera can be compared with."""
    return tuple(
        Peer(
            name=point.name,
            milliseconds=point.milliseconds,
            error=point.errors[axis.key],
            source="measured in the same turns; forces as the node model has them, no picture",
        )
        for point in truth
    )
