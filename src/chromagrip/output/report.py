"""Measured figures as typed rows and reports, printed alike on the screen, in docs and on pages."""

import math
import os
import platform
from collections.abc import Iterable, Iterator
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
        return f"{self.low:g}" if self.low == self.high else f"{self.low:g}…{self.high:g}"


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
    note: the reason why there is no value
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
    """

    header: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]
    title: str = ""


@dataclass(frozen=True)
class Report:
    """Results of one measuring command.

    Parameters
    ----------
    rows: every figure
    tables: summaries of the rows
    notes: sentences that explain the tables
    quick: whether the measurement was shortened
    """

    rows: tuple[Row, ...]
    tables: tuple[Table, ...] = ()
    notes: tuple[str, ...] = ()
    quick: bool = False

    def as_json(self) -> dict[str, object]:
        """Plain values as `--json` prints them: the machine, and one entry for each row."""
        return {
            "machine": machine(),
            "quick": self.quick,
            "rows": [row_as_json(row) for row in self.rows],
        }

    def judged(self) -> tuple[Row, ...]:
        """Rows that have a target."""
        return tuple(row for row in self.rows if row.target is not None)


def row_as_json(row: Row) -> dict[str, object]:
    """Entry of a row in JSON; a value that is not finite is null."""
    value = row.value if row.value is not None and math.isfinite(row.value) else None
    entry: dict[str, object] = {
        "name": row.name,
        "value": value,
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


def within(
    name: Name, value: float | None, unit: str, low: float, high: float, note: str = ""
) -> Row:
    """Figure that has to lie between two bounds."""
    return _row(name, value, unit, Bounds(low, high), note)


def at_least(name: Name, value: float | None, unit: str, low: float, note: str = "") -> Row:
    """Figure that has to reach a bound."""
    return _row(name, value, unit, Bounds(low=low), note)


def at_most(name: Name, value: float | None, unit: str, high: float, note: str = "") -> Row:
    """Figure that must not exceed a bound; without a finite one it is only reported."""
    return _row(name, value, unit, Bounds(high=high) if math.isfinite(high) else None, note)


def reported(name: Name, value: float | None, unit: str, note: str = "") -> Row:
    """Figure without a target."""
    return _row(name, value, unit, None, note)


def _row(name: Name, value: float | None, unit: str, target: Bounds | None, note: str) -> Row:
    *subject, score = (name,) if isinstance(name, str) else name
    number = None if value is None else float(value)
    return Row(tuple(subject), score, number, unit, target, note)


def table_lines(table: Table, width: int = SCREEN_WIDTH) -> Iterator[str]:
    """Table as text, in as many blocks of columns as a line of that width needs."""
    cells = (table.header, *table.lines)
    sizes = [max(len(line[column]) for line in cells) for column in range(len(table.header))]
    first = 1
    while first < len(sizes):
        last, used = first, sizes[0]
        while last < len(sizes) and (last == first or used + 2 + sizes[last] <= width):
            used += 2 + sizes[last]
            last += 1
        for line in cells:
            padded = [f"{line[column]:<{sizes[column]}}" for column in (0, *range(first, last))]
            yield "  ".join(padded).rstrip()
        yield ""
        first = last


def markdown(table: Table) -> Iterator[str]:
    """Table as lines of Markdown."""
    yield _markdown_line(table.header)
    yield "|" + "---|" * len(table.header)
    yield from map(_markdown_line, table.lines)


def _markdown_line(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def rows_table(rows: Iterable[Row]) -> Table:
    """Rows as a table: name, value, unit, target, verdict."""
    return Table(
        header=("figure", "value", "unit", "target", "met"),
        lines=tuple(
            (
                row.name,
                row.note or "–" if row.value is None else f"{row.value:.4g}",
                row.unit,
                "" if row.target is None else str(row.target),
                {None: "", True: "yes", False: "no"}[row.met],
            )
            for row in rows
        ),
    )
