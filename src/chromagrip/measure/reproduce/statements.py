"""What the thesis says beside what comes out here, and the verdict that follows from it."""

import math
import tomllib
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files

from matplotlib.figure import Figure

from ...errors import UserError
from ...output.rows import Row, within


@dataclass(frozen=True)
class Statement:
    """One number or sentence of the thesis.

    Attributes
    ----------
    unit: of the number, or of what the sentence is put in
    where, text: its place, and what it says
    value: printed number; None where a sentence has none
    """

    unit: str
    where: str
    text: str
    value: float | None = None


@cache
def printed() -> dict[str, Statement]:
    """Every statement that is compared, by name."""
    text = (files(__package__) / "printed.toml").read_text(encoding="utf-8")
    return {name: Statement(**values) for name, values in tomllib.loads(text).items()}


def number(name: str) -> float:
    """Printed number of that name."""
    value = printed()[name].value
    if value is None:
        raise UserError(f"the thesis prints no number for {name}")
    return value


@dataclass(frozen=True)
class Check:
    """A statement beside what was measured here.

    Attributes
    ----------
    name: of the statement
    value: measured, in the statement's unit
    low, high: between which the thesis's statement holds
    reason: why it differs where it does
    """

    name: str
    value: float
    low: float
    high: float
    reason: str = ""

    @property
    def statement(self) -> Statement:
        """What the thesis says."""
        return printed()[self.name]

    @property
    def agrees(self) -> bool:
        """Whether the statement holds here."""
        return self.low <= self.value <= self.high

    @property
    def allowed(self) -> str:
        """Bounds in words."""
        if self.high == math.inf:
            return f"≥ {self.low:g}"
        if self.low == -math.inf:
            return f"≤ {self.high:g}"
        low, high = f"{self.low:.4g}", f"{self.high:.4g}"
        return low if low == high else f"{low}…{high}"

    def row(self) -> Row:
        """The same as a measured figure."""
        value = self.value if math.isfinite(self.value) else None
        row = within(self.name, value, self.statement.unit, self.low, self.high)
        return Row(row.name, row.value, row.unit, self.allowed, self.agrees)

    def difference(self) -> str:
        """How much it differs."""
        unit = self.statement.unit and f" {self.statement.unit}"
        said = self.statement.value
        wanted = f"thesis {said:g}" if said is not None else f"for that it has to be {self.allowed}"
        share = f", {100 * (self.value / said - 1):+.1f} %" if said else ""
        return f"{self.statement.text}: here {self.value:.4g}{unit}, {wanted}{share}"


def near(name: str, value: float, by: float, reason: str = "") -> Check:
    """Check against the printed number, give or take so much."""
    said = number(name)
    return Check(name, value, said - by, said + by, reason)


def near_share(name: str, value: float, share: float, reason: str = "") -> Check:
    """Check against the printed number, give or take a share of it."""
    return near(name, value, share * abs(number(name)), reason)


def over(name: str, value: float, low: float, reason: str = "") -> Check:
    """Check of a sentence that holds from a bound on."""
    return Check(name, value, low, math.inf, reason)


def under(name: str, value: float, high: float, reason: str = "") -> Check:
    """Check of a sentence that holds up to a bound."""
    return Check(name, value, -math.inf, high, reason)


@dataclass(frozen=True, kw_only=True)
class Section:
    """A figure or table of the thesis, and what came of it.

    Attributes
    ----------
    part: its name, "figure-13"
    title: what it shows
    figure: drawn here
    agrees: whether every statement of the thesis about it holds here
    sentence: the same in words: how much it differs, and why
    checks: the statements
    rows: what was measured beside them: the camera path, issue targets, other definitions
    tables: more of it, each with a heading
    notes: what is a curve without data, and what cannot be compared
    """

    part: str
    title: str
    figure: Figure
    agrees: bool
    sentence: str
    checks: list[Check] = field(default_factory=list)
    rows: list[Row] = field(default_factory=list)
    tables: list[list[list[str]]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def heading(self) -> str:
        """Its name as the thesis has it."""
        kind, _, label = self.part.partition("-")
        return f"{'Fig.' if kind == 'figure' else 'Table'} {label}"

    @property
    def verdict(self) -> str:
        """One word."""
        return "reproduced" if self.agrees else "differs"


def judged(
    part: str,
    title: str,
    figure: Figure,
    checks: list[Check],
    *,
    rows: list[Row] | None = None,
    tables: list[list[list[str]]] | None = None,
    notes: list[str] | None = None,
) -> Section:
    """Section whose verdict is what its checks say, one at least."""
    if not checks:
        raise UserError(f"{part} is compared with nothing")
    broken = [check for check in checks if not check.agrees]
    held = f"{len(checks) - len(broken)} of {len(checks)} statements hold"
    sentence = "; ".join([held, *(check.difference() for check in broken)]) + "."
    for reason in dict.fromkeys(check.reason for check in broken if check.reason):
        sentence += f" Why: {reason}."
    return Section(
        part=part,
        title=title,
        figure=figure,
        agrees=not broken,
        sentence=sentence,
        checks=checks,
        rows=rows or [],
        tables=tables or [],
        notes=notes or [],
    )
