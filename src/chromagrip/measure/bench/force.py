"""Figures of force and friction estimates: all reconstructors on the same tracks, in each world."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...by_name import Choice
from ...output.report import (
    Bounds,
    Report,
    Row,
    Table,
    at_least,
    measured,
    number,
    reported,
    score_table,
    values,
)
from ...render.drawing import gl_problem
from ...tracking import FRICTION
from ..study import Asked, Results, Study, study
from ..worlds.beyond.groups import BEYOND, GROUPS, NEED_GL
from ..worlds.force_scenes import ForceScene
from ..worlds.force_scores import (
    CONSTANT,
    FOLLOWING,
    QUANTITIES,
    READ,
    UNITS,
    constant,
    reading_name,
    reads_of,
    scores,
    times,
)
from ..worlds.grasps import KNOWN, LIBRARY, WORLDS, scenes
from .force_beyond import (
    BEYOND_NOTES,
    beyond_counts,
    beyond_rows,
    beyond_tables,
    law_table,
    told_by_constant,
)
from .force_sets import GraspTask, Measured, by_set, choose, measure_grasp, set_name, tasks

Array = NDArray[np.float64]

#: Reconstructor that has to reach the targets, by what is read.
BEST = {"single": "sequential", "0.1s": "sequential", "way": "way"}
#: Grasps of each set, and of a quick run.
COUNTS = {
    ("matched", LIBRARY): 160,
    ("mismatched", LIBRARY): 64,
    **{(world, kind): 27 for kind in KNOWN for world in WORLDS},
    ("mismatched", "controlled"): 9,
}
QUICK = {
    ("matched", LIBRARY): 10,
    ("mismatched", LIBRARY): 3,
    ("matched", "conservative"): 2,
}
#: Grasps of the matched library whose information limit is computed, which takes a second each.
_LIMITED = 48
#: Grasps whose limit is computed in a quick run.
_QUICK_LIMITED = 4
#: Grasps that the speed is measured on.
_TIMED = 4
#: Turns of each reconstructor in the measurement of the speed.
_TURNS = 5
#: Scores of each reading of friction off single fields.
_OF_FRICTION = ("mu_rms", "mu_bias", "mu_coverage", "mu_width", "margin_near_rms")
#: Targets of BEST, by set, frames that are read, and score.
_BOUNDS: dict[tuple[str, str, str], tuple[float, float]] = {
    ("matched", "single", "normal_rms"): (0.0, 5.0),
    ("matched", "0.1s", "normal_rms"): (0.0, 2.0),
    ("matched", "single", "friction_rms"): (0.0, 0.02),
    ("matched", "0.1s", "friction_rms"): (0.0, 0.015),
    ("matched", "single", "mu_rms"): (0.0, 0.05),
    ("matched", "0.1s", "mu_rms"): (0.0, 0.04),
    ("matched", "single", "margin_near_rms"): (0.0, 0.08),
    ("matched", "0.1s", "margin_near_rms"): (0.0, 0.06),
    ("matched-objects", "single", "margin_rms"): (0.0, 0.08),
    ("matched-objects", "0.1s", "margin_rms"): (0.0, 0.06),
    ("matched", "way", "normal_rms"): (0.0, 3.0),
    ("matched", "way", "friction_rms"): (0.0, 0.02),
    ("matched", "way", "mu_rms"): (0.0, 0.03),
    ("matched", "way", "margin_near_rms"): (0.0, 0.03),
    ("matched-objects", "way", "margin_rms"): (0.0, 0.03),
    ("matched", "single", "normal_limit"): (0.0, 1.3),
    ("matched", "single", "friction_limit"): (0.0, 1.3),
    **{
        (name, read, score): bound
        for name, bounds in {
            "matched": {
                "mu_bias": (-0.02, 0.02),
                **{f"{q}_coverage": (85.0, 95.0) for q in QUANTITIES},
                **{f"{q}_width": (0.0, 2.0) for q in QUANTITIES},
                "flagged": (0.0, 1.0),
                "far_off": (0.0, 0.0),
            },
            "matched-conservative": {"margin_rms": (0.0, 0.03)},
            "mismatched": {
                "normal_rms": (0.0, 12.0),
                "friction_share": (0.0, 12.0),
                "mu_rms": (0.0, 0.07),
                "margin_near_rms": (0.0, 0.10),
                **{f"{q}_coverage": (80.0, 100.0) for q in QUANTITIES},
                "flagged": (0.0, 5.0),
                "far_off": (0.0, 0.0),
            },
            "mismatched-objects": {"margin_rms": (0.0, 0.10)},
            "mismatched-conservative": {"margin_rms": (0.0, 0.05)},
        }.items()
        for read in READ
        for score, bound in bounds.items()
    },
    ("mismatched", "way", "margin_near_rms"): (0.0, 0.04),
}
TARGETS = {case: Bounds(*bounds) for case, bounds in _BOUNDS.items()}


#: Times of a field by reconstructor in each turn [ms].
Times = list[tuple[str, list[float]]]


class Speed(NamedTuple):
    """Reconstructors whose speed is measured, and the number of their turns."""

    reconstructors: dict[str, Choice]
    turns: int


@study(
    "bench",
    "force",
    worlds=("", *WORLDS, BEYOND),
    method="reconstructor",
    parts=tuple(GROUPS),
    of_parts="group",
    example="--group roll --quick",
)
def force_study(asked: Asked) -> Study[GraspTask | Speed, Measured | Times]:
    """Reconstructors on the chain's pictures: matched, mismatched, and beyond their training.

    Rows are `set/read/reconstructor/score`, and the speed of each where no world is chosen. A quick
    run has few grasps and, unless they are chosen, only the reconstructors that have targets.
    """
    quick, world = asked.quick, asked.world or (BEYOND if asked.only else "")
    chosen = choose(asked, (BEST["0.1s"],) if quick else ())
    counts = _counts(quick, world, asked.only)
    problem = gl_problem()
    if problem is not None:
        counts = {(w, kind): n for (w, kind), n in counts.items() if not _needs_gl(w, kind)}
    return Study(
        settings=tasks(counts, chosen, _QUICK_LIMITED if quick else _LIMITED),
        timed=[] if world else [Speed(chosen, _TURNS)],
        measure=measure_force,
        result=Measured | Times,
        report=lambda results: _report(results, chosen, problem),
        words=force_words,
    )


def measure_force(setting: GraspTask | Speed) -> Measured | Times:
    """What reconstructors read in a grasp, or how long they take."""
    if isinstance(setting, GraspTask):
        return measure_grasp(setting)
    return list(times(setting.reconstructors, timed_scenes(), setting.turns).items())


def force_words(setting: GraspTask | Speed) -> str:
    """A setting in words."""
    return "speed" if isinstance(setting, Speed) else set_name(setting.world, setting.kind)


def _report(
    results: Results[GraspTask | Speed, Measured | Times],
    chosen: Mapping[str, Choice],
    problem: str | None,
) -> Report:
    rows: list[Row] = []
    if problem is not None:
        rows.append(reported(("mismatched", "not_measured"), None, "", problem))
    sets = by_set(
        [
            (task, found)
            for task, found in results
            if isinstance(task, GraspTask) and isinstance(found, Measured)
        ]
    )
    beyond = {name: found for name, found in sets.items() if name.startswith(BEYOND)}
    for name, result in sets.items():
        if name not in beyond:
            rows += _rows(name, result, chosen)
    rows += beyond_rows(beyond, chosen, BEST["0.1s"])
    for _, found in results:
        if not isinstance(found, Measured):
            rows += _speed(dict(found))
    names = (CONSTANT, *chosen)
    details = [
        score_table(mine, lambda row: row.subject[-1], f"Every score, {world}, {read}")
        for world, read in product(WORLDS, READ)
        if (mine := [row for row in rows if row.subject in [(world, read, n) for n in names]])
    ]
    tables: list[Table] = []
    notes: list[str] = []
    if len(sets) > len(beyond):
        tables += [matrix(rows, names), readings(rows, list(chosen))]
        notes += _NOTES
    if beyond:
        first, *others = beyond_tables(rows, list(beyond), names, BEST["0.1s"])
        tables += [first, law_table(rows, names)]
        details += others
        notes += BEYOND_NOTES
    return Report(
        rows=tuple(rows), tables=tuple(tables), notes=tuple(notes), details=tuple(details)
    )


def _counts(quick: bool, world: str, groups: Sequence[str]) -> dict[tuple[str, str], int]:
    """Number of grasps of each set that is asked for, by world and kind."""
    counts = dict(QUICK if quick else COUNTS) | beyond_counts(quick, world == BEYOND, groups)
    return {(w, kind): n for (w, kind), n in counts.items() if world in ("", w)}


def _needs_gl(world: str, kind: str) -> bool:
    return world == "mismatched" or (world == BEYOND and kind in NEED_GL)


def _rows(name: str, results: Measured, reconstructors: Mapping[str, Choice]) -> Iterator[Row]:
    guess = constant(results.true)
    guessed = scores(guess, results.true)
    estimates = (
        (read, method, estimate)
        for read in READ
        if results.answers[read]
        for method, estimate in {CONSTANT: guess, **results.answers[read]}.items()
    )
    for read, method, estimate in estimates:
        reading = method not in (CONSTANT, *reconstructors)
        if reading and estimate.flagged.all():
            continue
        limit = results.limit[read]
        known = limit if np.isfinite(limit).any() else None
        for score, value in scores(estimate, results.true, known).items():
            if score in _OF_FRICTION or not reading:
                target = TARGETS.get((name, read, score)) if method == BEST[read] else None
                note = told_by_constant(target, guessed.get(score))
                yield measured((name, read, method, score), value, UNITS[score], target, note)


def timed_scenes() -> list[ForceScene]:
    """Grasps that the speed is measured on."""
    return [scene for k in range(_TIMED) for scene in scenes("matched", LIBRARY, k, whole=True)]


def _speed(spent: Mapping[str, Sequence[float]]) -> Iterator[Row]:
    rate = {name: 1e3 / float(np.median(turns)) for name, turns in spent.items()}
    for name, fields in rate.items():
        target = Bounds(low=300.0) if name == BEST["single"] else None
        yield measured(("speed", name), fields, "fields/s", target)
    cheapest = max(rate, key=lambda name: rate[name])
    yield at_least(("speed", "cheapest"), rate[cheapest], f"fields/s ({cheapest})", 2000.0)


#: Columns of the printed table: heading, what to add to the world's name, score, and format.
_COLUMNS = (
    ("ΣFn %", "", "normal_rms", ".1f"),
    ("ΣFf N", "", "friction_rms", ".3f"),
    ("µ", "", "mu_rms", ".3f"),
    ("µ bias", "", "mu_bias", ".3f"),
    ("Γ≈0.3", "", "margin_near_rms", ".3f"),
    ("Γ objects", "-objects", "margin_rms", ".3f"),
    ("Γ controlled", "-controlled", "margin_rms", ".3f"),
    ("Γ 5 N", "-conservative", "margin_rms", ".3f"),
    ("flagged %", "", "flagged", ".1f"),
    ("far off %", "", "far_off", ".1f"),
)


def matrix(rows: Sequence[Row], names: Sequence[str]) -> Table:
    """Table of reconstructors: errors with the matched / mismatched sensor, flags, speed."""
    found = values(rows)

    def cell(read: str, name: str, more: str, score: str, form: str) -> str:
        pair = (found.get((world + more, read, name, score)) for world in WORLDS)
        return " / ".join(number(value, form) for value in pair)

    lines = [
        (
            f"{name}, {read}",
            *(cell(read, name, *column) for _, *column in _COLUMNS),
            number(found["speed", name], ".0f") if ("speed", name) in found else "",
        )
        for read, name in product(READ, names)
        if name == CONSTANT or read in reads_of(name)
        if read != "way" or FOLLOWING in names
    ]
    headings = (heading for heading, *_ in _COLUMNS)
    return Table(("RMS errors", *headings, "fields/s"), tuple(lines))


def readings(rows: Sequence[Row], names: Sequence[str]) -> Table:
    """Table of reconstructors over readings of friction: RMS error of µ, and its bias."""
    found = values(rows)

    def cell(world: str, name: str, method: str) -> str:
        start = (world, "single", reading_name(name, method))
        error, bias = (found.get((*start, score)) for score in ("mu_rms", "mu_bias"))
        return "–" if error is None or bias is None else f"{error:.3f} ({bias:+.3f})"

    nothing = " / ".join("–" for _ in WORLDS)
    lines = [
        (name, *(" / ".join(cell(world, name, method) for world in WORLDS) for method in FRICTION))
        for name in names
    ]
    return Table(
        header=("RMS error of µ (bias)", *FRICTION),
        lines=tuple(line for line in lines if set(line[1:]) != {nothing}),
        title="µ read off single fields, matched / mismatched sensor",
    )


#: Explanation of the tables.
_NOTES = (
    "Errors are RMS errors with the matched / mismatched sensor. `single`: each frame is read as "
    "the first one after rest. `0.1s`: the last of ten frames in 0.1 s of a grasp at rest.",
    "Γ≈0.3: grasps of the library with Γ in 0.2…0.4. Γ objects: the 27 objects at Γ = 0.3. Γ "
    "controlled: grasps of Safety Margin Control. Γ 5 N: Conservative Control.",
    "far off: ΣFn or µ is off by more than half of itself, or Γ by more than 0.5, without a flag. "
    "constant: the mean of each set, which is the best answer that uses no image.",
)
