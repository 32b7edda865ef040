"""How much a scene needs: the cheapest methods and steps that keep Γ within a tolerance."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError
from ..output.cells import read_cells
from ..render import Defects
from ..scene.scene import Scene

#: Of the measured situations, so many that are most like a scene speak for it, the worst of them …
_LIKE = 3
#: … with so much to spare.
_SPARE = 1.25
#: What counts as one step away: in µ, and in the logarithms of stiffness, of curvature (from where
#: it is as good as flat on), of noise and of the camera's rate.
_FRICTION, _STIFFNESS, _CURVED, _FLAT, _NOISE, _RATE = 0.2, 1.2, 0.8, 20.0, 0.5, 0.7


@dataclass(frozen=True, kw_only=True)
class Fidelity:
    """Methods and steps of a run.

    Attributes
    ----------
    tracker, reconstructor: names; empty on the truth path, which has neither
    step_ms: of the node model [ms]
    nodes: of its chain
    """

    tracker: str = "fit"
    reconstructor: str = "sequential"
    step_ms: float = 1.0
    nodes: int = 251

    @property
    def changes(self) -> dict[str, Any]:
        """Dotted key of a scene → value."""
        found: dict[str, Any] = {"fingertip.step_ms": self.step_ms, "fingertip.nodes": self.nodes}
        if self.tracker:
            found |= {"tracker": self.tracker, "reconstructor": self.reconstructor}
        return found

    @property
    def name(self) -> str:
        """In words."""
        chain = f"{self.nodes} nodes in steps of {self.step_ms:g} ms"
        return f"{self.tracker}, {self.reconstructor}, {chain}" if self.tracker else chain

    @staticmethod
    def auto(
        tolerance: float, scene: Scene, measured: "Sequence[Measured] | None" = None
    ) -> "Choice":
        """The cheapest that keeps Γ of a scene within a tolerance, RMS; see `choose`."""
        return choose(tolerance, scene, read(TABLE) if measured is None else measured)


@dataclass(frozen=True, kw_only=True)
class Measured:
    """One fidelity in one situation.

    Attributes
    ----------
    tracker, reconstructor, step_ms, nodes: the fidelity
    rate_hz, noise, friction, stiffness_kpa, curvature: the situation; the last in 1/m
    milliseconds: a frame took
    seen: RMS error of Γ as it was read; 0 on the truth path
    plant: RMS difference of the true Γ to that of a finer chain in finer steps
    """

    tracker: str
    reconstructor: str
    step_ms: float
    nodes: int
    rate_hz: float
    noise: float
    friction: float
    stiffness_kpa: float
    curvature: float
    milliseconds: float
    seen: float
    plant: float

    @property
    def fidelity(self) -> Fidelity:
        """What was measured."""
        return Fidelity(**{field.name: getattr(self, field.name) for field in fields(Fidelity)})

    @property
    def error(self) -> float:
        """RMS error of Γ, of both."""
        return float(np.hypot(self.seen, self.plant))


@dataclass(frozen=True, kw_only=True)
class Choice:
    """A fidelity, what it is expected to cost and to err by, and why it was chosen."""

    fidelity: Fidelity
    milliseconds: float
    error: float
    lines: tuple[str, ...]


#: The table that `chromagrip chart --update` measures.
TABLE = Path(str(files(__package__) / "fidelity.csv"))


def read(path: Path) -> list[Measured]:
    """Table of a file.

    Raises
    ------
    UserError
        When it is no such table.
    """
    try:
        found = list(read_cells(path, Measured))
    except (KeyError, TypeError, ValueError, OSError) as error:
        raise UserError(f"{path} is no table of `chromagrip chart --update`: {error}") from None
    if not found:
        raise UserError(f"{path} is not there or empty; `chromagrip chart --update` makes it")
    return found


def choose(tolerance: float, scene: Scene, measured: Sequence[Measured]) -> Choice:
    """The cheapest fidelity that keeps Γ within a tolerance in situations like a scene's.

    Parameters
    ----------
    tolerance: of the RMS error of Γ
    scene: of which object, friction, camera and path count
    measured: the front to choose from

    Raises
    ------
    UserError
        For a tolerance that is none, a sensor that was not measured, or when nothing is known to
        keep within the tolerance.
    """
    if not 0.0 < tolerance <= 1.0:
        raise UserError(f"--tolerance {tolerance:g}: expected more than 0 and at most 1")
    if scene.path == "camera" and scene.sensor != "thesis":
        raise UserError(
            f"sensor {scene.sensor} was not measured; a fidelity is planned for the sensor thesis"
        )
    if scene.path == "camera" and scene.defects != Defects():
        raise UserError("a fidelity is planned for an image without [defects]: none was measured")
    here = [m for m in measured if bool(m.tracker) == (scene.path == "camera")]
    found: dict[Fidelity, list[Measured]] = {}
    for m in here:
        found.setdefault(m.fidelity, []).append(m)
    expected: dict[Fidelity, tuple[float, float]] = {}
    for fidelity, cells in found.items():
        like = sorted(cells, key=lambda m: _distance(m, scene))[:_LIKE]
        error = _SPARE * max(m.error for m in like)
        expected[fidelity] = float(np.median([m.milliseconds for m in cells])), error
    if not expected:
        raise UserError(f"nothing was measured on the {scene.path} path")
    able = [f for f, (_, error) in expected.items() if error <= tolerance]
    if not able:
        best = min(expected, key=lambda f: expected[f][1])
        raise UserError(
            f"nothing is known to keep Γ within {tolerance:g} here; the best, {best.name}, is "
            f"expected to err by {expected[best][1]:.3f}"
        )
    chosen = min(able, key=lambda f: expected[f][0])
    spent, error = expected[chosen]
    return Choice(
        fidelity=chosen,
        milliseconds=spent,
        error=error,
        lines=tuple(_lines(chosen, expected, tolerance)),
    )


def _distance(m: Measured, scene: Scene) -> float:
    """How unlike a situation and a scene are."""
    obj, camera = scene.object, scene.camera
    steps = [
        (m.friction - obj.friction) / _FRICTION,
        np.log(m.stiffness_kpa / obj.stiffness_kpa) / _STIFFNESS,
        np.log((abs(m.curvature) + _FLAT) / (abs(1e3 / obj.radius_mm) + _FLAT)) / _CURVED,
        np.log((m.noise + 0.5) / (camera.noise_levels + 0.5)) / _NOISE,
        np.log(m.rate_hz / camera.rate_hz) / _RATE,
    ]
    return float(np.hypot.reduce(steps))


def _lines(
    chosen: Fidelity, expected: dict[Fidelity, tuple[float, float]], tolerance: float
) -> list[str]:
    """Why: the choice, and what the others next to it would cost or miss."""
    spent, error = expected[chosen]
    lines = [f"{chosen.name}: {spent:.2g} ms a frame, Γ to {error:.3f} of {tolerance:g}"]
    for fidelity, (cost, off) in sorted(expected.items(), key=lambda item: item[1][0]):
        if fidelity == chosen:
            continue
        if off > tolerance:
            lines.append(f"not {fidelity.name}: {cost:.2g} ms, but Γ to {off:.3f} only")
        else:
            lines.append(f"not {fidelity.name}: keeps Γ to {off:.3f}, but takes {cost:.2g} ms")
    return lines
