"""Measurement of the table from which `chromagrip plan` chooses: `./run bench fidelity`."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from chromagrip.loop.fidelity import Fidelity, Measured
from chromagrip.loop.run import run
from chromagrip.measure.charts.loop import CAMERA, SCENE, TRUTH, margin_error, margins, rms
from chromagrip.measure.study import Asked, Results, Study, study
from chromagrip.output.cells import write_cells
from chromagrip.output.page import PageSection
from chromagrip.output.report import Report, Table
from chromagrip.scene.scene import Body, Scene, load_scene
from chromagrip.thesis import DESIRED_MARGIN

Array = NDArray[np.float64]

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
#: Fidelity of the runs that chains are compared with.
FINE = Fidelity(tracker="", reconstructor="", step_ms=0.2, nodes=501)
#: Fidelities of a scene with a dome, from the default to the cheapest; chains stand in for it.
DOMES = tuple(
    Fidelity(tracker="", reconstructor="", step_ms=step, nodes=0, body="dome", pitch_mm=pitch)
    for step, pitch in ((1.0, 0.4), (5.0, 0.4), (5.0, 0.6), (5.0, 0.8), (15.0, 0.8))
)
#: Dome that those are compared with.
FINE_DOME = Fidelity(tracker="", reconstructor="", step_ms=1.0, nodes=0, body="dome", pitch_mm=0.3)


#: Fidelities of a dome as it is built, through its camera and with the true forces.
BUILT = (
    *(
        Fidelity(tracker=tracker, reconstructor="contact", step_ms=step, nodes=0, body="dome")
        for tracker in ("fit", "quick")
        for step in (5.0, 15.0)
    ),
    *(
        Fidelity(tracker="", reconstructor="", step_ms=step, nodes=0, body="dome")
        for step in (2.5, 5.0, 15.0)
    ),
)
#: Steps that those are compared with.
FINE_BUILT = Fidelity(tracker="", reconstructor="", step_ms=1.0, nodes=0, body="dome")
#: µ, stiffness [kPa], radius [mm] and noise [grey levels] of the objects that built domes hold.
_GRIPPED = tuple((mu, kpa, np.inf, 2.0) for mu, kpa in ((0.5, 200.0), (0.3, 200.0), (0.7, 32.0)))


class Group(NamedTuple):
    """Scenes that share fidelities.

    Attributes
    ----------
    scene: shipped scene, in whose situations they are measured
    body: of the scene
    fidelities: that are measured
    best: what they are compared with
    situations: as `SITUATIONS`
    """

    scene: str
    body: Body
    fidelities: tuple[Fidelity, ...]
    best: Fidelity
    situations: tuple[tuple[float, float, float, float], ...]


GROUPS = {
    "chain": Group(SCENE, "chain", (*CAMERA, *TRUTH), FINE, SITUATIONS),
    "dome": Group(
        SCENE,
        "dome",
        (*DOMES, *TRUTH),
        FINE_DOME,
        tuple(one for one in SITUATIONS if one[-1] == SITUATIONS[0][-1]),
    ),
    "dome-2020": Group("chromatouch-2020", "dome", BUILT, FINE_BUILT, _GRIPPED),
    "dome-2022": Group("chromatouch-2022", "dome", BUILT, FINE_BUILT, _GRIPPED),
    "pinch": Group("pinch-lift", "dome", BUILT, FINE_BUILT, _GRIPPED),
}


class Situation(NamedTuple):
    """Group, µ, stiffness [kPa], radius [mm] and noise [grey levels]."""

    group: str
    friction: float
    kpa: float
    radius: float
    noise: float


@study("project", "fidelity", parts=tuple(GROUPS), of_parts="group")
def fidelity_study(asked: Asked) -> Study[Situation, list[Measured]]:
    """Time and error of every fidelity: the table from which `chromagrip plan` chooses.

    Domes of the thesis's design, and the chains that stand in for them, are measured without a
    camera. A quick run has one situation of each group. `fidelity.csv` of the output belongs to
    `src/chromagrip/loop/`.
    """
    situations = [
        Situation(name, *one)
        for name in asked.only or GROUPS
        for one in GROUPS[name].situations[: 1 if asked.quick else None]
    ]

    def show(results: Results[Situation, list[Measured]], out: Path) -> list[PageSection]:
        write_cells([row for _, rows in results for row in rows], out / "fidelity.csv")
        return []

    return Study(
        timed=situations,
        measure=measure,
        result=list[Measured],
        report=report,
        show=show,
        words=lambda one: f"{one.group}, µ {one.friction}, {one.kpa:g} kPa, {one.radius:g} mm",
    )


def report(results: Results[Situation, list[Measured]]) -> Report:
    """Median time, median error and largest error of each fidelity over its situations."""
    found: dict[tuple[str, str], list[Measured]] = {}
    for situation, rows in results:
        for row in rows:
            found.setdefault((situation.group, row.fidelity.name), []).append(row)
    lines = [
        (
            *names,
            f"{np.median([one.milliseconds for one in each]):.2f}",
            f"{np.median([one.error for one in each]):.3f}",
            f"{max(one.error for one in each):.3f}",
        )
        for names, each in found.items()
    ]
    header = ("group", "fidelity", "ms a frame", "error of Γ", "largest")
    return Report(rows=(), tables=(Table(header, tuple(lines), keys=2),))


def measure(situation: Situation) -> list[Measured]:
    """Every fidelity of scenes in a situation, one after the other."""
    group = GROUPS[situation.group]
    obj: dict[str, float] = {
        "object.friction": situation.friction,
        "object.stiffness_kpa": situation.kpa,
        "camera.noise_levels": situation.noise,
    }
    if group.scene == SCENE:
        obj["object.radius_mm"] = situation.radius
    fine = held_margin(group, group.best, obj)
    plants: dict[tuple[str, float, int, float], float] = {}
    table = []
    for fidelity in group.fidelities:
        plant = (fidelity.body, fidelity.step_ms, fidelity.nodes, fidelity.pitch_mm)
        if plant not in plants:
            plants[plant] = rms(held_margin(group, fidelity, obj) - fine)
        changes: dict[str, float | str] = {
            "path": "camera" if fidelity.tracker else "truth",
            "controller": "margin-inversion",
            **obj,
            **fidelity.changes,
        }
        result = run(load_scene(group.scene, changes))
        table.append(
            Measured(
                **vars(fidelity),
                scene_body=group.body,
                sensor=result.scene.sensor,
                fingers=result.scene.fingers,
                rate_hz=result.scene.camera.rate_hz,
                noise=situation.noise,
                friction=situation.friction,
                stiffness_kpa=situation.kpa,
                curvature=1e3 / situation.radius,
                milliseconds=1e3 / result.summary["frames_per_second"],
                seen=margin_error(result.trace) if fidelity.tracker else 0.0,
                plant=plants[plant],
            )
        )
    return table


def held_margin(group: Group, fidelity: Fidelity, changes: dict[str, float]) -> Array:
    """True Γ under a constant grip, while loads are held."""
    scene = load_scene(group.scene, changes)
    bears = changes["object.friction"] * (1.0 - DESIRED_MARGIN)
    constant = {
        "path": "truth",
        "controller": "conservative",
        "conservative.force_n": largest_load(scene) / bears,
    }
    bodily = {key: value for key, value in fidelity.changes.items() if "." in key or key == "body"}
    trace = run(load_scene(group.scene, changes | constant | bodily)).trace
    return margins(trace, "true")


def largest_load(scene: Scene) -> float:
    """Largest load of a finger [N]."""
    if scene.fingers == 1:
        return max(scene.load.forces_n)
    return 0.5e-3 * scene.pinch.mass_g * 9.81
