"""Drawings of charts: panels with labelled points, and tooltips in the SVG."""

import io
import textwrap
from itertools import pairwise
from typing import Any
from xml.etree import ElementTree

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ...output.figure import WIDTH, legend_below, new_figure, plain_ticks
from .chart import Axis, Chart, Point, front
from .labels import Label, Segment, write_labels

#: Look of a method that is the project's choice, and of another: colour, and shape as well.
_LOOKS = {True: ("tab:blue", "o"), False: ("tab:orange", "s")}
#: Look of the peers, of the front, and of the levels that are drawn across.
_PEER: dict[str, Any] = {"color": "0.55", "marker": "^", "ms": 6, "ls": ""}
_FRONT: dict[str, Any] = {"color": "0.75", "ls": "-"}
_LEVEL: dict[str, Any] = {"color": "0.5", "ls": "--", "lw": 0.8}
#: Longest line of a label of an axis.
_LINE = 40
_SVG = "http://www.w3.org/2000/svg"


def draw(chart: Chart, footnote: str) -> Figure:
    """Chart with a panel for each error.

    The drawing of a point has the id `point-AXIS-POINT`, that of a peer `peer-AXIS-PEER`.
    """
    rows = -(-len(chart.axes) // 2)
    columns = min(len(chart.axes), 2)
    title = f"{chart.title}\nlower left is better"
    figure = new_figure(title, WIDTH, 2.1 + 3.3 * rows, footnote)
    panels = figure.subplots(rows, columns, squeeze=False).flat
    for number, (panel, axis) in enumerate(zip(panels, chart.axes, strict=False)):
        _draw_panel(panel, chart, axis, number)
    for panel in figure.axes[len(chart.axes) :]:
        panel.remove()
    legend_below(figure, _legend(chart), 2)
    figure.draw_without_rendering()  # sets the places that labels must not share
    for panel, axis in zip(figure.axes, chart.axes, strict=True):
        write_labels(figure, panel, _labels(chart, axis), _segments(chart, axis))
    return figure


def svg(chart: Chart, figure: Figure) -> str:
    """The figure as SVG, with a tooltip on every point and peer."""
    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": chart.part}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    ElementTree.register_namespace("", _SVG)
    ElementTree.register_namespace("xlink", "http://www.w3.org/1999/xlink")
    root = ElementTree.fromstring(buffer.getvalue())
    tooltips = _tooltips(chart)
    for group in root.iter(f"{{{_SVG}}}g"):
        if text := tooltips.get(group.get("id", "")):
            title = ElementTree.Element(f"{{{_SVG}}}title")
            title.text = text
            group.insert(0, title)
    return ElementTree.tostring(root, encoding="unicode")


def _tooltips(chart: Chart) -> dict[str, str]:
    """Text of each point and peer by its id."""
    texts = {}
    for number, axis in enumerate(chart.axes):
        for k, point in enumerate(chart.points):
            texts[f"point-{number}-{k}"] = _tooltip(chart, axis, point)
        for k, peer in enumerate(axis.peers):
            text = f"{peer.name}: {peer.milliseconds:.3g} ms, {peer.error:.3g} {axis.unit}"
            texts[f"peer-{number}-{k}"] = f"{text}\n{peer.source}"
    return texts


def _tooltip(chart: Chart, axis: Axis, point: Point) -> str:
    """Settings and figures of a point, and the command that measures it again, in lines."""
    spread = f"{min(point.times):.3g} to {max(point.times):.3g}"
    lines = (
        point.name,
        point.settings,
        f"{point.milliseconds:.3g} ms a {chart.per} ({spread})",
        f"{axis.label}: {point.errors[axis.key]:.3g}",
        point.command,
    )
    return "\n".join(line for line in lines if line)


def _draw_panel(panel: Axes, chart: Chart, axis: Axis, number: int) -> None:
    best = front(chart.points, axis.key)
    panel.plot([p.milliseconds for p in best], [p.errors[axis.key] for p in best], **_FRONT)
    for k, point in enumerate(chart.points):
        error = point.errors[axis.key]
        color, shape = _LOOKS[point.ours]
        panel.hlines(error, min(point.times), max(point.times), color=color, lw=1.0)
        fill = color if point in best else "white"
        look: dict[str, Any] = {"color": color, "mfc": fill, "gid": f"point-{number}-{k}"}
        panel.plot(point.milliseconds, error, shape, **look)
    for k, peer in enumerate(axis.peers):
        panel.plot(peer.milliseconds, peer.error, gid=f"peer-{number}-{k}", **_PEER)
    for name, level in axis.lines.items():
        panel.axhline(level, **_LEVEL)
        # Named at the left edge, above its line.
        panel.annotate(
            name,
            (0.0, level),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            xytext=(4, 2),
            fontsize=8,
            color="0.35",
        )
    panel.set(xscale="log", yscale="log")
    panel.set_xlabel(f"time per {chart.per} [ms], one core", fontsize=9)
    panel.set_ylabel(textwrap.fill(axis.label, _LINE), fontsize=9)
    panel.tick_params(labelsize=8)
    panel.grid(alpha=0.3, which="both")
    panel.margins(x=0.25, y=0.2)
    for direction in (panel.xaxis, panel.yaxis):
        plain_ticks(direction)


def _legend(chart: Chart) -> list[Line2D]:
    """What every colour and mark of a chart is, of those that it has."""
    places = {
        (point.ours, point in front(chart.points, axis.key))
        for axis in chart.axes
        for point in chart.points
    }
    texts = {True: "on the front: no other is both faster and better", False: "not on the front"}
    handles = []
    for ours, best in sorted(places, reverse=True):
        color, shape = _LOOKS[ours]
        look: dict[str, Any] = {
            "color": color,
            "marker": shape,
            "mfc": color if best else "white",
            "ls": "",
        }
        handles.append(
            Line2D([], [], label=f"{'ours' if ours else 'other'}, {texts[best]}", **look)
        )
    handles.append(Line2D([], [], color="0.3", lw=1.0, label="bar: fastest to slowest repeat"))
    if any(len(front(chart.points, axis.key)) > 1 for axis in chart.axes):
        handles.append(Line2D([], [], label="the front", **_FRONT))
    if any(axis.peers for axis in chart.axes):
        handles.append(Line2D([], [], label=f"not compared: {chart.compared}", **_PEER))
    return handles + [
        Line2D([], [], label=f"{name}: {chart.levels[name]}", **_LEVEL)
        for name in dict.fromkeys(name for axis in chart.axes for name in axis.lines)
    ]


def _labels(chart: Chart, axis: Axis) -> list[Label]:
    """Labels of points of the front, then of ours, then of others, which may find no room."""
    best = front(chart.points, axis.key)
    points = sorted(chart.points, key=lambda p: (p not in best, not p.ours))
    labels: list[Label] = [
        (p.name, (p.milliseconds, p.errors[axis.key]), {"color": "black"}) for p in points
    ]
    peers = ((peer.name, (peer.milliseconds, peer.error)) for peer in axis.peers)
    return labels + [(name, place, {"color": "0.4"}) for name, place in peers]


def _segments(chart: Chart, axis: Axis) -> list[Segment]:
    """The front and the bars of the points."""
    best = [(point.milliseconds, point.errors[axis.key]) for point in front(chart.points, axis.key)]
    bars = ((min(p.times), max(p.times), p.errors[axis.key]) for p in chart.points)
    return [*pairwise(best), *(((a, error), (b, error)) for a, b, error in bars)]
