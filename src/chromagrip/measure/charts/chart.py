"""Charts of time against error: one point per method and setting, and the front of the best."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...output.report import Row, reported

#: What an answer that never changes is, in a legend.
CONSTANT_TOLD = "the mean of the truth as the answer"


@dataclass(frozen=True, kw_only=True)
class Point:
    """One method at one setting.

    Attributes
    ----------
    name: of method and setting
    times: of each pass [ms]
    errors: by the key of their axis
    ours: whether it is drawn as the project's choice
    settings: in words, where the name does not say them
    command: that measures it again
    """

    name: str
    times: list[float]
    errors: dict[str, float]
    ours: bool
    settings: str = ""
    command: str = ""

    @property
    def milliseconds(self) -> float:
        """Median of the passes [ms]."""
        return float(np.median(self.times))


@dataclass(frozen=True, kw_only=True)
class Peer:
    """A point that is drawn for comparison only.

    Attributes
    ----------
    name: of the tool
    milliseconds: time of one call
    error: on the axis of the peer
    source: of both figures
    """

    name: str
    milliseconds: float
    error: float
    source: str


@dataclass(frozen=True, kw_only=True)
class Axis:
    """One error to draw.

    Attributes
    ----------
    key: of the error
    label: of its axis
    unit: of the error
    lines: levels to draw across, by name, such as a physical limit
    peers: points for comparison
    """

    key: str
    label: str
    unit: str
    lines: dict[str, float] = field(default_factory=dict)
    peers: tuple[Peer, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Methods of one stage.

    Attributes
    ----------
    part: of the pipeline
    title: of the figure
    per: unit of work that the time is given for, such as "frame"
    points: methods
    axes: errors, two a row
    levels: what the lines of the axes are, by name
    compared: what the peers are
    """

    part: str
    title: str
    per: str
    points: Sequence[Point]
    axes: Sequence[Axis]
    levels: dict[str, str] = field(default_factory=dict)
    compared: str = ""

    def rows(self) -> list[Row]:
        """Time and errors of every point, and the level of every line."""
        rows = []
        for point in self.points:
            rows.append(reported((self.part, point.name, "time"), point.milliseconds, "ms"))
            for axis in self.axes:
                name = (self.part, point.name, axis.key)
                rows.append(reported(name, point.errors[axis.key], axis.unit))
        return rows + [
            reported((self.part, name, axis.key), level, axis.unit)
            for axis in self.axes
            for name, level in axis.lines.items()
        ]


def front(points: Sequence[Point], key: str) -> list[Point]:
    """Points than which no other is both faster and better, by time."""
    best: list[Point] = []
    least = np.inf
    for point in sorted(points, key=lambda p: (p.milliseconds, p.errors[key])):
        if point.errors[key] < least:
            least = point.errors[key]
            best.append(point)
    return best


def write_points(chart: Chart, path: Path) -> None:
    """Write a line of CSV for each point, with 1 where it is on the front of an error."""
    keys = [axis.key for axis in chart.axes]
    fronts = [front(chart.points, key) for key in keys]
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        heading = ["name", "settings", "command", "milliseconds", "fastest", "slowest"]
        table.writerow([*heading, *keys, *(f"front of {key}" for key in keys)])
        for p in chart.points:
            measured = [p.milliseconds, min(p.times), max(p.times), *(p.errors[k] for k in keys)]
            on_front = [int(p in best) for best in fronts]
            table.writerow([p.name, p.settings, p.command, *measured, *on_front])
