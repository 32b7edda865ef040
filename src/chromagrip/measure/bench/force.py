"""Figures of force and friction estimates: all reconstructors on the same tracks, in two worlds."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ...by_name import Choice
from ...output.processes import map_processes
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
from ...thesis import OBJECTS
from ...tracking import FRICTION, METHODS, load_reconstructor
from ..worlds.force_scenes import ForceScene
from ..worlds.force_scores import (
    CONSTANT,
    QUANTITIES,
    READ,
    UNITS,
    Answers,
    answers,
    constant,
    limits,
    reading_name,
    scores,
    times,
    truth,
)
from ..worlds.grasps import KNOWN, LIBRARY, WORLDS, scenes
from .methods import named

Array = NDArray[np.float64]

#: Reconstructor that has to reach the targets, by what is read.
BEST = {"single": "learned", "0.1s": "sequential"}
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
#: Step from one object to the next. It has no divisor in common with 27: a few objects vary as all
#: do, and 27 steps reach all of them.
_STRIDE = 10
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
                "wrong": (0.0, 0.0),
            },
            "matched-conservative": {"margin_rms": (0.0, 0.03)},
            "mismatched": {
                "normal_rms": (0.0, 12.0),
                "friction_share": (0.0, 12.0),
                "mu_rms": (0.0, 0.07),
                "margin_near_rms": (0.0, 0.10),
                **{f"{q}_coverage": (80.0, 100.0) for q in QUANTITIES},
                "flagged": (0.0, 5.0),
                "wrong": (0.0, 0.0),
            },
            "mismatched-objects": {"margin_rms": (0.0, 0.10)},
            "mismatched-conservative": {"margin_rms": (0.0, 0.05)},
        }.items()
        for read in READ
        for score, bound in bounds.items()
    },
}
TARGETS = {case: Bounds(*bounds) for case, bounds in _BOUNDS.items()}


@dataclass(frozen=True, kw_only=True)
class Task:
    """One grasp to make, and the reconstructors that read it.

    Attributes
    ----------
    world, kind, index: see `grasps.scenes`
    reconstructors: by name
    limited: whether its limits are computed
    """

    world: str
    kind: str
    index: int
    reconstructors: Mapping[str, Choice]
    limited: bool


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Results of the S scenes of one or more grasps.

    Attributes
    ----------
    true: (ΣFn [N], ΣFf [N], µ, Γ), shape (S, 4)
    answers: estimates of them by reconstructor or reading, and by the frames that are read
    limit: smallest standard deviations of them by the frames that are read, shape (S, 4)
    """

    true: Array
    answers: dict[tuple[str, str], Answers]
    limit: dict[str, Array]


def bench_force(
    quick: bool, progress: Callable[[str], None], reconstructors: Sequence[Choice] = ()
) -> Report:
    """Report of reconstructors: rows `set/read/reconstructor/score`, and the speed of each.

    Parameters
    ----------
    quick: few grasps; unless chosen only the reconstructors that have targets
    progress: called with the name of each measurement
    reconstructors: names, module:Class or classes; none are all of ours, beside a constant answer

    Raises
    ------
    UserError
        When there is no such reconstructor.
    """
    chosen = choose(reconstructors or (tuple(BEST.values()) if quick else ()))
    counts = dict(QUICK if quick else COUNTS)
    rows: list[Row] = []
    if (problem := gl_problem()) is not None:
        rows.append(reported(("mismatched", "not_measured"), None, "", problem))
        counts = {(world, kind): n for (world, kind), n in counts.items() if world == "matched"}
    sets = measure(counts, chosen, _QUICK_LIMITED if quick else _LIMITED, progress)
    for name, results in sets.items():
        rows += _rows(name, results, chosen)
    progress("speed")
    rows += _speed(chosen)
    names = (CONSTANT, *chosen)
    details = [
        score_table(mine, lambda row: row.subject[-1], f"Every score, {world}, {read}")
        for world, read in product(WORLDS, READ)
        if (mine := [row for row in rows if row.subject in [(world, read, n) for n in names]])
    ]
    return Report(
        rows=tuple(rows),
        tables=(matrix(rows, names), readings(rows, list(chosen))),
        notes=_NOTES,
        details=tuple(details),
        quick=quick,
    )


