"""What a log holds, whatever its format: numbers, wrenches, conditions and pictures over time."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: How a picture is encoded.
Encoding = Literal["jpeg", "png"]
#: Levels of a condition, as in ROS.
OK = 0
WARNING = 1
ERROR = 2


@dataclass(frozen=True, kw_only=True)
class Signal:
    """A number over time.

    Attributes
    ----------
    topic: its place in the log, such as `/grip_n/commanded`
    unit: such as N; 1 for a ratio or a count
    meaning: in one line
    times: [s], of the frames that have a value
    values: shape (N,)
    low, high: ends of its 90 % interval, NaN where it has none; None where it never has one
    """

    topic: str
    unit: str
    meaning: str
    times: Array
    values: Array
    low: Array | None = None
    high: Array | None = None


@dataclass(frozen=True, kw_only=True)
class Wrench:
    """Force and torque of the object on a fingertip over time.

    Attributes
    ----------
    topic, meaning: as of a `Signal`
    times: [s], of the frames that have a value
    force: along x, y, z [N], shape (N, 3)
    torque: about x, y, z [N·m], shape (N, 3)
    """

    topic: str
    meaning: str
    times: Array
    force: Array
    torque: Array


@dataclass(frozen=True, kw_only=True)
class Condition:
    """Whether something is as it should be, at every frame.

    Attributes
    ----------
    name: such as `markers`, or `first/markers` of a finger
    times: [s], shape (N,)
    levels: OK, WARNING or ERROR, shape (N,)
    messages: in words, one a frame
    values: further numbers by their names, with the unit in the name; each of shape (N,)
    """

    name: str
    times: Array
    levels: NDArray[np.intp]
    messages: Sequence[str]
    values: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Pictures:
    """Pictures over time.

    Attributes
    ----------
    topic, meaning: as of a `Signal`
    encoding: of each
    read: gives the time [s] and the encoded bytes of each, at each call from the first one
    """

    topic: str
    meaning: str
    encoding: Encoding
    read: Callable[[], Iterator[tuple[float, bytes]]]


@dataclass(frozen=True, kw_only=True)
class Log:
    """All that a log holds.

    Attributes
    ----------
    name: of the run
    scene: text of its TOML file
    facts: results of the run by their names
    signals, wrenches, conditions, pictures: over time
    """

    name: str
    scene: str
    facts: Mapping[str, str]
    signals: Sequence[Signal]
    wrenches: Sequence[Wrench]
    conditions: Sequence[Condition]
    pictures: Sequence[Pictures]


def nanoseconds(times: Array | np.float64) -> NDArray[np.int64]:
    """Times [s] as whole nanoseconds."""
    return np.rint(np.asarray(times) * 1e9).astype(np.int64)
