"""A chart of speed against accuracy as a study: pictures, table and section of a page."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup

from ...output.figure import png
from ...output.page import PageSection, machine_text
from ...output.report import Report, Table
from ..study import Results, Study
from .chart import Chart, front, write_points
from .drawing import draw, svg


def chart_study(
    chart: Callable[[Results[Any, Any]], Chart],
    measure: Callable[[Any], Any],
    result: Any,
    settings: Sequence[Any] = (),
    timed: Sequence[Any] = (),
    words: Callable[[Any], str] = str,
) -> Study[Any, Any]:
    """Study whose results are drawn as a chart: PART.svg, .png and .csv.

    Parameters
    ----------
    chart: made from all results
    measure, result, settings, timed, words: see `Study`
    """
    return Study(
        settings=settings,
        timed=timed,
        measure=measure,
        result=result,
        words=words,
        report=lambda results: Report(rows=tuple(chart(results).rows())),
        show=lambda results, out: [write_chart(chart(results), out)],
    )


def write_chart(chart: Chart, out: Path) -> PageSection:
    """Write PART.svg, .png and .csv of a chart; returns its section of the page."""
    figure = draw(chart, machine_text())
    (out / f"{chart.part}.png").write_bytes(png(figure))
    figure.suptitle("lower left is better")  # the page names the chart above it
    drawn = svg(chart, figure)
    (out / f"{chart.part}.svg").write_text(drawn, encoding="utf-8")
    write_points(chart, out / f"{chart.part}.csv")
    return PageSection(
        anchor=chart.part,
        name=chart.part,
        title=chart.title,
        picture=Markup(drawn),
        tables=[_table(chart)],
        notes=[_HOW, *_notes(chart)],
    )


#: How a chart is measured and read.
_HOW = (
    "Time of one call in one thread, median of interleaved turns with the fastest and the slowest, "
    "against the error of the stage. Filled points are on the front: no other method is both "
    "faster and better. Point at, touch or focus a point for its settings and the command that "
    "measures it again. * in a table: on the front of that error. A click on the head of a column "
    "sorts by it."
)


def _table(chart: Chart) -> Table:
    fronts = [front(chart.points, axis.key) for axis in chart.axes]
    lines = []
    for point in sorted(chart.points, key=lambda p: p.milliseconds):
        errors = (
            f"{point.errors[axis.key]:.3g}{' *' if point in best else ''}"
            for axis, best in zip(chart.axes, fronts, strict=True)
        )
        cost = f"{point.milliseconds:.3g}"
        lines.append((point.name, point.settings, cost, *errors, point.command))
    labels = (axis.label for axis in chart.axes)
    return Table(("", "settings", f"ms a {chart.per}", *labels, "again"), tuple(lines))


def _notes(chart: Chart) -> list[str]:
    """Lines and peers of all axes in words."""
    lines = [
        f"{axis.label}: {name} {level:.3g} {axis.unit}"
        for axis in chart.axes
        for name, level in axis.lines.items()
    ]
    return lines + [
        f"{peer.name}: {peer.milliseconds:.3g} ms, {peer.error:.3g} {axis.unit}; {peer.source}"
        for axis in chart.axes
        for peer in axis.peers
    ]
