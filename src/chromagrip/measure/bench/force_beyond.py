"""Figures of the world `beyond`: rows, targets and tables."""

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from ...by_name import Choice
from ...output.report import Bounds, Row, Table, measured, number, values
from ..worlds.beyond.groups import BEYOND, GROUPS, NEED_GL
from ..worlds.beyond.scores import UNITS, beyond_scores
from ..worlds.force_scores import CONSTANT, FOLLOWING, QUANTITIES, READ, Answers, constant
from .force_sets import Measured

#: Grasps of each group.
_COUNT = 24
#: Grasps of groups with more parts.
_MORE = {
    "friction-law": 48,
    "friction-law-mismatched": 48,
    "stiffness-told": 48,
    "stiffness-untold": 48,
    "h264": 48,
}
_MORE |= {"out-of-plane": 32, "optics": 36}
#: Groups of a quick run, each with one grasp.
_QUICK = ("roll", "azimuth", "out-of-plane", "friction-law", "sliding", "jpeg")
#: Grasps of a group in a quick run that asks for it.
_QUICK_ASKED = 4
#: Groups that a read-out has to read, and those whose Γ it has to read well.
_READ = ("roll", "azimuth", "out-of-plane", "friction-law", "friction-law-mismatched")
_READ_WELL = ("roll", "azimuth", "out-of-plane")
#: Compressed pictures that have to be read, as (group, label).
_COMPRESSED = (
    ("h264", "crf-4"),
    ("h264", "crf-12"),
    ("h265", "crf-12"),
    ("jpeg", "quality-95"),
    ("jpeg", "quality-90"),
)
#: Scores of the parts of a group.
_OF_PARTS = (
    "honest",
    "narrow",
    "flagged",
    "normal_error",
    "mu_error",
    "mu_honest",
    "margin_error",
    "margin_honest",
    "scenes",
)


def beyond_counts(quick: bool, alone: bool, groups: Sequence[str]) -> dict[tuple[str, str], int]:
    """Number of grasps of each group, by (world, group).

    Parameters
    ----------
    quick: few grasps
    alone: whether this is the only world that is measured
    groups: that are asked for; none are all
    """
    chosen = groups or [g for g in GROUPS if not quick or (alone and g not in NEED_GL)] or _QUICK
    if quick:
        return {(BEYOND, group): _QUICK_ASKED if groups else 1 for group in chosen}
    return {(BEYOND, group): _MORE.get(group, _COUNT) for group in chosen}


def _bounds(group: str) -> dict[str, Bounds]:
    """Targets of a group, by score."""
    bounds = {
        "honest": Bounds(low=90.0),
        "margin_honest": Bounds(low=90.0),
        "narrow": Bounds(high=2.0),
        "flagged": Bounds(high=20.0 if group in _READ else 50.0),
        **{f"{quantity}_width": Bounds(high=2.0) for quantity in QUANTITIES},
    }
    if group in _READ_WELL:
        bounds["margin_error"] = Bounds(high=0.10)
    if group == "stiffness-told":
        bounds |= {f"{quantity}_coverage": Bounds(85.0, 95.0) for quantity in QUANTITIES}
    if group == "stiffness-untold":
        bounds |= {f"{quantity}_coverage": Bounds(low=85.0) for quantity in QUANTITIES}
    return bounds


#: Targets by group and score, and those of parts by group, label and score.
TARGETS = {(group, score): b for group in GROUPS for score, b in _bounds(group).items()}
PART_TARGETS = {(*part, "flagged"): Bounds(high=10.0) for part in _COMPRESSED}


def beyond_rows(
    sets: Mapping[str, Measured], reconstructors: Mapping[str, Choice], best: str
) -> Iterator[Row]:
    """Rows `beyond/GROUP/read/method/score`, and `beyond/GROUP/PART/…` of the parts of a group.

    Parameters
    ----------
    sets: results of each group, by `set_name`
    reconstructors: by name
    best: reconstructor that has to reach the targets, with ten frames
    """
    for name, results in sets.items():
        group = name.removeprefix(f"{BEYOND}/")
        bounds = {score: b for (g, score), b in TARGETS.items() if g == group}
        whole = np.ones(len(results.true), dtype=np.bool_)
        yield from _rows(name, results, whole, reconstructors, best, bounds, UNITS)
        for label in dict.fromkeys(label for labels in results.labels for label in labels):
            part = np.array([label in labels for labels in results.labels])
            bounds = {s: b for (*at, s), b in PART_TARGETS.items() if at == [group, label]}
            part_name = f"{name}/{label}"
            yield from _rows(part_name, results, part, reconstructors, best, bounds, _OF_PARTS)


