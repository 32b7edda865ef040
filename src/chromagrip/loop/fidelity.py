"""Fidelity of a run: the cheapest methods and steps that keep Γ within a tolerance."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from importlib.resources import files
from math import ceil
from pathlib import Path

import numpy as np

from ..errors import UserError
from ..output.cells import read_cells
from ..render import Defects
from ..scene.dome import DomeSettings
from ..scene.scene import Body, Scene
from ..strict_toml import Values


@dataclass(frozen=True, kw_only=True)
class Fidelity:
    """Methods and steps of a run.

    Attributes
    ----------
    tracker, reconstructor: names; empty on the truth path
    step_ms: longest step of the body [ms]
    nodes: number of nodes of a chain; 0 for a dome
    body: body of the fingertip
    pitch_mm: distance between the nodes of a dome [mm]; 0 for a chain, and for the dome of a built
        sensor as it is
    """

    tracker: str = "fit"
    reconstructor: str = "way"
    step_ms: float = 1.0
    nodes: int = 251
    body: Body = "chain"
    pitch_mm: float = 0.0

    @property
    def changes(self) -> Values:
        """Changes to a scene: dotted key → value."""
        changes: Values = {"fingertip.step_ms": self.step_ms}
        bodies: dict[Body, Values] = {
            "chain": {"fingertip.nodes": self.nodes},
            "dome": {"body": "dome", "dome.pitch_mm": self.pitch_mm},
        }
        if not self.pitch_mm:  # the sensor's own
            del bodies["dome"]["dome.pitch_mm"]
        changes |= bodies[self.body]
        if self.tracker:
            changes |= {"tracker": self.tracker, "reconstructor": self.reconstructor}
        return changes

    @property
    def name(self) -> str:
        """Methods and steps as text."""
        body = {
            "chain": f"{self.nodes} nodes",
            "dome": f"a dome with nodes every {self.pitch_mm:g} mm" if self.pitch_mm else "a dome",
        }[self.body]
        steps = f"{body} in steps of {self.step_ms:g} ms"
        return f"{self.tracker}, {self.reconstructor}, {steps}" if self.tracker else steps

    @staticmethod
    def auto(
        tolerance: float, scene: Scene, measured: "Sequence[Measured] | None" = None
    ) -> "Choice":
        """Choose the cheapest fidelity that keeps the RMS error of Γ within a tolerance.

        Parameters as in `choose`; `measured` is the shipped table by default.
        """
        return choose(tolerance, scene, read(TABLE) if measured is None else measured)


@dataclass(frozen=True, kw_only=True)
class Measured:
    """One fidelity in one situation.

    Attributes
    ----------
    tracker, reconstructor, step_ms, nodes, body, pitch_mm: fidelity, see `Fidelity`
    scene_body: body of the scene; a fidelity with another body approximates it
    sensor: design of the sensor
    fingers: number of fingers
    rate_hz, noise, friction, stiffness_kpa, curvature: situation [Hz, grey levels, 1, kPa, 1/m]
    milliseconds: time for a frame [ms]
    seen: RMS error of the estimate of Γ; 0 on the truth path
    plant: RMS difference of the true Γ to that of a finer body of the scene in finer steps
    """

    tracker: str
    reconstructor: str
    step_ms: float
    nodes: int
    body: str
    pitch_mm: float
    scene_body: str
    rate_hz: float
    noise: float
    friction: float
    stiffness_kpa: float
    curvature: float
    milliseconds: float
    seen: float
    plant: float
    sensor: str = "thesis"
    fingers: int = 1

    @property
    def fidelity(self) -> Fidelity:
        """Measured fidelity."""
        return Fidelity(**{field.name: getattr(self, field.name) for field in fields(Fidelity)})

    @property
    def error(self) -> float:
        """RMS error of Γ, from estimate and body together."""
        return float(np.hypot(self.seen, self.plant))


@dataclass(frozen=True, kw_only=True)
class Expected:
    """A fidelity in situations like a scene's.

    Attributes
    ----------
    fidelity: methods and steps
    milliseconds: time for a frame [ms]
    typical: RMS error of Γ, the median of the situations most like the scene's
    error: the largest of them, with a safety factor
    """

    fidelity: Fidelity
    milliseconds: float
    typical: float
    error: float

    def changes(self, scene: Scene) -> Values:
        """Changes of a scene, dotted key → value."""
        changes = {"body": self.fidelity.body} | self.fidelity.changes
        if changes["body"] == scene.body:
            del changes["body"]
        return changes


@dataclass(frozen=True, kw_only=True)
class Choice:
    """A choice for a scene.

    Attributes
    ----------
    fidelity: chosen fidelity
    changes: changes to the scene, dotted key → value
    milliseconds: expected time for a frame [ms]
    error: expected RMS error of Γ
    lines: reasons as text
    """

    fidelity: Fidelity
    changes: Values
    milliseconds: float
    error: float
    lines: tuple[str, ...]


#: Number of measured situations most like a scene's that its error is taken from, and the factor
#: on the largest of them.
ALIKE, SAFETY = 3, 1.25
#: Table of measured fidelities; `./run bench fidelity` of the checkout makes it.
TABLE = Path(str(files(__package__) / "fidelity.csv"))


def read(path: Path) -> list[Measured]:
    """Read a table of measured fidelities.

    Raises
    ------
    UserError
        When the file is missing, or is not such a table.
    """
    try:
        measured = list(read_cells(path, Measured))
    except UserError as error:
        raise UserError(f"{path} is not a table of measured fidelities: {error}") from None
    if not measured:
        raise UserError(f"{path} is missing or empty: install chromagrip again")
    return measured


def expected(scene: Scene, measured: Sequence[Measured]) -> list[Expected]:
    """Time and error of every fidelity in situations like a scene's, the fastest first.

    Parameters
    ----------
    scene: scene whose object, friction, camera and path are compared with the measured ones
    measured: fidelities to choose from

    Raises
    ------
    UserError
        For a scene in which none was measured.
    """
    alike = [m for m in measured if m.fingers == scene.fingers]
    known = dict.fromkeys(m.sensor for m in alike)
    if scene.path == "camera" and scene.sensor not in known:
        raise UserError(
            f"sensor {scene.sensor} was not measured; a fidelity is planned for {', '.join(known)}"
        )
    if scene.path == "camera" and scene.sensor == "thesis" and scene.defects != Defects():
        raise UserError("a fidelity is planned for an image without [defects]; set no defects")
    obj = scene.object
    if scene.fingers == 1 and (obj.mesh or obj.shape != "ball"):
        raise UserError(
            f"a fidelity is planned for flat and round objects; object.shape = {obj.shape}"
            f"{' with a mesh' if obj.mesh else ''} was not measured"
        )
    cells_of: dict[Fidelity, list[Measured]] = {}
    for m in alike:
        if scene.sensor in known and m.sensor != scene.sensor:
            continue
        if m.scene_body != scene.body or (m.body != scene.body and not _plane(scene)):
            continue
        if m.step_ms > 1e3 * scene.period * (1.0 + 1e-9):  # a frame is at least one step
            continue
        if bool(m.tracker) == (scene.path == "camera"):
            cells_of.setdefault(m.fidelity, []).append(m)
    found = []
    for fidelity, cells in cells_of.items():
        like = [m.error for m in sorted(cells, key=lambda m: _distance(m, scene))[:ALIKE]]
        found.append(
            Expected(
                fidelity=fidelity,
                milliseconds=float(np.median([m.milliseconds for m in cells])),
                typical=float(np.median(like)),
                error=SAFETY * max(like),
            )
        )
    if not found:
        raise UserError(f"no fidelity was measured on the {scene.path} path")
    return sorted(found, key=lambda one: one.milliseconds)


def choose(tolerance: float, scene: Scene, measured: Sequence[Measured]) -> Choice:
    """Choose the cheapest fidelity that keeps Γ within a tolerance in situations like a scene's.

    Parameters
    ----------
    tolerance: largest RMS error of Γ, above 0 and at most 1
    scene, measured: see `expected`

    Raises
    ------
    UserError
        For a tolerance out of range, a scene that was not measured, or when no fidelity is known to
        keep Γ within the tolerance.
    """
    if not 0.0 < tolerance <= 1.0:
        raise UserError(f"--tolerance {tolerance:g}: expected more than 0 and at most 1")
    every = expected(scene, measured)
    chosen = next((one for one in every if one.error <= tolerance), None)
    if chosen is None:
        best = min(every, key=lambda one: one.error)
        raise UserError(
            f"no fidelity is known to keep Γ within {tolerance:g} here; the best, "
            f"{best.fidelity.name}, errs by up to {best.error:.3f}: give a tolerance of "
            f"{ceil(1000 * best.error) / 1000:g} or more"
        )
    return Choice(
        fidelity=chosen.fidelity,
        changes=chosen.changes(scene),
        milliseconds=chosen.milliseconds,
        error=chosen.error,
        lines=tuple(_lines(chosen, every, tolerance)),
    )


def _plane(scene: Scene) -> bool:
    """Return True if a chain can approximate the body: the scene is in one plane."""
    load, obj = scene.load, scene.object
    return (
        scene.dome == DomeSettings()
        and not any(load.sideways_n)
        and not any(load.twists_nmm)
        and not any(obj.turned_deg)
        and not any(obj.beside_mm)
    )


def _distance(m: Measured, scene: Scene) -> float:
    """Distance between a measured situation and a scene."""
    obj, camera = scene.object, scene.camera
    # Differences that count as one unit of distance: of µ, and of logarithms. A curvature [1/m] may
    # be 0, so that an offset is added.
    friction_unit, stiffness_unit, rate_unit = 0.2, 1.2, 0.7
    curvature_unit, curvature_offset = 0.8, 20.0
    noise_unit, noise_offset = 0.5, 0.5
    differences = [
        (m.friction - obj.friction) / friction_unit,
        np.log(m.stiffness_kpa / obj.stiffness_kpa) / stiffness_unit,
        np.log(
            (abs(m.curvature) + curvature_offset) / (abs(1e3 / obj.radius_mm) + curvature_offset)
        )
        / curvature_unit,
        np.log((m.noise + noise_offset) / (camera.noise_levels + noise_offset)) / noise_unit,
        np.log(m.rate_hz / camera.rate_hz) / rate_unit,
    ]
    return float(np.hypot.reduce(differences))


def _lines(chosen: Expected, every: Sequence[Expected], tolerance: float) -> Iterator[str]:
    """Give reasons: the choice, and time and error of every other fidelity."""
    name, spent = chosen.fidelity.name, chosen.milliseconds
    yield f"{name}: {spent:.2g} ms a frame, an error of Γ of at most {chosen.error:.3f}"
    for one in every:
        name, spent = one.fidelity.name, one.milliseconds
        if one.error > tolerance:
            yield f"not {name}: {spent:.2g} ms, but an error of up to {one.error:.3f}"
        elif one != chosen:
            yield f"not {name}: up to {one.error:.3f}, but slower: {spent:.2g} ms"
