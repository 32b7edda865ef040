"""A column of a trace, and the function of a frame that gives its values."""

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
    now: state of the pinch
    mass: mass of the object with the mass added to it [kg]
    rise: rise of the object's centre of mass since the start [m]
    outcome: number of the worst outcome so far, see `OUTCOMES`
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
    sample: sample of the frame
    finger: number of the finger
    held: both fingers and their object; None for one finger
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
    name: name of the column, without that of a finger
    meaning: one line of text
    value: function of a frame that gives the value; NaN if it is unknown
    topic: topic in a log; empty: not in logs
    bodies: mechanics whose traces have the column
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
    """Make a column of a grasp with two fingers."""

    def known(line: Line) -> float:
        return math.nan if line.held is None else value(line.held)

    return Column(name, meaning, known, topic, TWO)


def true(value: Callable[[Contact], float]) -> Callable[[Line], float]:
    """Make a function for a value of a finger's true contact; NaN if the truth is unknown."""

    def known(line: Line) -> float:
        truth = line.sample.truth
        return math.nan if truth is None else value(truth.fingers[line.finger])

    return known


def read(value: Callable[[GripObservation], float]) -> Callable[[Line], float]:
    """Make a function for a value of a finger's observation; NaN for a dropped frame."""

    def known(line: Line) -> float:
        observation = line.reading.observation
        return math.nan if observation is None else value(observation)

    return known


def estimated(value: Callable[[GripObservation], float]) -> Callable[[Line], float]:
    """Make a function for a value of a finger's estimated forces; NaN where there are none."""
    return read(lambda o: math.nan if o.no_estimate else value(o))


def estimate(
    name: str,
    words: str,
    value: Callable[[GripObservation], float],
    interval: Callable[[GripObservation], tuple[float, float]],
    bodies: tuple[Mechanics, ...] = ALL,
) -> Iterator[Column]:
    """Make the columns of an estimate and the ends of its interval, NaN where there is none."""
    topic = f"/{name}/estimated"
    yield Column(f"{name}_estimated", f"estimated {words}", estimated(value), topic, bodies)
    low, high = (f"{words}, {end} end (90 % interval)" for end in ("lower", "upper"))
    yield Column(f"{name}_low", low, estimated(lambda o: interval(o)[0]), bodies=bodies)
    yield Column(f"{name}_high", high, estimated(lambda o: interval(o)[1]), bodies=bodies)


def deviation(observation: GripObservation, k: int) -> float:
    """Standard deviation of ΣFn (k = 0) or ΣFf (k = 1) [N]."""
    return float(np.sqrt(np.maximum(observation.field.totals_covariance[k, k], 0.0)))


def wrench_columns(
    kind: str,
    words: str,
    known: Callable[[Callable[[Source], float]], Callable[[Line], float]],
    wrench: Callable[[Source], Array],
) -> Iterator[Column]:
    """Make the columns of the force along x, y, z [N] and the torque about z [N·mm]."""
    names = [f"force_{axis}_{kind}_n" for axis in "xyz"] + [f"torque_{kind}_nmm"]
    meanings = [f"{words} along {axis}" for axis in "xyz"]
    meanings.append(words.replace("force", "torque") + " about z")
    for k, (name, meaning) in enumerate(zip(names, meanings, strict=True)):

        def value(of: Source, k: int = k) -> float:
            return (1e3 if k == 3 else 1.0) * float(wrench(of)[k])

        yield Column(name, meaning, known(value), bodies=SOFT)


def true_wrench(contact: Contact) -> Array:
    """Wrench of a contact [N, N·m], shape (4,); NaN on a chain."""
    field = contact.field
    return np.full(4, math.nan) if field.directions is None else field.wrench


def visible(line: Line) -> float:
    """Number of marker pairs whose layers are both visible; NaN without tracks."""
    tracks = line.reading.tracks
    return math.nan if tracks is None else float(tracks.visible.all(axis=0).sum())
