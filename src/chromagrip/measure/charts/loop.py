"""Time per frame of the closed loop against the error of Γ and the slip, by its methods."""

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from ...loop.run_folder import run
from ...scene.scene import grasp_command, load_scene
from ..worlds.fidelity_table import CAMERA, TRUTH, margin_error
from .chart import Axis, Chart, Peer, Point

_SCENE = "margin-60hz"
#: Of the thesis's 27: flat and hard, in between, sharp and soft.
_OBJECTS: tuple[dict[str, Any], ...] = (
    {"object.friction": 0.5, "object.stiffness_kpa": 200.0},
    {"object.friction": 0.3, "object.stiffness_kpa": 32.0, "object.radius_mm": 20.0},
    {"object.friction": 0.7, "object.stiffness_kpa": 16.0, "object.radius_mm": 5.0},
)
_TURNS, _QUICK_TURNS = 3, 1
_TRUTH = "truth path"
AXES = (
    Axis(key="margin_error", label="Γ, RMS error", unit=""),
    Axis(key="displacement", label="largest slip [mm]", unit="mm"),
)
#: What is combined, the default first; only trackers that measure sizes, without which no
#: reconstructor reads a normal force.
_TRACKERS = ("fit", "thrifty", "sparse")
_RECONSTRUCTORS = ("sequential", "gp", "stiffness")


def settings(quick: bool) -> dict[str, dict[str, Any]]:
    """Changes of the scene, by name."""
    found: dict[str, dict[str, Any]] = {}
    trackers = _TRACKERS[:2] if quick else _TRACKERS
    reconstructors = _RECONSTRUCTORS[:2] if quick else _RECONSTRUCTORS
    for tracker, reconstructor in product(trackers, reconstructors):
        changes = {"tracker": tracker, "reconstructor": reconstructor}
        found[f"{tracker}, {reconstructor}"] = changes
    found[_TRUTH] = {"path": "truth"}
    if not quick:
        # What else `plan` chooses from.
        coarse = [fidelity for fidelity in (*CAMERA, *TRUTH) if fidelity.step_ms > 1.0]
        for fidelity in coarse:
            chain = f"{fidelity.nodes} nodes, {fidelity.step_ms:g} ms"
            path = {} if fidelity.tracker else {"path": "truth"}
            found[f"{fidelity.tracker or _TRUTH}, {chain}"] = path | fidelity.changes
    return found


def chart_loop(quick: bool, progress: Callable[[str], None]) -> Chart:
    """Measure the loop with methods on the fronts; fewer of them where it has to be quick."""
    chosen = settings(quick)
    times: dict[str, list[float]] = {name: [] for name in chosen}
    errors: dict[str, dict[str, float]] = {}
    objects = _OBJECTS[:1] if quick else _OBJECTS
    for turn in range(_QUICK_TURNS if quick else _TURNS):
        for name, changes in chosen.items():
            squares, slip, spent = [], 0.0, []
            for obj in objects:
                progress(f"{name}, turn {turn + 1}")
                scene = load_scene(_SCENE, {"controller": "margin-inversion", **changes, **obj})
                result = run(scene)
                trace = result.trace
                spent.append(1e3 / result.summary["frames_per_second"])
                squares.append(margin_error(trace) ** 2)
                slip = max(slip, float(trace["lateral_displacement_mm"][-1]))
            times[name].append(float(np.median(spent)))
            errors[name] = {
                "margin_error": float(np.sqrt(np.mean(squares))),
                "displacement": slip,
            }
    points = [
        Point(
            name=name,
            times=times[name],
            errors=errors[name],
            ours=name == "fit, sequential",
            settings=", ".join(f"{key} {value}" for key, value in changes.items()),
            command=grasp_command(_SCENE, {"controller": "margin-inversion", **changes}),
        )
        for name, changes in chosen.items()
        if not name.startswith(_TRUTH)
    ]
    axes = [replace(axis, peers=_told(axis, times, errors)) for axis in AXES]
    title = "The closed loop at 60 Hz: 400 markers in two layers, 640×480"
    return Chart(part="loop", title=title, per="frame", points=points, axes=axes)


def _told(
    axis: Axis, times: dict[str, list[float]], errors: dict[str, dict[str, float]]
) -> tuple[Peer, ...]:
    """What the loop takes that is told the forces: no method through the camera is beside it."""
    return tuple(
        Peer(
            name=name,
            milliseconds=float(np.median(times[name])),
            error=errors[name][axis.key],
            source="measured in the same turns; forces as the node model has them, no picture",
        )
        for name in times
        if name.startswith(_TRUTH)
    )
