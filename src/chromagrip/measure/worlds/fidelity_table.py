"""Measurement of the table from which `chromagrip plan` chooses (`chromagrip chart --update`)."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...loop.fidelity import Fidelity, Measured
from ...loop.run import run
from ...loop.trace import Trace
from ...output.cells import write_cells
from ...scene.scene import Body, load_scene
from ...thesis import DESIRED_MARGIN, LOADS_N

Array = NDArray[np.float64]

SCENE = "margin-60hz"
#: Situations: µ, stiffness [kPa], radius [mm] and noise [grey levels].
SITUATIONS: tuple[tuple[float, float, float, float], ...] = (
    (0.5, 200.0, np.inf, 2.0),
    (0.3, 16.0, np.inf, 2.0),
    (0.7, 32.0, np.inf, 2.0),
    (0.3, 200.0, 20.0, 2.0),
    (0.5, 16.0, 20.0, 2.0),
    (0.7, 200.0, 20.0, 2.0),
    (0.3, 32.0, 5.0, 2.0),
    (0.5, 200.0, 5.0, 2.0),
    (0.7, 16.0, 5.0, 2.0),
    (0.5, 200.0, np.inf, 6.0),
    (0.5, 32.0, 20.0, 6.0),
    (0.5, 16.0, 5.0, 6.0),
)
#: Fidelities of the camera path, from the default to the cheapest.
CAMERA = (
    Fidelity(),
    Fidelity(step_ms=5.0),
    Fidelity(step_ms=5.0, nodes=101),
    Fidelity(tracker="sparse", step_ms=5.0),
    Fidelity(tracker="sparse", step_ms=5.0, nodes=101),
)
#: Fidelities of the truth path, from the default to the cheapest.
TRUTH = tuple(
    Fidelity(tracker="", reconstructor="", step_ms=step, nodes=nodes)
    for step, nodes in ((1.0, 251), (5.0, 251), (1.0, 101), (5.0, 101), (15.0, 101), (15.0, 51))
)
#: Fidelity of the runs that chains are compared with.
FINE = Fidelity(tracker="", reconstructor="", step_ms=0.2, nodes=501)
#: Fidelities of a scene with a dome, from the default to the cheapest; chains stand in for it.
DOMES = tuple(
    Fidelity(tracker="", reconstructor="", step_ms=step, nodes=0, body="dome", pitch_mm=pitch)
    for step, pitch in ((1.0, 0.4), (5.0, 0.4), (5.0, 0.6), (5.0, 0.8), (15.0, 0.8))
)
#: Dome that those are compared with.
FINE_DOME = Fidelity(tracker="", reconstructor="", step_ms=1.0, nodes=0, body="dome", pitch_mm=0.3)
#: Time from which Γ is compared: the first load is held [s].
_HELD = 0.5


#: Of each body: fidelities, what they are compared with, and noises of the situations.
_MEASURED: dict[Body, tuple[tuple[Fidelity, ...], Fidelity, set[float]]] = {
    "chain": ((*CAMERA, *TRUTH), FINE, {noise for *_, noise in SITUATIONS}),
    "dome": ((*DOMES, *TRUTH), FINE_DOME, {SITUATIONS[0][-1]}),
}


def measure(body: Body, progress: Callable[[str], None]) -> list[Measured]:
    """Every fidelity of scenes with a body in every situation, one after the other.

    Domes, and the chains that stand in for them, are measured without a camera.
    """
    fidelities, best, noises = _MEASURED[body]
    table = []
    for friction, kpa, radius, noise in SITUATIONS:
        if noise not in noises:
            continue
        obj = {
            "object.friction": friction,
            "object.stiffness_kpa": kpa,
            "object.radius_mm": radius,
            "camera.noise_levels": noise,
        }
        told = f"{body}, µ {friction}, {kpa:g} kPa, {radius:g} mm, noise {noise:g}"
        progress(f"{told}: {best.name}")
        fine = held_margin(best, obj)
        plants: dict[tuple[str, float, int, float], float] = {}
        for fidelity in fidelities:
            progress(f"{told}: {fidelity.name}")
            plant = (fidelity.body, fidelity.step_ms, fidelity.nodes, fidelity.pitch_mm)
            if plant not in plants:
                plants[plant] = rms(held_margin(fidelity, obj) - fine)
            changes: dict[str, float | str] = {
                "path": "camera" if fidelity.tracker else "truth",
                "controller": "margin-inversion",
                **obj,
                **fidelity.changes,
            }
            result = run(load_scene(SCENE, changes))
            table.append(
                Measured(
                    **vars(fidelity),
                    scene_body=body,
                    rate_hz=result.scene.camera.rate_hz,
                    noise=noise,
                    friction=friction,
                    stiffness_kpa=kpa,
                    curvature=1e3 / radius,
                    milliseconds=1e3 / result.summary["frames_per_second"],
                    seen=margin_error(result.trace) if fidelity.tracker else 0.0,
                    plant=plants[plant],
                )
            )
    return table


def update(path: Path, progress: Callable[[str], None]) -> list[Measured]:
    """Measure the table and write it; what was there stays until the new one is complete.

    Raises
    ------
    UserError
        When it cannot be written.
    """
    table = measure("chain", progress) + measure("dome", progress)
    try:
        write_cells(table, path)
    except OSError as error:
        raise UserError(f"{path} cannot be written: {error.strerror}") from None
    return table


def margin_error(trace: Trace) -> float:
    """RMS error of the estimated Γ while loads are held."""
    return rms((trace["margin_estimated"] - trace["margin_true"])[_held(trace)])


def held_margin(fidelity: Fidelity, changes: dict[str, float]) -> Array:
    """True Γ under a constant grip, while loads are held."""
    grip = max(LOADS_N) / (changes["object.friction"] * (1.0 - DESIRED_MARGIN))
    constant = {
        "path": "truth",
        "controller": "conservative",
        "conservative.force_n": grip,
    }
    bodily = {key: value for key, value in fidelity.changes.items() if "." in key or key == "body"}
    trace = run(load_scene(SCENE, changes | constant | bodily)).trace
    return trace["margin_true"][_held(trace)]


def _held(trace: Trace) -> NDArray[np.bool_]:
    return np.asarray(trace["time_s"] > _HELD)


def rms(values: Array) -> float:
    """RMS of the finite values; infinite where there are none, as where no frame was estimated."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt((finite**2).mean())) if len(finite) else float("inf")
