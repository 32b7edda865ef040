"""Figures of the trackers: every tracker on every scene, as multiples of the physical limit."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from ...errors import UserError
from ...output.rows import Row, at_least, reported, within
from ...render import LAYERS
from ...tracking import DEFAULT_TRACKER, tracker_names
from ..worlds.track_motion import ROUND
from ..worlds.track_scenes import PERIOD, SCENES, noisy, sequence
from ..worlds.track_scores import (
    CONSTANT,
    UNITS,
    follow,
    numbers,
    peak_memory,
    positions,
    scores,
    tracker_class,
)

#: Frames of a scene, and of the long one; then those of a quick run.
FRAMES, LONG = ROUND, 10_000
QUICK_FRAMES, QUICK_LONG = 6, 200
#: Scenes in which a quick run measures more than the default, unless trackers are named.
_QUICK_ALL = ("clean", "jump")
#: Frames at either end of the long scene whose errors are compared.
_END = 100
#: Scores of the default tracker that have to lie between two bounds.
TARGETS: dict[tuple[str, str], tuple[float, float]] = {
    **{("clean", f"{layer}_ratio"): (0.95, 1.15) for layer in LAYERS},
    **{("crosstalk", f"{layer}_bias"): (0.0, 0.01) for layer in LAYERS},
    **{
        (scene, score): (0.0, bound)
        for scene in ("gain-ramp", "shading-ramp", "shadow", "contrast")
        for score, bound in (("magenta_ratio", 2.0), ("yellow_ratio", 2.0), ("lost", 0.0))
    },
    ("jump", "swaps"): (0.0, 0.0),
    ("jump", "false"): (0.0, 0.0),
}


def bench_track(
    quick: bool, progress: Callable[[str], None], trackers: tuple[str, ...] = ()
) -> list[Row]:
    """Rows `scene/tracker/score`, and what is asked of the default, of speed and of the limit.

    Parameters
    ----------
    quick: fewer frames, only scenes with a target, in most of them only the default
    progress: told what is being measured
    trackers: names or module:Class; none are all that are there, beside a constant answer

    Raises
    ------
    UserError
        When there is no such tracker.
    """
    names = chosen(trackers)
    scenes = [scene for scene, _ in TARGETS] if quick else list(SCENES)
    count = QUICK_FRAMES if quick else FRAMES
    rows: list[Row] = []
    with threadpool_limits(1):
        cv2.setNumThreads(1)
        for scene in dict.fromkeys(scenes):
            progress(f"{scene}: frames and their limit")
            seen = sequence(SCENES[scene], count)
            few = quick and not trackers and scene not in _QUICK_ALL
            for name in (CONSTANT, DEFAULT_TRACKER) if few else names:
                progress(f"{scene}: {name}")
                try:
                    found = scores(follow(name, seen), seen)
                except UserError as error:
                    rows.append(Row(f"{scene}/{name}/refused", None, "", str(error), False))
                    continue
                rows += [_row(scene, name, score, value) for score, value in found.items()]
        longest = QUICK_LONG if quick else LONG
        rows += _drifts(trackers or (DEFAULT_TRACKER,), longest, progress)
        if not quick:
            able = {row.name for row in rows}
            for name in (name for name in names if f"clean/{name}/time" in able):
                progress(f"memory: {name}")
                rows.append(reported(f"clean/{name}/memory", peak_memory(name), "MB"))
    return [*rows, *_speed(rows, names), *_lowest(rows)]


def chosen(trackers: tuple[str, ...]) -> list[str]:
    """Names of the trackers to measure, beside the constant answer.

    Raises
    ------
    UserError
        When there is no such tracker.
    """
    names = list(dict.fromkeys([CONSTANT, *(trackers or tracker_names())]))
    for name in names:
        tracker_class(name)
    return names


def _row(scene: str, tracker: str, score: str, value: float) -> Row:
    name, unit = f"{scene}/{tracker}/{score}", UNITS[score]
    measured = value if np.isfinite(value) else None
    if tracker == DEFAULT_TRACKER and (scene, score) in TARGETS:
        return within(name, measured, unit, *TARGETS[scene, score])
    return reported(name, measured, unit)


def _drifts(names: tuple[str, ...], count: int, progress: Callable[[str], None]) -> Iterator[Row]:
    """Error of the last frames over that of the first, of a motion that goes round and round."""
    progress("long: frames")
    noise = SCENES["sway"].noise
    quiet = sequence(replace(SCENES["sway"], noise=0.0), ROUND, limits=False)
    rest = [noisy(frame.image, noise, 2**31 + k, 0.0) for k, frame in enumerate(quiet.rest)]
    for name in names:
        squares: list[float] = []
        row = f"long/{name}/drift"
        try:
            tracker = tracker_class(name)(quiet.palette, noise)
            number = numbers(tracker.reset(rest), quiet)
            for k in range(count):
                if k % 100 == 0:
                    progress(f"long: {name}, frame {k} of {count}")
                shot = quiet.shots[k % ROUND]
                tracks = tracker.update(noisy(shot.frame.image, noise, k, PERIOD * (k + 1)))
                if k < _END or k >= count - _END:
                    error = positions(tracks, number) - shot.centre
                    squares.append(float(np.nanmean(error**2)))
        except UserError as refused:
            yield Row(row, None, "", str(refused), False)
            continue
        ratio = float(np.sqrt(np.mean(squares[-_END:]) / np.mean(squares[:_END])))
        yield within(row, ratio if np.isfinite(ratio) else None, "", 0.9, 1.1)


def _speed(rows: list[Row], names: list[str]) -> Iterator[Row]:
    """Frames per second of the default, and of the fastest tracker within twice the limit."""
    found = {row.name: row.value for row in rows}
    fast: dict[str, float] = {}
    for name in names:
        worst = _worst(found, "clean", name)
        time = found.get(f"clean/{name}/time")
        if time is None or worst is None:
            continue
        if name == DEFAULT_TRACKER:
            yield at_least(f"speed/{name}", 1e3 / time, "frames/s", 200.0)
        # One that follows only what is easy would be fast, too.
        if worst <= 2.0 and (found[f"clean/{name}/right"] or 0.0) >= 99.0:
            fast[name] = 1e3 / time
    if fast:
        best = max(fast, key=lambda name: fast[name])
        unit = f"frames/s ({best})"
        yield at_least("speed/fastest_within_twice_the_limit", fast[best], unit, 1000.0)


def _lowest(rows: list[Row]) -> Iterator[Row]:
    """The bound's own test: nobody may be better than it."""
    # Layers that stand still make a constant answer better than any that looks at one frame.
    ratios = [
        row.value
        for row in rows
        if row.name.endswith("_ratio") and row.value is not None and "/constant/" not in row.name
    ]
    if ratios:
        yield at_least("limit/lowest_ratio", min(ratios), "× limit", 0.95)


