"""Time per frame of the closed loop against the error of Γ and the slip, by its methods."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...loop.fidelity import Fidelity
from ...loop.run import run
from ...loop.trace import Trace
from ...scene.scene import grasp_command, load_scene
from ..study import Asked, Results, Study, controllers_of, study
from .chart import Axis, Chart, Peer, Point
from .page import chart_study

Array = NDArray[np.float64]

SCENE = "margin-60hz"
#: Fidelities of the camera path, from the default to the cheapest.
CAMERA = (
    Fidelity(),
    Fidelity(step_ms=5.0),
    Fidelity(reconstructor="sequential"),
    Fidelity(reconstructor="sequential", step_ms=5.0),
    Fidelity(reconstructor="sequential", step_ms=5.0, nodes=101),
    Fidelity(tracker="quick", reconstructor="sequential", step_ms=5.0),
    Fidelity(tracker="quick", reconstructor="sequential", step_ms=5.0, nodes=101),
)
#: Fidelities of the truth path, from the default to the cheapest.
TRUTH = tuple(
    Fidelity(tracker="", reconstructor="", step_ms=step, nodes=nodes)
    for step, nodes in ((1.0, 251), (5.0, 251), (1.0, 101), (5.0, 101), (15.0, 101), (15.0, 51))
)
#: Time from which Γ is compared: the first load is held [s].
_HELD = 0.5
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
#: The default methods.
_OURS = "fit, way"
AXES = (
    Axis(key="margin_error", label="Γ, RMS error", unit=""),
    Axis(key="displacement", label="largest slip [mm]", unit="mm"),
)
#: Trackers and reconstructors, the default first. These trackers measure the sizes of markers,
#: without which no reconstructor reads a normal force.
_METHODS = (("fit", "way"), ("fit", "sequential"), ("quick", "sequential"))


def settings(quick: bool) -> dict[str, dict[str, object]]:
    """Changes of the scene, by the name of a setting."""
    changes: dict[str, dict[str, object]] = {
        f"{tracker}, {reconstructor}": {"tracker": tracker, "reconstructor": reconstructor}
        for tracker, reconstructor in _METHODS
    }
    changes[_TRUTH] = {"path": "truth"}
    # The coarse steps that `plan` chooses from, too.
    for fidelity in () if quick else (*CAMERA, *TRUTH):
        if fidelity.step_ms > 1.0:
            chain = f"{fidelity.nodes} nodes, {fidelity.step_ms:g} ms"
            path: dict[str, object] = {} if fidelity.tracker else {"path": "truth"}
            methods = (
                f"{fidelity.tracker}, {fidelity.reconstructor}" if fidelity.tracker else _TRUTH
            )
            changes[f"{methods}, {chain}"] = path | fidelity.changes
    return changes


class Turn(NamedTuple):
    """One setting of the loop with some objects, once.

    Attributes
    ----------
    name: of the setting
    changes: of the scene
    objects: changes for each object
    turn: the turn
    """

    name: str
    changes: dict[str, object]
    objects: tuple[dict[str, object], ...]
    turn: int


@study("chart", "loop", method="controller")
def loop_chart(asked: Asked) -> Study[Turn, dict[str, float]]:
    """Time per frame of the closed loop against the error of Γ and the slip.

    Trackers are those on the front of theirs, with Margin Inversion. Chosen controllers are run
    with the default methods.
    """
    own = controllers_of(asked, SCENE, ())
    chosen = settings(asked.quick)
    for name in own:
        chosen[f"{name}: {_OURS}"] = {"controller": name}
        chosen[f"{name}: {_TRUTH}"] = {"controller": name, "path": "truth"}
    return chart_study(
        chart_of,
        _measured,
        dict[str, float],
        timed=[
            Turn(name, changes, _OBJECTS[:1] if asked.quick else _OBJECTS, turn)
            for turn in range(_QUICK_TURNS if asked.quick else _TURNS)
            for name, changes in chosen.items()
        ],
        words=lambda one: f"{one.name}, turn {one.turn + 1}",
    )


def _measured(one: Turn) -> dict[str, float]:
    """Time of a frame [ms], RMS error of Γ and largest slip [mm] over some objects."""
    squares, slip, spent = [], 0.0, []
    for obj in one.objects:
        result = run(load_scene(SCENE, {**_CONTROLLER, **one.changes, **obj}))
        spent.append(1e3 / result.summary["frames_per_second"])
        squares.append(margin_error(result.trace) ** 2)
        slip = max(slip, float(result.trace["lateral_displacement_mm"][-1]))
    return {
        "time": float(np.median(spent)),
        "margin_error": float(np.sqrt(np.mean(squares))),
        "displacement": slip,
    }


def chart_of(results: Results[Turn, dict[str, float]]) -> Chart:
    """Chart of all turns."""
    points: dict[str, Point] = {}
    for one, found in results:
        point = points.setdefault(
            one.name,
            Point(
                name=one.name,
                times=[],
                errors={axis.key: found[axis.key] for axis in AXES},
                ours="controller" not in one.changes,
                settings=", ".join(f"{key} {value}" for key, value in one.changes.items()),
                command=grasp_command(SCENE, _CONTROLLER | one.changes),
            ),
        )
        point.times.append(found["time"])
    truth = [point for point in points.values() if _TRUTH in point.name]
    return Chart(
        part="loop",
        title="The closed loop at 60 Hz: 400 markers in two layers, 640×480",
        per="frame",
        points=[point for point in points.values() if point not in truth],
        axes=[replace(axis, peers=_peers(axis, truth)) for axis in AXES],
        compared="forces of the model, no picture",
    )


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


def margin_error(trace: Trace) -> float:
    """RMS error of the estimated Γ while loads are held, of all fingers."""
    return rms(margins(trace, "estimated") - margins(trace, "true"))


def margins(trace: Trace, which: str) -> Array:
    """Γ in the frames in which loads are held, of one finger after the other.

    Parameters
    ----------
    which: `true` or `estimated`
    """
    fingers = ("first_", "second_") if "first_margin_true" in trace.columns else ("",)
    held = trace["time_s"] > _HELD
    return np.concatenate([trace[f"{finger}margin_{which}"][held] for finger in fingers])


def rms(values: Array) -> float:
    """RMS of the finite values; infinite where there are none, as where no frame was estimated."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt((finite**2).mean())) if len(finite) else float("inf")
