"""`chromagrip chart`: speed against accuracy of every stage, on one page."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

from markupsafe import Markup

from ...folders import prepared
from ...output.figure import png
from ...output.page import PageSection, machine_text, write_page
from ...output.report import Report, Table
from .chart import Chart, front, write_points
from .drawing import draw, svg
from .force import chart_force
from .force_dome import chart_force_dome
from .loop import chart_loop
from .model import chart_dome, chart_model
from .render import chart_render
from .track import chart_track

#: Functions that measure the methods of each stage, one for each chart: some are of two bodies.
PARTS: dict[str, tuple[Callable[..., Chart], ...]] = {
    "model": (chart_model, chart_dome),
    "render": (chart_render,),
    "track": (chart_track,),
    "force": (chart_force, chart_force_dome),
    "loop": (chart_loop,),
}


def charts(
    parts: Sequence[str],
    quick: bool,
    out: Path | None,
    overwrite: bool,
    progress: Callable[[str], None],
    reconstructors: tuple[str, ...] = (),
) -> Report:
    """Measure time and error of the methods of some stages, and draw them.

    Parameters
    ----------
    parts: keys of PARTS
    quick: less of everything
    out: folder for PART.svg, .png and .csv (of model and force, PART-dome.svg … too), charts.json
        and index.html; None writes nothing
    overwrite: write into a folder that is not empty
    progress: called with the name of each measurement
    reconstructors: of force: names or module:Class; none are all of ours

    Returns
    -------
    Rows `PART/METHOD/…` of every point.

    Raises
    ------
    UserError
        When there is no such reconstructor, or the folder cannot be used.
    """
    with prepared(out, overwrite):
        made = []
        for part in parts:

            def tell(what: str, part: str = part) -> None:
                progress(f"{part}: {what}")

            choice = (reconstructors,) if part == "force" else ()
            made += [measured(quick, tell, *choice) for measured in PARTS[part]]
        report = Report(rows=tuple(row for chart in made for row in chart.rows()), quick=quick)
        if out is not None:
            text = json.dumps(report.as_json(), indent=2, ensure_ascii=False)
            (out / "charts.json").write_text(text + "\n", encoding="utf-8")
            write_charts(made, quick, out)
    return report


def write_charts(made: Sequence[Chart], quick: bool, out: Path) -> None:
    """Write PART.svg, .png and .csv of each chart, and index.html with all of them."""
    sections = []
    for chart in made:
        figure = draw(chart, machine_text())
        (out / f"{chart.part}.png").write_bytes(png(figure))
        figure.suptitle("lower left is better")  # the page names the chart above it
        drawn = svg(chart, figure)
        (out / f"{chart.part}.svg").write_text(drawn, encoding="utf-8")
        write_points(chart, out / f"{chart.part}.csv")
        section = PageSection(
            anchor=chart.part,
            name=chart.part,
            title=chart.title,
            picture=Markup(drawn),
            tables=[_table(chart)],
            notes=_notes(chart),
        )
        sections.append(section)
    introduction = [
        f"{'A quick run: few repeats. ' if quick else ''}Time of one call in one thread, median of "
        "interleaved turns with the fastest and the slowest, against the error of the stage. "
        "Filled points are on the front: no other method is both faster and better. Point at, "
        "touch or focus a point for its settings and the command that measures it again. * in a "
        "table: on the front of that error. A click on the head of a column sorts by it."
    ]
    write_page(out / "index.html", "Speed against accuracy", introduction, sections)


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
