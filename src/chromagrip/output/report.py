"""Measured figures as typed rows and reports, printed alike on the screen, in docs and on pages."""

import math
import os
import platform
import textwrap
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from .versions import versions

#: Width of a screen that tables are broken to [characters].
SCREEN_WIDTH = 100

Name = str | tuple[str, ...]


@dataclass(frozen=True)
class Bounds:
    """Target of a figure: the interval that it has to lie in, both ends included."""

    low: float = -math.inf
    high: float = math.inf

    def hold(self, value: float | None) -> bool:
        """Whether a value lies in the interval; what could not be measured does not."""
        return value is not None and self.low <= value <= self.high

    def __str__(self) -> str:
        if self.high == math.inf:
            return f"≥ {self.low:g}"
        if self.low == -math.inf:
            return f"≤ {self.high:g}"
        low, high = f"{self.low:g}", f"{self.high:g}"
        return low if low == high else f"{low}…{high}"


@dataclass(frozen=True)
class Row:
    """One measured figure.

    Parameters
    ----------
    subject: measured case, from the general to the particular, such as ("jerk-1", "camera")
    score: measured quantity, such as "margin_rmse"
    value: of the quantity; None where it could not be measured
    unit: of the value; empty for a ratio
    target: bounds that are asked for; None for a figure that is only reported
    note: the reason why there is no value, or what its target does not tell
    """

    subject: tuple[str, ...]
    score: str
    value: float | None
    unit: str = ""
    target: Bounds | None = None
    note: str = ""

    @property
    def name(self) -> str:
        """Stable name, the subject and the score with slashes between them."""
        return "/".join((*self.subject, self.score))

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None where there is none."""
        return None if self.target is None else self.target.hold(self.value)


@dataclass(frozen=True)
class Table:
    """A table of texts.

    Parameters
    ----------
    header: of the columns
    lines: cells of each line, as many as the header has
    title: what the table shows
    keys: columns that name a line, which stand in every block of a screen
    """

    header: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]
    title: str = ""
    keys: int = 1


@dataclass(frozen=True)
class Report:
    """Results of one measuring command.

    Parameters
    ----------
    rows: every figure
    tables: summaries of the rows, short enough for a screen
    notes: sentences that explain the tables
    details: further tables, for pages only
    quick: whether the measurement was shortened
    """

    rows: tuple[Row, ...]
    tables: tuple[Table, ...] = ()
    notes: tuple[str, ...] = ()
    details: tuple[Table, ...] = ()
    quick: bool = False

    def as_json(self) -> dict[str, object]:
        """Plain values as `--json` prints them: the machine, and one entry for each row."""
        return {
            "machine": machine(),
            "quick": self.quick,
            "rows": [row_as_json(row) for row in self.rows],
        }

    def listed(self) -> Table:
        """Rows to print one by one: those with a target, or all where no table sums them up."""
        if self.tables:
            judged = [row for row in self.rows if row.target is not None]
            return rows_table(judged, "Figures with a target")
        return rows_table(self.rows)


def row_as_json(row: Row) -> dict[str, object]:
    """Entry of a row in JSON."""
    entry: dict[str, object] = {
        "name": row.name,
        "value": row.value,
        "unit": row.unit,
        "target": None if row.target is None else str(row.target),
        "met": row.met,
    }
    return entry | ({"note": row.note} if row.note else {})


def machine() -> dict[str, object]:
    """System, processor, cores, and the versions that decide what is computed."""
    return {
        "system": platform.system(),
        "processor": platform.machine(),
        "cores": os.cpu_count(),
        **versions(),
    }


def measured(
    name: Name, value: float | None, unit: str, target: Bounds | None = None, note: str = ""
) -> Row:
    """Figure with or without a target.

    Parameters
    ----------
    name: subject from the general to the particular, then the score
    value: of the figure; a number that is not finite counts as not measured
    unit: of the value; empty for a ratio
    target: bounds that are asked for; bounds that are all infinite ask for nothing
    note: see `Row`
    """
    *subject, score = (name,) if isinstance(name, str) else name
    finite = float(value) if value is not None and math.isfinite(value) else None
    return Row(tuple(subject), score, finite, unit, None if target == Bounds() else target, note)


def within(
    name: Name, value: float | None, unit: str, low: float, high: float, note: str = ""
) -> Row:
    """Figure that has to lie between two bounds."""
    return measured(name, value, unit, Bounds(low, high), note)


def at_least(name: Name, value: float | None, unit: str, low: float, note: str = "") -> Row:
    """Figure that has to reach a bound; without a finite one it is only reported."""
    return measured(name, value, unit, Bounds(low=low), note)


def at_most(name: Name, value: float | None, unit: str, high: float, note: str = "") -> Row:
    """Figure that must not exceed a bound; without a finite one it is only reported."""
    return measured(name, value, unit, Bounds(high=high), note)


def reported(name: Name, value: float | None, unit: str, note: str = "") -> Row:
    """Figure without a target."""
    return measured(name, value, unit, None, note)


def values(rows: Iterable[Row]) -> dict[tuple[str, ...], float | None]:
    """Value of each row by its subject and score."""
    return {(*row.subject, row.score): row.value for row in rows}


def number(value: float | None, form: str = ".3g") -> str:
    """Value as a cell of a table; a dash where there is none."""
    return "–" if value is None else format(value, form)


def score_table(rows: Iterable[Row], column: Callable[[Row], str], title: str = "") -> Table:
    """Table with a line for each score and a column for each case.

    Parameters
    ----------
    rows: figures; a score has one unit throughout
    column: heading of the column of a row
    title: what the table shows
    """
    rows = list(rows)
    columns = dict.fromkeys(map(column, rows))
    units = {row.score: row.unit for row in rows}
    cells = {(row.score, column(row)): number(row.value) for row in rows}
    return Table(
        header=("score", *columns),
        lines=tuple(
            (f"{score} [{unit}]" if unit else score, *(cells.get((score, c), "–") for c in columns))
            for score, unit in units.items()
        ),
        title=title,
    )


def rows_table(rows: Iterable[Row], title: str = "") -> Table:
    """Rows as a table: name, value, unit; target, verdict and notes where there are any."""
    rows = list(rows)
    columns: dict[str, Callable[[Row], str]] = {
        "figure": lambda row: row.name,
        "value": lambda row: number(row.value, ".4g"),
        "unit": lambda row: row.unit,
    }
    if any(row.target is not None for row in rows):
        columns["target"] = lambda row: "" if row.target is None else str(row.target)
        columns["met"] = lambda row: {None: "", True: "yes", False: "no"}[row.met]
    if any(row.note for row in rows):
        columns["note"] = lambda row: row.note
    lines = tuple(tuple(cell(row) for cell in columns.values()) for row in rows)
    return Table(header=tuple(columns), lines=lines, title=title)


def table_lines(table: Table, width: float = SCREEN_WIDTH) -> Iterator[str]:
    """Table as text, in as many blocks of columns as a line of that width needs; none if empty."""
    if not table.lines:
        return
    if table.title:
        yield table.title
    cells = (table.header, *table.lines)
    sizes = [max(len(line[column]) for line in cells) for column in range(len(table.header))]
    names = range(table.keys)
    first = table.keys
    while first < len(sizes):
        last, used = first, sum(sizes[k] for k in names) + 2 * (table.keys - 1)
        while last < len(sizes) and (last == first or used + 2 + sizes[last] <= width):
            used += 2 + sizes[last]
            last += 1
        for line in cells:
            padded = [
                f"{line[column]:<{sizes[column]}}" for column in (*names, *range(first, last))
            ]
            yield "  ".join(padded).rstrip()
        yield ""
        first = last


def report_lines(report: Report) -> Iterator[str]:
    """Report as text for a screen: tables, notes and figures."""
    for table in report.tables:
        yield from table_lines(table)
    if report.quick:
        yield from ("Quick: fewer runs or settings than without --quick.", "")
    for note in report.notes:
        yield from (*textwrap.wrap(note, SCREEN_WIDTH), "")
    yield from table_lines(report.listed(), math.inf)


def print_report(report: Report) -> None:
    """Print a report on the screen."""
    for line in report_lines(report):
        print(line)


def report_markdown(report: Report) -> Iterator[str]:
    """Report as lines of Markdown for a page: notes, tables, and the figures off their targets."""
    for note in report.notes:
        yield from (note, "")
    for table in report.tables:
        yield from (*markdown(table), "")
    judged = [row for row in report.rows if row.target is not None]
    missed = [row for row in judged if not row.met]
    if not report.tables:
        yield from markdown(rows_table(report.rows))
    elif judged:
        title = f"{len(judged) - len(missed)} of {len(judged)} targets are met"
        yield from (f"{title}.", "")[: 0 if missed else 2]
        yield from markdown(rows_table(missed, f"{title}; the others"))


def markdown(table: Table) -> Iterator[str]:
    """Table as lines of Markdown; none if it is empty."""
    if not table.lines:
        return
    if table.title:
        yield from (f"{table.title}:", "")
    for line in (table.header, ("---",) * len(table.header), *table.lines):
        yield f"| {' | '.join(line)} |"
