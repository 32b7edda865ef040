"""One page with every result of a reproduction in it: nothing is loaded from elsewhere."""

import base64
import html
import io
import math
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from ...output.figure import UNPRINTED
from ...output.rows import Row
from .statements import Check, Section

#: Over what `cells` says of a statement.
HEADING = ["the thesis says", "where", "printed", "here", "allowed", ""]


def picture(figure: Figure) -> bytes:
    """PNG of a figure, the same bytes for the same figure."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, metadata={"Software": None})
    return buffer.getvalue()


def write_page(
    sections: list[Section], machine: dict[str, Any], quick: bool, camera: str | None, path: Path
) -> None:
    """Write the page: a verdict for each figure, then picture, numbers and notes of each."""
    summary = "".join(
        f'<tr><td><a href="#{section.part}">{section.heading}</a></td>'
        f"<td>{_verdict(section)}</td><td>{html.escape(section.sentence)}</td></tr>"
        for section in sections
    )
    through = (
        f"dashed lines and rows with its name went through the camera, scene {camera}"
        if camera
        else "nothing went through the camera; --camera adds it"
    )
    smaller = "A quick run: fewer settings, no sweep of what is not printed. " if quick else ""
    made = ", ".join(f"{key} {value}" for key, value in machine.items())
    page = _PAGE.format(
        intro=html.escape(f"{smaller}Truth path at 1 kHz; {through}. Not printed: {UNPRINTED}."),
        summary=summary,
        sections="\n".join(map(_section, sections)),
        machine=html.escape(made),
    )
    path.write_text(page, encoding="utf-8")


def _section(section: Section) -> str:
    data = base64.b64encode(picture(section.figure)).decode("ascii")
    title = html.escape(section.title)
    parts = [
        f'<section id="{section.part}"><h2>{section.heading}: {title} {_verdict(section)}</h2>',
        f"<p>{html.escape(section.sentence)}</p>",
        f'<img src="data:image/png;base64,{data}" alt="{title}">',
    ]
    if section.checks:
        parts.append(_table([HEADING, *map(cells, section.checks)]))
    parts += map(_table, section.tables)
    if section.rows:
        lines = [[row.name, _row_value(row), row.target, _met(row)] for row in section.rows]
        parts.append(_table([["measured beside it", "", "target", ""], *lines]))
    parts += [f"<p class=note>{html.escape(note)}</p>" for note in section.notes]
    return "".join([*parts, "</section>"])


def _verdict(section: Section) -> str:
    return f"<em class={section.verdict}>{section.verdict}</em>"


def cells(check: Check) -> list[str]:
    """A statement as a line under HEADING."""
    said = check.statement
    return [
        said.text,
        said.where,
        "–" if said.value is None else _number(said.value, said.unit),
        _number(check.value, said.unit),
        check.allowed,
        "" if check.agrees else "differs",
    ]


def _row_value(row: Row) -> str:
    return "–" if row.value is None else _number(row.value, row.unit)


def _met(row: Row) -> str:
    return "" if row.met else "missed"


def _number(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}".strip() if math.isfinite(value) else "–"


def _table(lines: list[list[str]]) -> str:
    """Table whose first line is its heading."""
    rows = [
        "<tr>" + "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in line) + "</tr>"
        for tag, line in zip(["th", *["td"] * (len(lines) - 1)], lines, strict=True)
    ]
    return f"<table>{''.join(rows)}</table>"


_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>The thesis, reproduced</title><style>
body {{ font: 16px/1.5 sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem }}
img {{ max-width: 100% }} h2 {{ margin-top: 3rem }} .note {{ color: #555; font-size: 0.9rem }}
table {{ border-collapse: collapse; margin: 0.8rem 0 }}
td, th {{ padding: 0.15rem 1rem 0.15rem 0; font-size: 0.85rem; text-align: left }}
td {{ border-top: 1px solid #ddd; vertical-align: top }}
em {{ font-style: normal; font-size: 0.8rem; padding: 0.1rem 0.5rem; border-radius: 0.6rem }}
.reproduced {{ background: #d3f0e8 }} .differs {{ background: #f9dccf }}
</style></head><body><h1>The thesis, reproduced</h1>
<p>C. Langens, <i>Controlling grip force by maintaining a constant frictional safety margin</i>.
It prints no data for its figures: the numbers and sentences of its text are compared, curves by
shape only.</p>
<p>{intro}</p>
<table>{summary}</table>
{sections}
<p class=note>{machine}</p>
</body></html>
"""
