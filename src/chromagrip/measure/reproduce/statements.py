"""Statements of the thesis beside the values measured here, and the verdict on each figure."""

import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import msgspec
from matplotlib.figure import Figure

from ...errors import UserError
from ...output.figure import png
from ...output.page import PageSection, inline_png
from ...output.report import Bounds, Row, Table, measured, rows_table

#: Note on a figure of which the thesis prints curves without data.
SHAPE_ONLY = "Curves: shape only."

#: Figure or table, then the quantity, such as ("figure-14", "settling", "conservative").
Name = tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Statement:
    """One number or sentence of the thesis.

    Attributes
    ----------
    name: of the statement
    unit: of the number, or of the measured value
    where, text: place in the thesis, and the statement
    value: printed number; None where a sentence has none
    """

    name: Name
    unit: str
    where: str
    text: str
    value: float | None = None


@cache
def printed() -> dict[Name, Statement]:
    """Every statement that is compared, by name."""
    text = (files(__package__) / "printed.toml").read_text(encoding="utf-8")
    statements = msgspec.convert(tomllib.loads(text)["statement"], list[Statement])
    return {statement.name: statement for statement in statements}


def number(*name: str) -> float:
    """Printed number of that name."""
    value = printed()[name].value
    if value is None:
        raise UserError(f"the thesis prints no number for {'/'.join(name)}")
    return value


@dataclass(frozen=True)
class Check:
    """A statement beside the value measured here.

    Attributes
    ----------
    statement: of the thesis
    value: measured, in the statement's unit; NaN where it could not be measured
    allowed: bounds within which the statement holds
    reason: why it differs where it does
    """

    statement: Statement
    value: float
    allowed: Bounds
    reason: str = ""

    @property
    def agrees(self) -> bool:
        """Whether the statement holds here."""
        return self.allowed.hold(self.value)

    def row(self) -> Row:
        """The same as a measured figure."""
        return measured(self.statement.name, self.value, self.statement.unit, self.allowed)

    def difference(self) -> str:
        """Difference between thesis and measurement in words."""
        expected = self.statement.value
        text = f"{self.statement.text}: here {self._text(self.value)}, "
        if expected is None:
            return f"{text}for that it has to be {self.allowed}"
        share = 100 * (self.value / expected - 1) if expected else math.nan
        percent = f", {share:+.1f} %" if math.isfinite(share) else ""
        return f"{text}thesis {expected:g}{percent}"

    def cells(self) -> tuple[str, ...]:
        """Line of the table of checks."""
        return (
            self.statement.text,
            self.statement.where,
            self._text(self.statement.value),
            self._text(self.value),
            str(self.allowed),
            "" if self.agrees else "differs",
        )

    def _text(self, value: float | None) -> str:
        known = value is not None and math.isfinite(value)
        return f"{value:.4g} {self.statement.unit}".strip() if known else "–"


def near(name: Name, value: float, by: float, reason: str = "") -> Check:
    """Check against the printed number, give or take `by`."""
    expected = number(*name)
    return Check(printed()[name], value, Bounds(expected - by, expected + by), reason)


def near_share(name: Name, value: float, share: float, reason: str = "") -> Check:
    """Check against the printed number, give or take a share of it."""
    return near(name, value, share * abs(number(*name)), reason)


def over(name: Name, value: float, low: float, reason: str = "") -> Check:
    """Check of a sentence that holds from a bound on."""
    return Check(printed()[name], value, Bounds(low=low), reason)


def under(name: Name, value: float, high: float, reason: str = "") -> Check:
    """Check of a sentence that holds up to a bound."""
    return Check(printed()[name], value, Bounds(high=high), reason)


@dataclass(frozen=True, kw_only=True)
class Section:
    """A figure or table of the thesis beside its reproduction.

    Attributes
    ----------
    part: name, such as "figure-13"
    title: of the figure
    figure: drawn here
    agrees: whether every statement of the thesis about it holds here
    sentence: the same in words, with differences and reasons
    checks: the statements
    extra_rows: further figures: the camera path, targets of ours, other definitions
    extra_tables: further tables
    notes: what is compared by shape only, or not at all
    """

    part: str
    title: str
    figure: Figure
    agrees: bool
    sentence: str
    checks: Sequence[Check] = ()
    extra_rows: Sequence[Row] = ()
    extra_tables: Sequence[Table] = ()
    notes: Sequence[str] = ()

    @property
    def heading(self) -> str:
        """Name as in the thesis."""
        kind, _, label = self.part.partition("-")
        return f"{'Fig.' if kind == 'figure' else 'Table'} {label}"

    @property
    def verdict(self) -> str:
        """Verdict in one word."""
        return "reproduced" if self.agrees else "differs"

    @property
    def rows(self) -> list[Row]:
        """Every figure, those first that the thesis prints."""
        return [*(check.row() for check in self.checks), *self.extra_rows]

    @property
    def tables(self) -> list[Table]:
        """Statements, further tables, and further figures."""
        header = ("the thesis says", "where", "printed", "here", "allowed", "")
        checks = Table(header, tuple(check.cells() for check in self.checks))
        beside = rows_table(self.extra_rows)
        return [table for table in (checks, *self.extra_tables, beside) if table.lines]

    def on_page(self) -> PageSection:
        """Section of a page."""
        return PageSection(
            anchor=self.part,
            name=self.heading,
            title=f"{self.heading}: {self.title}",
            picture=inline_png(png(self.figure), self.title),
            verdict=self.verdict,
            sentence=self.sentence,
            tables=self.tables,
            notes=self.notes,
        )


def judged(
    part: str,
    title: str,
    figure: Figure,
    checks: Sequence[Check],
    *,
    rows: Sequence[Row] = (),
    tables: Sequence[Table] = (),
    notes: Sequence[str] = (),
) -> Section:
    """Section whose verdict follows from its checks, at least one."""
    if not checks:
        raise UserError(f"{part} is compared with nothing")
    broken = [check for check in checks if not check.agrees]
    holding = f"{len(checks) - len(broken)} of {len(checks)} statements hold"
    sentence = "; ".join([holding, *(check.difference() for check in broken)]) + "."
    for reason in dict.fromkeys(check.reason for check in broken if check.reason):
        sentence += f" Why: {reason}."
    return Section(
        part=part,
        title=title,
        figure=figure,
        agrees=not broken,
        sentence=sentence,
        checks=checks,
        extra_rows=rows,
        extra_tables=tables,
        notes=notes,
    )
