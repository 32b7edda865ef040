"""A sweep as a table: for each setting the runs that lost the object, and means with intervals."""

import math
from collections.abc import Iterator, Sequence

from ...output.report import Report, Row, Table, number, reported
from ..score.intervals import intervals, share_interval
from ..worlds import pinch_scores as pinches
from ..worlds import scorecard
from .runs import SCORES, Plan, SweepCell, words

#: Scores in the table, in its order; of one finger, and of two.
SHOWN = ("overloaded", "settling", "pressure_max", "energy", "chatter")
SHOWN_OF_TWO = ("turn", "displacement", "pressure_max", "energy")
#: What is lost with one finger.
_LOST = (
    "lost: runs in which the object slipped by more than 0.2 mm, or that did not come to their "
    "end. overloaded: time for which the load exceeds µ·ΣFn; where it is short, the object's "
    "inertia and drag bear the rest, and it does not slide. settling: time from the last change of "
    "load or friction until Γ stays within 0.05 of its target (0.30 where a controller has none); "
    "never: it did not, and is left out of the mean. pressure_max: over the width of the contact "
    "plus one node pitch, lower than what `grasp` prints without it."
)


def shown(cells: Sequence[SweepCell]) -> dict[str, str]:
    """Scores in the table with their units; a turn in the hand is one of two fingers."""
    if any(math.isfinite(one.turn) for one in cells):
        return {name: pinches.UNITS[name] for name in SHOWN_OF_TWO}
    return {name: scorecard.SCORES[name][0] for name in SHOWN}


def sweep_report(plan: Plan, cells: Sequence[SweepCell]) -> Report:
    """Table and figures of every setting, over its scenes and seeds."""
    failures = {one.failed for one in cells if one.failed}
    notes = [
        (_LOST if "settling" in shown(cells) else pinches.NOTES)
        + " In brackets are intervals of 90 %: of a share after Wilson, of a mean by drawing its "
        "runs again. Means are over the runs that came to their end.",
        *(f"A run failed: {text}." for text in sorted(failures)[:3]),
    ]
    return Report(rows=tuple(_rows(plan, cells)), tables=(_table(plan, cells),), notes=tuple(notes))


def of_setting(plan: Plan, cells: Sequence[SweepCell]) -> Iterator[tuple[str, list[SweepCell]]]:
    """Words of every setting, in order, with its cells."""
    for setting in plan.settings():
        yield words(setting), [one for one in cells if one.setting == words(setting)]


def means(cells: Sequence[SweepCell]) -> dict[str, tuple[float, float, float]]:
    """Mean of each score and its interval, over the runs that came to their end."""
    ended = [
        {name: value for name in SCORES if (value := getattr(one, name)) != math.inf}
        for one in cells
        if not one.failed
    ]
    bounds = intervals(ended)
    found = {}
    for name in SCORES:
        values = [one[name] for one in ended if name in one]
        mean = math.fsum(values) / len(values) if values else math.nan
        found[name] = (mean, *bounds.get(name, (math.nan, math.nan)))
    return found


def _rows(plan: Plan, cells: Sequence[SweepCell]) -> Iterator[Row]:
    two = "turn" in shown(cells)
    units = pinches.UNITS if two else {k: unit for k, (unit, _) in scorecard.SCORES.items()}
    for name, some in of_setting(plan, cells):
        subject = name or "all"
        lost = sum(one.lost for one in some)
        low, high = share_interval(lost, len(some))
        yield reported((subject, "runs"), len(some), "")
        yield reported((subject, "lost"), lost, "runs")
        yield reported((subject, "lost_low"), low, "")
        yield reported((subject, "lost_high"), high, "")
        for score, (mean, least, most) in means(some).items():
            if score not in units:
                continue
            unit = units[score]
            yield reported((subject, score), mean, unit)
            yield reported((subject, f"{score}_low"), least, unit)
            yield reported((subject, f"{score}_high"), most, unit)


def _table(plan: Plan, cells: Sequence[SweepCell]) -> Table:
    names = [name for name, _ in plan.axes]
    lines = []
    for setting in plan.settings():
        some = [one for one in cells if one.setting == words(setting)]
        lost = sum(one.lost for one in some)
        low, high = share_interval(lost, len(some))
        found = means(some)
        lines.append(
            (
                *(str(setting[name]) for name in names),
                f"{lost} of {len(some)} [{low:.0%}, {high:.0%}]",
                *(_cell(found[score], _never(some, score)) for score in shown(cells)),
            )
        )
    heads = tuple(f"{score} [{unit}]" for score, unit in shown(cells).items())
    return Table(header=(*names, "lost", *heads), lines=tuple(lines), keys=max(len(names), 1))


def _never(cells: Sequence[SweepCell], score: str) -> str:
    """How many runs have no finite value of a score, in words."""
    count = sum(getattr(one, score) == math.inf for one in cells)
    return f"never in {count} of {len(cells)}" if count else ""


def _cell(found: tuple[float, float, float], never: str) -> str:
    mean, low, high = (number(x if math.isfinite(x) else None) for x in found)
    if never and mean == "–":
        return never
    value = mean if low == "–" else f"{mean} [{low}, {high}]"
    return f"{value}, {never}" if never else value