def _worst(found: dict[str, float | None], scene: str, tracker: str) -> float | None:
    """RMS error of the worse layer as a multiple of the limit."""
    ratios = [found.get(f"{scene}/{tracker}/{layer}_ratio") for layer in LAYERS]
    known = [ratio for ratio in ratios if ratio is not None]
    return max(known) if known else None


def matrix(rows: list[dict[str, Any]]) -> list[list[str]]:
    """Table of trackers over scenes, with a heading: RMS error of the worse layer over the limit.

    Marks: s some identity swapped, l some marker lost, f some reported that is not there.
    """
    found = {row["name"]: row["value"] for row in rows}
    places = [name.split("/") for name in found if name.count("/") >= 2]
    scenes = list(dict.fromkeys(p[0] for p in places if p[0] in SCENES))
    trackers = list(dict.fromkeys("/".join(p[1:-1]) for p in places if p[0] in SCENES))
    table = [["", *scenes]]
    for tracker in trackers:
        line = [tracker]
        for scene in scenes:
            worst = _worst(found, scene, tracker)
            if worst is None:
                line.append("refused" if f"{scene}/{tracker}/refused" in found else "–")
                continue
            marks = "".join(
                mark
                for mark, score in (("s", "swaps"), ("l", "lost"), ("f", "false"))
                if found[f"{scene}/{tracker}/{score}"]
            )
            number = f"{worst:.2f}" if worst < 9.995 else f"{worst:.1f}" if worst < 99.95 else ""
            line.append(f"{number or round(worst)} {marks}".strip())
        table.append(line)
    return table


def asked(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows that have a target; the others fill screens."""
    return [
        row for row in rows if row["target"] != "reported" and not row["name"].endswith("/refused")
    ]


def refusals(rows: list[dict[str, Any]]) -> list[str]:
    """A sentence for each tracker that refused scenes, with its own reason."""
    scenes: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if row["name"].endswith("/refused"):
            scene, tracker = row["name"].removesuffix("/refused").split("/", 1)
            scenes.setdefault((tracker, row["target"]), []).append(scene)
    return [
        f"{tracker} refused {', '.join(where)}: {reason}"
        for (tracker, reason), where in scenes.items()
    ]


def matrix_lines(table: list[list[str]], width: int = 100) -> Iterator[str]:
    """Table as text, in as many blocks of columns as a line of that width needs."""
    sizes = [max(len(line[c]) for line in table) for c in range(len(table[0]))]
    first = 1
    while first < len(sizes):
        last, used = first, sizes[0]
        while last < len(sizes) and (last == first or used + 2 + sizes[last] <= width):
            used += 2 + sizes[last]
            last += 1
        for line in table:
            cells = [f"{line[c]:<{sizes[c]}}" for c in (0, *range(first, last))]
            yield "  ".join(cells).rstrip()
        yield ""
        first = last
    yield "RMS error of the worse layer over the Cramér–Rao bound of single frames"
    yield "s: some identity swapped, l: some visible marker lost, f: some absent one reported"
