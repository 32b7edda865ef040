"""Charts of time against error: one point per method and setting, and the front of the best."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import matplotlib
import numpy as np
from matplotlib.figure import Figure

#: Points within this factor of each other in time and error are close.
_CLOSE = 2.0
#: A name is about as wide as this factor in time, and as high as this logarithm in error.
_NAME_WIDTH, _NAME_HEIGHT = 3.0, 0.1
_SVG = "http://www.w3.org/2000/svg"


@dataclass(frozen=True, kw_only=True)
class Point:
    """One method at one setting.

    Attributes
    ----------
    name: of method and setting
    times: of each pass [ms]
    errors: by name
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
    """What somebody else's tool reached: published, or measured elsewhere.

    Attributes
    ----------
    name: of the tool
    milliseconds: a call of it takes
    error: of the axis it is drawn on
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
    peers: others to draw beside
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
    per: what the time is of, such as "frame"
    points: methods
    axes: errors, two a row
    notes: sentences below it
    """

    part: str
    title: str
    per: str
    points: Sequence[Point]
    axes: Sequence[Axis]
    notes: tuple[str, ...] = ()


def write_chart(chart: Chart, machine: dict[str, Any], out: Path) -> None:
    """Leave PART.svg, PART.png and PART.csv in a folder."""
    figure = draw(chart, machine)
    figure.savefig(out / f"{chart.part}.png", dpi=110)
    (out / f"{chart.part}.svg").write_text(svg_of(chart, figure), encoding="utf-8")
    with (out / f"{chart.part}.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        keys = [axis.key for axis in chart.axes]
        fronts = [f"front of {key}" for key in keys]
        heading = ["name", "settings", "command", "milliseconds", "fastest", "slowest"]
        table.writerow([*heading, *keys, *fronts])
        best = [front(chart.points, key) for key in keys]
        for p in chart.points:
            said = [p.name, p.settings, p.command, p.milliseconds, min(p.times), max(p.times)]
            table.writerow([*said, *(p.errors[k] for k in keys), *(int(p in b) for b in best)])


def draw(chart: Chart, machine: dict[str, Any]) -> Figure:
    """The chart; each point's drawing has the id `point-AXIS-POINT`, a peer's `peer-AXIS-PEER`."""
    matplotlib.use("Agg", force=False)
    rows = -(-len(chart.axes) // 2)
    cols = min(len(chart.axes), 2)
    figure = Figure(figsize=(max(5.5 * cols, 8.0), 1.0 + 4.0 * rows), layout="constrained")
    panels = figure.subplots(rows, cols, squeeze=False).flat
    for number, (panel, axis) in enumerate(zip(panels, chart.axes, strict=False)):
        _draw(panel, chart, axis, number)
    for panel in list(figure.axes)[len(chart.axes) :]:
        panel.remove()
    listed = ", ".join(f"{key} {value}" for key, value in machine.items())
    figure.suptitle(f"{chart.title}; lower left is better")
    figure.supxlabel(listed, fontsize=6)
    return figure


def svg_of(chart: Chart, figure: Figure) -> str:
    """The figure, with what is known of a point as its tooltip."""
    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": chart.part}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    ElementTree.register_namespace("", _SVG)
    ElementTree.register_namespace("xlink", "http://www.w3.org/1999/xlink")
    root = ElementTree.fromstring(buffer.getvalue())
    groups = {group.get("id"): group for group in root.iter(f"{{{_SVG}}}g")}
    for number, axis in enumerate(chart.axes):
        for k, point in enumerate(chart.points):
            _name(groups.get(f"point-{number}-{k}"), tooltip(chart, axis, point))
        for k, peer in enumerate(axis.peers):
            text = f"{peer.name}: {peer.milliseconds:.3g} ms, {peer.error:.3g} {axis.unit}"
            _name(groups.get(f"peer-{number}-{k}"), f"{text}\n{peer.source}")
    return ElementTree.tostring(root, encoding="unicode")


def _name(group: ElementTree.Element | None, text: str) -> None:
    if group is None:
        return  # beyond what is drawn
    title = ElementTree.Element(f"{{{_SVG}}}title")
    title.text = text
    group.insert(0, title)


def tooltip(chart: Chart, axis: Axis, point: Point) -> str:
    """What is known of a point, in lines: settings, figures, and how to measure it again."""
    spread = f"{min(point.times):.3g} to {max(point.times):.3g}"
    lines = [point.name]
    if point.settings:
        lines.append(point.settings)
    lines.append(f"{point.milliseconds:.3g} ms a {chart.per} ({spread})")
    lines.append(f"{axis.label}: {point.errors[axis.key]:.3g}")
    if point.command:
        lines.append(point.command)
    return "\n".join(lines)


def _draw(panel: Any, chart: Chart, axis: Axis, number: int) -> None:
    points = chart.points
    best = front(points, axis.key)
    panel.plot([p.milliseconds for p in best], [p.errors[axis.key] for p in best], "-", color="0.8")
    for k, point in enumerate(points):
        x, y = point.milliseconds, point.errors[axis.key]
        (mark,) = panel.plot(
            x,
            y,
            "o" if point in best else "x",
            color="tab:blue" if point.ours else "tab:orange",
            gid=f"point-{number}-{k}",
        )
        panel.hlines(y, min(point.times), max(point.times), color=mark.get_color(), lw=1.0)
        low = _below_another(point, points, axis.key)
        _write(panel, point.name, (x, y), low, _left_of_another(point, points, axis.key), "black")
    for k, peer in enumerate(axis.peers):
        at = (peer.milliseconds, peer.error)
        panel.plot(*at, "^", color="0.55", ms=5, gid=f"peer-{number}-{k}")
        _write(panel, peer.name, at, False, False, "0.45")
    for name, level in axis.lines.items():
        panel.axhline(level, color="0.5", linestyle="--", linewidth=0.8)
        # Named at the left edge, above its line.
        panel.annotate(
            name,
            (0.0, level),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            xytext=(4, 2),
            fontsize=8,
            color="0.4",
        )
    unit = f"time per {chart.per} [ms], one core"
    panel.set(xscale="log", yscale="log", xlabel=unit, ylabel=axis.label)
    panel.grid(alpha=0.3, which="both")
    panel.margins(x=0.3, y=0.2)


def _write(
    panel: Any, text: str, at: tuple[float, float], low: bool, left: bool, color: str
) -> None:
    panel.annotate(
        text,
        at,
        textcoords="offset points",
        xytext=(-6 if left else 6, -12 if low else 6),
        ha="right" if left else "left",
        fontsize=8,
        color=color,
    )


def _left_of_another(point: Point, points: Sequence[Point], key: str) -> bool:
    """Whether another point stands where the name would be written."""
    return any(
        1.0 < other.milliseconds / point.milliseconds < _NAME_WIDTH
        and abs(np.log(other.errors[key] / point.errors[key])) < _NAME_HEIGHT
        for other in points
    )


def _below_another(point: Point, points: Sequence[Point], key: str) -> bool:
    """Whether another point stands close above, so that names must part."""

    def close(a: float, b: float) -> bool:
        return a < _CLOSE * b and b < _CLOSE * a

    rank = (point.errors[key], point.name)
    return any(
        close(other.milliseconds, point.milliseconds)
        and close(other.errors[key], point.errors[key])
        and (other.errors[key], other.name) > rank
        for other in points
    )


def front(points: Sequence[Point], key: str) -> list[Point]:
    """Points that no other one beats in both, by time."""
    best, found = np.inf, []
    for point in sorted(points, key=lambda p: (p.milliseconds, p.errors[key])):
        if point.errors[key] < best:
            best = point.errors[key]
            found.append(point)
    return found