def _rows(
    name: str,
    results: Measured,
    part: np.ndarray,
    reconstructors: Iterable[str],
    best: str,
    bounds: Mapping[str, Bounds],
    wanted: Iterable[str],
) -> Iterator[Row]:
    """Rows of some scenes of a group."""
    true = results.true[part]
    guess = constant(true)
    guessed = beyond_scores(guess, true)
    for read, named in results.answers.items():
        for method in (CONSTANT, *reconstructors) if named else ():
            if method not in (CONSTANT, *named):
                continue
            given = guess if method == CONSTANT else _of(results.answers[read][method], part)
            found = beyond_scores(given, true)
            for score in wanted:
                target = bounds.get(score) if (method, read) == (best, "0.1s") else None
                if np.isnan(found[score]):
                    target = None  # nothing was read; `flagged` says so
                note = told_by_constant(target, guessed[score])
                yield measured(
                    (name, read, method, score), found[score], UNITS[score], target, note
                )


def _of(estimate: Answers, part: np.ndarray) -> Answers:
    return Answers(
        value=estimate.value[part],
        interval=estimate.interval[part],
        flagged=estimate.flagged[part],
    )


def told_by_constant(target: Bounds | None, guessed: float | None) -> str:
    """Note on a figure whose target the constant answer reaches too."""
    return "a constant answer passes" if target is not None and target.hold(guessed) else ""


#: Explanation of the tables.
BEYOND_NOTES = (
    "Beyond the training range. Inside or flagged: the truth lies in the 90 % interval or the "
    "frame is flagged, over all frames and the four quantities. Wrong, narrow and unflagged: the "
    "truth of any of them lies further from the estimate than twice the half-width. Width: mean "
    "half-width over the RMS error. Flagged: no estimate, or an interval of Γ without an end. A "
    "target that the constant answer reaches too is marked.",
)
#: Columns of the tables: heading, score, format.
_COLUMNS = (
    ("inside or flagged %", "honest", ".0f"),
    ("Γ inside or flagged %", "margin_honest", ".0f"),
    ("wrong, narrow, unflagged %", "narrow", ".1f"),
    ("flagged %", "flagged", ".0f"),
    ("ΣFn %", "normal_error", ".1f"),
    ("ΣFf N", "friction_error", ".3f"),
    ("µ", "mu_error", ".3f"),
    ("Γ", "margin_error", ".3f"),
    ("Γ bias", "margin_bias", "+.3f"),
    ("Γ width", "margin_width", ".1f"),
)


def beyond_tables(
    rows: Sequence[Row], groups: Sequence[str], names: Sequence[str], best: str
) -> list[Table]:
    """Table of the groups with ten frames for the best and the constant answer, then with all."""
    found = values(rows)

    def table(read: str, methods: Sequence[str]) -> Table:
        lines = [
            (
                f"{group.removeprefix(f'{BEYOND}/')}, {method}",
                *(number(found.get((group, read, method, s)), form) for _, s, form in _COLUMNS),
            )
            for group in groups
            for method in methods
            if (group, read, method, "flagged") in found
        ]
        title = f"Beyond the training range, {read}: RMS errors of the frames that are read"
        return Table((f"{BEYOND}", *(heading for heading, *_ in _COLUMNS)), tuple(lines), title)

    few = [name for name in names if name in (CONSTANT, best)]
    short = table("0.1s", few if len(few) > 1 else names)
    if not short.lines:
        short = table(FOLLOWING, names)
    every = (table(read, names) for read in READ)
    return [short, *(one for one in every if one.lines)]


def law_table(rows: Sequence[Row], names: Sequence[str]) -> Table:
    """RMS errors of µ and Γ by the friction law, with ten frames."""
    found = values(rows)
    start = f"{BEYOND}/friction-law"
    parts = dict.fromkeys(
        row.subject[0]
        for row in rows
        if row.subject[0].startswith(start) and row.subject[0].count("/") == 2
    )

    def line(name: str, where: str, scores: tuple[str, str]) -> tuple[str, ...]:
        pairs = ([found.get((where, "0.1s", method, s)) for s in scores] for method in names)
        return (name, *(" / ".join(number(value, ".3f") for value in pair) for pair in pairs))

    fixed = [
        line(f"{world}: sigma0-5000, n-0.7", world, ("mu_rms", "margin_near_rms"))
        for world in ("matched", "mismatched")
        if (world, "0.1s", names[0], "mu_rms") in found
    ]
    read = [
        line(part.removeprefix(f"{BEYOND}/").replace("/", ": "), part, ("mu_error", "margin_error"))
        for part in parts
    ]
    title = "µ / Γ by the friction law, 0.1s: RMS errors (Γ of the first lines at 0.2…0.4)"
    return Table(("friction law", *names), (*fixed, *read), title)
