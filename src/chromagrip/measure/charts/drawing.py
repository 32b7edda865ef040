"""Drawings of charts: panels with labelled points, and tooltips in the SVG."""

import io
from collections.abc import Sequence
from xml.etree import ElementTree

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...output.figure import new_figure
from .chart import Axis, Chart, Point, front

#: Width of a character of a label [px of the figure].
_CHARACTER = 6.6
_SVG = "http://www.w3.org/2000/svg"

#: Left, lower, right and upper edge [px of the figure].
Box = tuple[float, float, float, float]
#: Text, time and error, and colour of a label.
Label = tuple[str, tuple[float, float], str]


def draw(chart: Chart, footnote: str) -> Figure:
    """Chart with a panel for each error.

    The drawing of a point has the id `point-AXIS-POINT`, that of a peer `peer-AXIS-PEER`.
    """
    rows = -(-len(chart.axes) // 2)
    columns = min(len(chart.axes), 2)
    title = f"{chart.title}; lower left is better"
    figure = new_figure(title, max(5.5 * columns, 8.0), 1.0 + 4.0 * rows, footnote)
    panels = figure.subplots(rows, columns, squeeze=False).flat
    for number, (panel, axis) in enumerate(zip(panels, chart.axes, strict=False)):
        _draw_panel(panel, chart, axis, number)
    for panel in figure.axes[len(chart.axes) :]:
        panel.remove()
    figure.draw_without_rendering()  # sets the places that labels must not share
    for panel, axis in zip(figure.axes, chart.axes, strict=True):
        _write_labels(panel, _labels(chart, axis))
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
    panel.plot([p.milliseconds for p in best], [p.errors[axis.key] for p in best], "-", color="0.8")
    for k, point in enumerate(chart.points):
        error = point.errors[axis.key]
        shape, color = "o" if point in best else "x", "tab:blue" if point.ours else "tab:orange"
        panel.plot(point.milliseconds, error, shape, color=color, gid=f"point-{number}-{k}")
        panel.hlines(error, min(point.times), max(point.times), color=color, lw=1.0)
    for k, peer in enumerate(axis.peers):
        gid = f"peer-{number}-{k}"
        panel.plot(peer.milliseconds, peer.error, "^", color="0.55", ms=5, gid=gid)
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
    time_label = f"time per {chart.per} [ms], one core"
    panel.set(xscale="log", yscale="log", xlabel=time_label, ylabel=axis.label)
    panel.grid(alpha=0.3, which="both")
    panel.margins(x=0.3, y=0.2)


def _labels(chart: Chart, axis: Axis) -> list[Label]:
    """Labels of points of the front, then of ours, then of others, which may find no room."""
    best = front(chart.points, axis.key)
    points = sorted(chart.points, key=lambda p: (p not in best, not p.ours))
    labels: list[Label] = [(p.name, (p.milliseconds, p.errors[axis.key]), "black") for p in points]
    return labels + [(peer.name, (peer.milliseconds, peer.error), "0.45") for peer in axis.peers]


def _write_labels(panel: Axes, labels: Sequence[Label]) -> None:
    """Write labels beside their points, where there is room for them."""
    places = [panel.transData.transform(point) for _, point, _ in labels]
    taken = [(x - 4.0, y - 4.0, x + 4.0, y + 4.0) for x, y in places]
    for (text, point, color), (x, y) in zip(labels, places, strict=True):
        width = _CHARACTER * len(text)
        for right, up in ((True, True), (True, False), (False, True), (False, False)):
            left = x + 7.0 if right else x - 7.0 - width
            low = y + 5.0 if up else y - 17.0
            box = (left, low, left + width, low + 12.0)
            inside = panel.bbox.x0 <= left and left + width <= panel.bbox.x1
            if not inside or any(_overlap(box, other) for other in taken):
                continue
            taken.append(box)
            panel.annotate(
                text,
                point,
                textcoords="offset points",
                xytext=(5 if right else -5, 4 if up else -11),
                ha="left" if right else "right",
                fontsize=8,
                color=color,
            )
            break


def _overlap(a: Box, b: Box) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
