"""A column of a trace, and how its values follow from a frame."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..control import GripObservation
from ..scene.scene import Mechanics
from ..sensing.contact import Contact
from ..sensing.reader import Reading
from .pinch.world import Pinched
from .sample import Sample

Array = NDArray[np.float64]
Source = TypeVar("Source")

#: Mechanics whose traces have a column.
ALL: tuple[Mechanics, ...] = ("chain", "dome", "pinch")
ONE: tuple[Mechanics, ...] = ("chain", "dome")
SOFT: tuple[Mechanics, ...] = ("dome", "pinch")
TWO: tuple[Mechanics, ...] = ("pinch",)

#: Outcomes of a pinch in the order of their numbers.
OUTCOMES = ("held", "turned", "crushed", "dropped")
#: Units by the ends of the columns' names.
UNITS = {
    "_n_per_m": "N/m",
    "_nmm": "N mm",
    "_kpa": "kPa",
    "_deg": "°",
    "_mm": "mm",
    "_n": "N",
    "_g": "g",
    "_s": "s",
}


@dataclass(frozen=True, kw_only=True)
class Held:
    """Both fingers and the object at a frame.

    Attributes
    ----------
    now: the pinch then
    mass: of the object with what has been added to it [kg]
    rise: of the object's centre of mass since the start [m]
    outcome: the worst so far, by its number
    """

    now: Pinched
    mass: float
    rise: float
    outcome: int


@dataclass(frozen=True, kw_only=True)
class Line:
    """A frame and the finger that a value belongs to.

    Attributes
    ----------
    sample: of the frame
    finger: number of the finger
    held: what two fingers hold; None for one
    """

    sample: Sample
    finger: int = 0
    held: Held | None = None

    @property
    def reading(self) -> Reading:
        """Reading of the finger."""
        return self.sample.readings[self.finger]


@dataclass(frozen=True)
class Column:
    """A column of a trace.

    Attributes
    ----------
    name: of the column, without that of a finger
    meaning: in one line
    value: at a frame; NaN where it is unknown
    topic: in a log; empty if logs leave it out
    bodies: mechanics whose traces have it
    """

    name: str
    meaning: str
    value: Callable[[Line], float]
    topic: str = ""
    bodies: tuple[Mechanics, ...] = ALL

    @property
    def unit(self) -> str:
        """Unit of the values; 1 for a ratio or a count."""
        return next((unit for end, unit in UNITS.items() if self.name.endswith(end)), "1")


def held(name: str, meaning: str, value: Callable[[Held], float], topic: str = "") -> Column:
    """Column of what two fingers hold."""

    def known(line: Line) -> float:
        return math.nan if line.held is None else value(line.held)

    return Column(name, meaning, known, topic, TWO)


def true(value: Callable[[Contact], float]) -> Callable[[Line], float]:
    """Value of a finger's true contact; NaN where the truth is unknown."""

    def known(line: Line) -> float:
        truth = line.sample.truth
        return math.nan if truth is None else value(truth.fingers[line.finger])

    return known


def read(value: Callable[[GripObservation], float]) -> Callable[[Line], float]:
    """Value of a finger's observation; NaN for a dropped frame."""

    def known(line: Line) -> float:
        observation = line.reading.observation
        return math.nan if observation is None else value(observation)

    return known


def estimate(
    name: str,
    words: str,
    value: Callable[[GripObservation], float],
    interval: Callable[[GripObservation], tuple[float, float]],
    bodies: tuple[Mechanics, ...] = ALL,
) -> Iterator[Column]:
    """Columns of an estimate and the ends of its interval."""
    topic = f"/{name}/estimated"
    yield Column(f"{name}_estimated", f"{words} as estimated", read(value), topic, bodies)
    low, high = (f"{end} end of the 90 % interval of {words}" for end in ("lower", "upper"))
    yield Column(f"{name}_low", low, read(lambda seen: interval(seen)[0]), bodies=bodies)
    yield Column(f"{name}_high", high, read(lambda seen: interval(seen)[1]), bodies=bodies)


def deviation(observation: GripObservation, k: int) -> float:
    """Standard deviation of ΣFn (k = 0) or ΣFf (k = 1) [N]."""
    return float(np.sqrt(np.maximum(observation.field.totals_covariance[k, k], 0.0)))


def wrench_columns(
    kind: str,
    words: str,
    known: Callable[[Callable[[Source], float]], Callable[[Line], float]],
    wrench: Callable[[Source], Array],
) -> Iterator[Column]:
    """Columns of the force along x, y, z and the torque about z [N, N·m]."""
    names = [f"force_{axis}_{kind}_n" for axis in "xyz"] + [f"torque_{kind}_nmm"]
    meanings = [f"{words} along the fingertip's {axis}" for axis in "xyz"]
    meanings.append(words.replace("force", "torque") + " about the fingertip's z")
    for k, (name, meaning) in enumerate(zip(names, meanings, strict=True)):

        def value(of: Source, k: int = k) -> float:
            return (1e3 if k == 3 else 1.0) * float(wrench(of)[k])

        yield Column(name, meaning, known(value), bodies=SOFT)


def true_wrench(contact: Contact) -> Array:
    """Wrench of a contact; NaN on a chain."""
    field = contact.field
    return np.full(4, math.nan) if field.directions is None else field.wrench


def visible(line: Line) -> float:
    """Marker pairs that are tracked."""
    tracks = line.reading.tracks
    return math.nan if tracks is None else float(tracks.visible.all(axis=0).sum())