def set_name(world: str, kind: str) -> str:
    """Name of a set in rows."""
    return world if kind == LIBRARY else f"{world}-{kind}"


def choose(reconstructors: Sequence[Choice]) -> dict[str, Choice]:
    """Reconstructors by name; none are all of ours.

    Raises
    ------
    UserError
        When there is no such reconstructor.
    """
    return named(reconstructors or list(METHODS), load_reconstructor)


def measure(
    counts: Mapping[tuple[str, str], int],
    reconstructors: Mapping[str, Choice],
    limited: int,
    progress: Callable[[str], None],
) -> dict[str, Measured]:
    """Let reconstructors read the grasps of some sets, in one process for each core.

    Parameters
    ----------
    counts: of grasps by world and kind
    reconstructors: by name
    limited: number of grasps of the matched library whose limits are computed, the first ones
    progress: called after each grasp

    Returns
    -------
    By `set_name`.
    """
    tasks = [
        Task(
            world=world,
            kind=kind,
            index=k if kind == LIBRARY else k * _STRIDE % len(OBJECTS),
            reconstructors=reconstructors,
            limited=(world, kind) == ("matched", LIBRARY) and k < limited,
        )
        for (world, kind), count in counts.items()
        for k in range(count)
    ]
    sets: dict[str, list[Measured]] = {}
    results = map_processes(measure_grasp, tasks, os.cpu_count() or 1, ordered=True)
    for done, (task, result) in enumerate(zip(tasks, results, strict=True), 1):
        name = set_name(task.world, task.kind)
        sets.setdefault(name, []).append(result)
        progress(f"{name}: grasp {done} of {len(tasks)}")
    return {name: _joined(parts) for name, parts in sets.items()}


def _joined(parts: Sequence[Measured]) -> Measured:
    return Measured(
        true=np.concatenate([part.true for part in parts]),
        answers={
            key: Answers.joined([part.answers[key] for part in parts]) for key in parts[0].answers
        },
        limit={read: np.concatenate([part.limit[read] for part in parts]) for read in READ},
    )


def measure_grasp(task: Task) -> Measured:
    """Make a grasp and let every reconstructor read it."""
    return _joined([_measure_scene(task, s) for s in scenes(task.world, task.kind, task.index)])


def _measure_scene(task: Task, scene: ForceScene) -> Measured:
    estimates: dict[tuple[str, str], Answers] = {}
    for name, choice in task.reconstructors.items():
        estimates |= answers(name, choice, scene)
    unknown = np.full(4, np.nan)
    return Measured(
        true=truth(scene)[None],
        answers=estimates,
        limit={
            read: (limits(scene, frames) if task.limited else unknown)[None]
            for read, frames in READ.items()
        },
    )


def _rows(name: str, results: Measured, reconstructors: Mapping[str, Choice]) -> Iterator[Row]:
    fixed = {(CONSTANT, read): constant(results.true) for read in READ}
    for (method, read), estimate in (fixed | results.answers).items():
        reading = method not in (CONSTANT, *reconstructors)
        if reading and estimate.flagged.all():
            continue
        limit = results.limit[read]
        known = limit if np.isfinite(limit).any() else None
        for score, value in scores(estimate, results.true, known).items():
            if score in _OF_FRICTION or not reading:
                target = TARGETS.get((name, read, score)) if method == BEST[read] else None
                yield measured((name, read, method, score), value, UNITS[score], target)


def timed_scenes() -> list[ForceScene]:
    """Grasps that the speed is measured on."""
    return [scene for k in range(_TIMED) for scene in scenes("matched", LIBRARY, k)]


def _speed(reconstructors: Mapping[str, Choice]) -> Iterator[Row]:
    spent = times(reconstructors, timed_scenes(), _TURNS)
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
    ("wrong %", "", "wrong", ".1f"),
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
    "wrong: ΣFn or µ is off by more than half of itself, or Γ by more than 0.5, without a flag. "
    "constant: the mean of each set, which is the best answer that uses no image.",
)
