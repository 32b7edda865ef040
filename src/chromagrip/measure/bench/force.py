"""Figures of force and friction estimates: all reconstructors on the same tracks, in two worlds."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from multiprocessing import get_context
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from ...output.processes import start_worker
from ...output.rows import Row, at_least, reported, within
from ...render.drawing.gl import gl_problem
from ...tracking import RECONSTRUCTORS, load_reconstructor
from ..worlds.force_scores import (
    CONSTANT,
    QUANTITIES,
    READ,
    UNITS,
    Answers,
    answers,
    constant,
    limits,
    scores,
    times,
    truth,
)
from ..worlds.grasps import KNOWN, LIBRARY, OBJECTS, WORLDS, ForceScene, scenes

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
#: From one of the objects to the next: few of them vary as all do, 27 are all.
_STRIDE = 10
#: Grasps of the matched library whose information limit is computed, a second each.
_LIMITED, _QUICK_LIMITED = 48, 4
#: Grasps and turns of the speed.
_TIMED, _TURNS = 4, 5
#: Scores of each reading of friction, off single fields.
_OF_FRICTION = ("mu_rms", "mu_bias", "mu_coverage", "mu_width", "margin_near_rms")
#: Bounds of scores of BEST, by set and what is read.
TARGETS: dict[tuple[str, str, str], tuple[float, float]] = {
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


@dataclass(frozen=True, kw_only=True)
class Task:
    """One grasp to make, and who is asked of it.

    Attributes
    ----------
    world, kind, index: see `force_scenes.scenes`
    names: of the reconstructors
    limited: whether its limits are computed
    """

    world: str
    kind: str
    index: int
    names: tuple[str, ...]
    limited: bool


@dataclass(frozen=True, kw_only=True)
class Measured:
    """What a grasp of S scenes gave: truth (S, 4), answers and limits (S, 4) by what is read."""

    true: Array
    said: dict[tuple[str, str], Answers]
    limit: dict[str, Array]


def bench_force(
    quick: bool, progress: Callable[[str], None], reconstructors: tuple[str, ...] = ()
) -> list[Row]:
    """Rows `set/read/reconstructor/score`, and the speed of every reconstructor.

    Parameters
    ----------
    quick: few grasps, unless named only the reconstructors that have to reach the targets
    progress: told what is being measured
    reconstructors: names or module:Class; none are all of ours, beside a constant answer

    Raises
    ------
    UserError
        When there is no such reconstructor.
    """
    default = tuple(BEST.values()) if quick else tuple(list(RECONSTRUCTORS.entries)[1:])
    names = chosen(reconstructors or default)
    counts = dict(QUICK if quick else COUNTS)
    rows: list[Row] = []
    if (problem := gl_problem()) is not None:
        rows.append(Row("mismatched/not_measured", None, "", problem, False))
        counts = {(world, kind): n for (world, kind), n in counts.items() if world == "matched"}
    found = measure(counts, names, _QUICK_LIMITED if quick else _LIMITED, progress)
    for name, measured in found.items():
        rows += _rows(name, measured)
    progress("speed")
    return [*rows, *_speed(names)]


def set_name(world: str, kind: str) -> str:
    """Name of a set in rows."""
    return world if kind == LIBRARY else f"{world}-{kind}"


def chosen(reconstructors: Sequence[str]) -> tuple[str, ...]:
    """Each of these reconstructors once.

    Raises
    ------
    UserError
        When there is no such reconstructor.
    """
    names = tuple(dict.fromkeys(reconstructors))
    for name in names:
        load_reconstructor(name)
    return names


def measure(
    counts: Mapping[tuple[str, str], int],
    names: tuple[str, ...],
    limited: int,
    progress: Callable[[str], None],
) -> dict[str, Measured]:
    """Ask reconstructors of the grasps of some sets, in a process per core.

    Parameters
    ----------
    counts: of grasps by world and kind
    names: of the reconstructors
    limited: grasps of the matched library whose limits are computed, the first ones
    progress: told how far it is

    Returns
    -------
    By `set_name`.
    """
    tasks = [
        Task(
            world=world,
            kind=kind,
            index=k if kind == LIBRARY else k * _STRIDE % len(OBJECTS),
            names=names,
            limited=(world, kind) == ("matched", LIBRARY) and k < limited,
        )
        for (world, kind), count in counts.items()
        for k in range(count)
    ]
    done: dict[str, list[Measured]] = {}
    with get_context("spawn").Pool(os.cpu_count(), initializer=start_worker) as pool:
        for number, (task, part) in enumerate(zip(tasks, pool.imap(ask, tasks), strict=True)):
            name = set_name(task.world, task.kind)
            done.setdefault(name, []).append(part)
            progress(f"{name}: grasp {number + 1} of {len(tasks)}")
    return {name: _joined(parts) for name, parts in done.items()}


def _joined(parts: Sequence[Measured]) -> Measured:
    return Measured(
        true=np.concatenate([part.true for part in parts]),
        said={key: Answers.joined([part.said[key] for part in parts]) for key in parts[0].said},
        limit={read: np.concatenate([part.limit[read] for part in parts]) for read in READ},
    )


def ask(task: Task) -> Measured:
    """Make a grasp and ask every reconstructor of it."""
    with threadpool_limits(1):
        made = scenes(task.world, task.kind, task.index)
        said: dict[tuple[str, str], list[Answers]] = {}
        for scene, name in product(made, task.names):
            for key, one in answers(name, scene).items():
                said.setdefault(key, []).append(one)
        unknown = np.full(4, np.nan)
        return Measured(
            true=np.stack([truth(scene) for scene in made]),
            said={key: Answers.joined(parts) for key, parts in said.items()},
            limit={
                read: np.stack([limits(s, frames) if task.limited else unknown for s in made])
                for read, frames in READ.items()
            },
        )


def _rows(name: str, measured: Measured) -> Iterator[Row]:
    fixed = {(CONSTANT, read): constant(measured.true) for read in READ}
    for (who, read), said in (fixed | measured.said).items():
        reading = "+" in who
        if reading and (read != "single" or said.flagged.all()):
            continue
        limit = measured.limit[read]
        known = limit if np.isfinite(limit).any() else None
        for score, value in scores(said, measured.true, known).items():
            if reading and score not in _OF_FRICTION:
                continue
            row, seen = f"{name}/{read}/{who}/{score}", value if np.isfinite(value) else None
            bound = TARGETS.get((name, read, score)) if who == BEST[read] else None
            if bound is None:
                yield reported(row, seen, UNITS[score])
            else:
                yield within(row, seen, UNITS[score], *bound)


def timed_scenes() -> list[ForceScene]:
    """Grasps that the speed is measured on."""
    return [scene for k in range(_TIMED) for scene in scenes("matched", LIBRARY, k)]


def _speed(names: Sequence[str]) -> Iterator[Row]:
    spent = times(names, timed_scenes(), _TURNS)
    rate = {name: 1e3 / float(np.median(spent[name])) for name in names}
    for name, fields in rate.items():
        if name == BEST["single"]:
            yield at_least(f"speed/{name}", fields, "fields/s", 300.0)
        else:
            yield reported(f"speed/{name}", fields, "fields/s")
    cheapest = max(rate, key=lambda name: rate[name])
    yield at_least("speed/cheapest", rate[cheapest], f"fields/s ({cheapest})", 2000.0)


#: Columns of the printed table: heading, what to add to the world's name, score, and digits.
_COLUMNS = (
    ("ΣFn %", "", "normal_rms", 1),
    ("ΣFf N", "", "friction_rms", 3),
    ("µ", "", "mu_rms", 3),
    ("µ bias", "", "mu_bias", 3),
    ("Γ≈0.3", "", "margin_near_rms", 3),
    ("Γ objects", "-objects", "margin_rms", 3),
    ("Γ controlled", "-controlled", "margin_rms", 3),
    ("Γ 5 N", "-conservative", "margin_rms", 3),
    ("flagged %", "", "flagged", 1),
    ("wrong %", "", "wrong", 1),
)


def matrix(rows: list[dict[str, Any]]) -> list[list[str]]:
    """Table of reconstructors, with a heading: errors matched / mismatched, flags, speed."""
    found = {row["name"]: row["value"] for row in rows}
    named = dict.fromkeys(name.split("/")[2] for name in found if name.count("/") == 3)
    who = [name for name in named if "+" not in name]
    table = [["RMS errors", *(heading for heading, *_ in _COLUMNS), "fields/s"]]
    for read in READ:
        for name in who:
            line = [f"{name}, {read}"]
            for _, more, score, digits in _COLUMNS:
                pair = [found.get(f"{world}{more}/{read}/{name}/{score}") for world in WORLDS]
                cells = ["–" if value is None else f"{value:.{digits}f}" for value in pair]
                line.append(" / ".join(cells))
            rate = found.get(f"speed/{name}")
            table.append([*line, "" if rate is None else f"{rate:.0f}"])
    return table


def readings(rows: list[dict[str, Any]]) -> list[list[str]]:
    """Table of reconstructors over readings of friction, with a heading: RMS error of µ, bias."""
    found = {row["name"]: row["value"] for row in rows}
    names = [name.split("/")[2].split("+") for name in found if name.endswith("/mu_rms")]
    pairs = [name for name in names if len(name) == 2]
    methods = list(dict.fromkeys(method for _, method in pairs))
    table = [["RMS error of µ (bias)", *methods]]
    for who in dict.fromkeys(who for who, _ in pairs):
        line = [who]
        for method in methods:
            cells = []
            for world in WORLDS:
                start = f"{world}/single/{who}+{method}"
                error, bias = (found.get(f"{start}/{score}") for score in ("mu_rms", "mu_bias"))
                known = error is not None and bias is not None
                cells.append(f"{error:.3f} ({bias:+.3f})" if known else "–")
            line.append(" / ".join(cells))
        table.append(line)
    return table


def asked(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows that have a target, and speeds; the others fill screens."""
    return [row for row in rows if row["target"] != "reported" or row["name"].startswith("speed/")]


#: What the table is of.
NOTES = (
    "RMS errors, matched / mismatched sensor: of single frames, each read as the first after rest,",
    "and of the last of ten frames in 0.1 s of a still grasp. Γ≈0.3 are the grasps of the library",
    "with Γ in 0.2…0.4, objects the 27 at Γ = 0.3, controlled what Safety Margin Control did with",
    "them, 5 N Conservative Control. Wrong is ΣFn or µ off by more than half, or Γ by 0.5,",
    "without a flag; constant is the mean of each set, the best answer that does not look.",
)


def matrix_lines(table: list[list[str]]) -> Iterator[str]:
    """Table as text."""
    sizes = [max(len(line[c]) for line in table) for c in range(len(table[0]))]
    for line in table:
        yield "  ".join(f"{cell:<{size}}" for cell, size in zip(line, sizes, strict=True)).rstrip()
