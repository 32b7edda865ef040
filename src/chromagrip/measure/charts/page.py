"""`chromagrip chart`: speed against accuracy of every stage, on one page."""

import html
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ...output.folder import prepare
from ...output.rows import Row, report, reported
from .chart import Chart, front, write_chart
from .force import chart_force
from .loop import chart_loop
from .model import chart_model
from .render import chart_render
from .track import chart_track

#: What draws the chart of each stage.
PARTS: dict[str, Callable[..., Chart]] = {
    "model": chart_model,
    "render": chart_render,
    "track": chart_track,
    "force": chart_force,
    "loop": chart_loop,
}


def charts(
    parts: Sequence[str],
    quick: bool,
    out: Path | None,
    force: bool,
    progress: Callable[[str], None],
    reconstructors: tuple[str, ...] = (),
) -> dict[str, Any]:
    """Measure the methods of some stages, and draw what each costs against how wrong it is.

    Parameters
    ----------
    parts: keys of PARTS
    quick: less of everything
    out: folder for PART.svg, .png and .csv, charts.json and index.html; None writes nothing
    force: write into a folder that is not empty
    progress: told what is being measured
    reconstructors: of force: names or module:Class; none are all of ours

    Returns
    -------
    The machine, and rows `PART/METHOD/…` of every point.

    Raises
    ------
    UserError
        When there is no such reconstructor, or for a folder that will not do.
    """
    if out is not None:
        prepare(out, force)
    made = []
    for part in parts:

        def tell(what: str, part: str = part) -> None:
            progress(f"{part}: {what}")

        more = (reconstructors,) if part == "force" else ()
        made.append(PARTS[part](quick, tell, *more))
    result = report([row for chart in made for row in rows_of(chart)], quick)
    if out is not None:
        drawn = [(chart, write_chart(chart, result["machine"], out)) for chart in made]
        text = json.dumps(result, indent=2, ensure_ascii=False)
        (out / "charts.json").write_text(text + "\n", encoding="utf-8")
        write_page(drawn, result["machine"], quick, out / "index.html")
    return result


def rows_of(chart: Chart) -> list[Row]:
    """Every point, line and peer of a chart as measured figures."""
    rows = []
    for point in chart.points:
        start = f"{chart.part}/{point.name}"
        rows.append(reported(f"{start}/time", point.milliseconds, "ms"))
        rows += [
            reported(f"{start}/{axis.key}", point.errors[axis.key], axis.unit)
            for axis in chart.axes
        ]
    rows += [
        reported(f"{chart.part}/{name}/{axis.key}", level, axis.unit)
        for axis in chart.axes
        for name, level in axis.lines.items()
    ]
    return rows


def write_page(
    drawn: Sequence[tuple[Chart, str]], machine: dict[str, Any], quick: bool, path: Path
) -> None:
    """One page with every chart (its SVG) and its figures: nothing is loaded from elsewhere."""
    listed = ", ".join(f"{key} {value}" for key, value in machine.items())
    page = _PAGE.format(
        quick="A quick run: few repeats. " if quick else "",
        links=" · ".join(f'<a href="#{c.part}">{c.part}</a>' for c, _ in drawn),
        sections="\n".join(_section(*one) for one in drawn),
        machine=html.escape(listed),
    )
    path.write_text(page, encoding="utf-8")


def _section(chart: Chart, svg: str) -> str:
    heading = ["", "settings", f"ms a {chart.per}", *(axis.label for axis in chart.axes), "again"]
    lines = [heading]
    best = [front(chart.points, axis.key) for axis in chart.axes]
    for point in sorted(chart.points, key=lambda p: p.milliseconds):
        errors = [
            f"{point.errors[axis.key]:.3g}{' *' if point in found else ''}"
            for axis, found in zip(chart.axes, best, strict=True)
        ]
        cost = f"{point.milliseconds:.3g}"
        lines.append([point.name, point.settings, cost, *errors, point.command])
    table = "".join(
        "<tr>" + "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in line) + "</tr>"
        for tag, line in zip(["th", *["td"] * len(chart.points)], lines, strict=True)
    )
    levels = [
        f"{axis.label}: {name} {level:.3g} {axis.unit}"
        for axis in chart.axes
        for name, level in axis.lines.items()
    ]
    peers = [
        f"{peer.name}: {peer.milliseconds:.3g} ms, {peer.error:.3g} {axis.unit}; {peer.source}"
        for axis in chart.axes
        for peer in axis.peers
    ]
    notes = "".join(f"<p class=note>{html.escape(text)}</p>" for text in (*levels, *peers))
    return (
        f'<section id="{chart.part}"><h2>{html.escape(chart.title)}</h2>'
        f"{svg}<table>{table}</table>{notes}</section>"
    )


_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Speed against accuracy</title><style>
body {{ font: 16px/1.5 sans-serif; max-width: 72rem; margin: 2rem auto; padding: 0 1rem }}
svg {{ max-width: 100%; height: auto }} h2 {{ margin-top: 3rem }}
.note {{ color: #555; font-size: 0.9rem; margin: 0.3rem 0 }}
table {{ border-collapse: collapse; margin: 0.8rem 0 }}
td, th {{ padding: 0.15rem 1rem 0.15rem 0; font-size: 0.85rem; text-align: left }}
td {{ border-top: 1px solid #ddd; vertical-align: top }}
td:last-child {{ font-family: monospace; font-size: 0.75rem }}
</style></head><body><h1>Speed against accuracy</h1>
<p>{quick}Time of one call in one thread, median of interleaved turns with the fastest and the
slowest, against the stage's own error. Dots are on the front: no other method is both faster and
better. A point tells its settings and how to measure it again where the pointer rests on it. * in a
table: on the front of that error.</p>
<p>{links}</p>
{sections}
<p class=note>{machine}</p>
</body></html>
"""
