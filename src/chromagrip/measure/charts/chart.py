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

Box = tuple[float, float, float, float]
#: Width of a character of a name [px of the figure].
_CHARACTER = 6.6
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
    """

    part: str
    title: str
    per: str
    points: Sequence[Point]
    axes: Sequence[Axis]


def write_chart(chart: Chart, machine: dict[str, Any], out: Path) -> str:
    """Leave PART.svg, PART.png and PART.csv in a folder; returns the SVG."""
    figure = draw(chart, machine)
    figure.savefig(out / f"{chart.part}.png", dpi=110)
    svg = svg_of(chart, figure)
    (out / f"{chart.part}.svg").write_text(svg, encoding="utf-8")
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
    return svg


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
        shape, color = "o" if point in best else "x", "tab:blue" if point.ours else "tab:orange"
        panel.plot(x, y, shape, color=color, gid=f"point-{number}-{k}")
        panel.hlines(y, min(point.times), max(point.times), color=color, lw=1.0)
    for k, peer in enumerate(axis.peers):
        at = (peer.milliseconds, peer.error)
        panel.plot(*at, "^", color="0.55", ms=5, gid=f"peer-{number}-{k}")
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
    # Who is on the front, or ours, is named first; who finds no room has a tooltip all the same.
    first = sorted(points, key=lambda p: (p not in best, not p.ours))
    named = [(p.name, (p.milliseconds, p.errors[axis.key]), "black") for p in first]
    named += [(peer.name, (peer.milliseconds, peer.error), "0.45") for peer in axis.peers]
    _write(panel, named)


def _write(panel: Any, named: Sequence[tuple[str, tuple[float, float], str]]) -> None:
    """Names beside their points, where there is room for them."""
    places = [panel.transData.transform(at) for _, at, _ in named]
    inside = panel.bbox
    taken = [(x - 4.0, y - 4.0, x + 4.0, y + 4.0) for x, y in places]
    for (text, at, color), (x, y) in zip(named, places, strict=True):
        width = _CHARACTER * len(text)
        for right, up in ((True, True), (True, False), (False, True), (False, False)):
            left = x + 7.0 if right else x - 7.0 - width
            low = y + 5.0 if up else y - 17.0
            box = (left, low, left + width, low + 12.0)
            if left < inside.x0 or left + width > inside.x1:
                continue
            if any(_overlap(box, other) for other in taken):
                continue
            taken.append(box)
            panel.annotate(
                text,
                at,
                textcoords="offset points",
                xytext=(5 if right else -5, 4 if up else -11),
                ha="left" if right else "right",
                fontsize=8,
                color=color,
            )
            break


def _overlap(a: Box, b: Box) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def front(points: Sequence[Point], key: str) -> list[Point]:
    """Points that no other one beats in both, by time."""
    best, found = np.inf, []
    for point in sorted(points, key=lambda p: (p.milliseconds, p.errors[key])):
        if point.errors[key] < best:
            best = point.errors[key]
            found.append(point)
    return found
