"""Figures of the trackers: every tracker on every scene, as multiples of the physical limit."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...by_name import Choice
from ...errors import UserError
from ...output.report import (
    Bounds,
    Report,
    Row,
    Table,
    at_least,
    measured,
    reported,
    score_table,
    values,
    within,
)
from ...render import LAYERS
from ...tracking import DEFAULT_TRACKER, tracker_names
from ..study import Asked, Results, Study, study
from ..worlds.track_compressed import CODECS, compressed, stated_errors
from ..worlds.track_compressed import UNITS as CODEC_UNITS
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

#: Frames of a scene.
FRAMES = ROUND
#: Frames of the long scene.
LONG = 10_000
#: Frames of a scene in a quick run.
QUICK_FRAMES = 6
#: Frames of the long scene in a quick run.
QUICK_LONG = 200
#: Scenes in which a quick run measures more than the default, unless trackers are chosen.
_QUICK_ALL = ("clean", "jump")
#: Frames at either end of the long scene whose errors are compared.
_END = 100
#: Targets of the default tracker, by scene and score.
TARGETS: dict[tuple[str, str], Bounds] = {
    **{("clean", f"{layer}_ratio"): Bounds(0.95, 1.15) for layer in LAYERS},
    **{("crosstalk", f"{layer}_bias"): Bounds(0.0, 0.01) for layer in LAYERS},
    **{
        (scene, score): Bounds(0.0, bound)
        for scene in ("gain-ramp", "shading-ramp", "shadow", "contrast")
        for score, bound in (("magenta_ratio", 2.0), ("yellow_ratio", 2.0), ("lost", 0.0))
    },
    **{
        (scene, score): Bounds(0.0, 0.0)
        for scene in ("jump", "drift")
        for score in ("swaps", "false")
    },
    **{
        (scene, score): Bounds(0.0, bound)
        for scene in ("twist", "edge")
        for score, bound in (("magenta_ratio", 1.3), ("yellow_ratio", 1.3), ("swaps", 0.0))
    },
}
#: Codecs in a quick run.
_QUICK_CODECS = ("h264-crf12", "jpeg-q90")
#: Codecs whose tracks are meant for use, which have targets.
_USABLE = ("h264-crf0", "h264-crf12", "h264-crf20", "h264-444-crf12", "h265-crf12", "mjpeg-q2",
           "jpeg-q95", "jpeg-q90", "jpeg-q80")  # fmt: skip
#: Errors over the stated deviation, of places of the worse layer.
_STATED = Bounds(0.7, 1.4)
_RATIOS = [f"{layer}_ratio" for layer in LAYERS]
#: Marks of a tracker in a scene, each with the score that gives it.
_MARKS = {"s": "swaps", "l": "lost", "f": "false"}
_CODEC_NOTE = "errors of places that moved over their stated deviations"
_NOTE = (
    "Numbers are the RMS error of the worse layer over the Cramér–Rao bound of single frames. "
    "Marks: s, two markers were taken for each other; l, a visible marker was not reported; "
    "f, an absent marker was reported."
)


class TrackPart(NamedTuple):
    """One measurement of trackers.

    Attributes
    ----------
    kind: key of `_PARTS`
    name: of the scene or the codec
    trackers: by their name in rows
    frames: number of them
    """

    kind: str
    name: str
    trackers: dict[str, Choice]
    frames: int = FRAMES


@study(
    "bench",
    "track",
    method="tracker",
    parts=tuple(SCENES),
    of_parts="scene",
    example="--tracker lk --scene clean --quick",
)
def track_study(asked: Asked) -> Study[TrackPart, tuple[Row, ...]]:
    """Errors of every tracker in every scene, as multiples of the physical limit.

    Rows are `scene/tracker/score`, and the speed and the bound itself. A quick run has fewer
    frames, only scenes with a target, and in most of them only the default. Codecs and the long
    scene are left out where scenes are chosen.
    """
    chosen, quick = choose(asked), asked.quick
    wanted = asked.only or ([scene for scene, _ in TARGETS] if quick else list(SCENES))
    parts = []
    for scene in dict.fromkeys(wanted):
        few = quick and scene not in _QUICK_ALL
        always = (CONSTANT, DEFAULT_TRACKER, *asked.methods)
        some = {n: c for n, c in chosen.items() if not few or n in always or c in always}
        parts.append(TrackPart("scene", scene, some, QUICK_FRAMES if quick else FRAMES))
    if not asked.only:
        default: dict[str, Choice] = {DEFAULT_TRACKER: DEFAULT_TRACKER}
        if not asked.methods:
            codecs = _QUICK_CODECS if quick else tuple(CODECS)
            parts += [TrackPart("codec", name, default) for name in codecs]
        moving = asked.chosen([DEFAULT_TRACKER], tracker_class)
        parts.append(TrackPart("long", "long", moving, QUICK_LONG if quick else LONG))
        if not quick:
            parts += [TrackPart("memory", "clean", {name: each}) for name, each in chosen.items()]
    return Study(
        timed=parts,
        measure=rows_of,
        result=tuple[Row, ...],
        report=lambda results: report_of(results, chosen),
        words=lambda part: f"{part.kind} {part.name}",
    )


def rows_of(part: TrackPart) -> tuple[Row, ...]:
    """Figures of one measurement."""
    return tuple(_PARTS[part.kind](part))


def report_of(results: Results[TrackPart, tuple[Row, ...]], chosen: Collection[str]) -> Report:
    """Report of all measurements of these trackers."""
    rows = [row for _, found in results for row in found]
    rows += [*_speed(rows, chosen), *_lowest(rows)]
    clean = [row for row in rows if row.subject[0] == "clean" and row.score != "refused"]
    coded = [row for row in rows if row.subject[0] == "codec" and row.score != "refused"]
    texts = tuple((f"`{name}`", scene.text) for name, scene in SCENES.items())
    return Report(
        rows=tuple(rows),
        tables=(matrix(rows), *plain(rows)),
        notes=(_NOTE, *refusals(rows)),
        details=(
            Table(("scene", "conditions"), texts, "Scenes"),
            score_table(clean, lambda row: row.subject[1], "Every score in the scene `clean`"),
            score_table(coded, lambda row: row.subject[1], f"`clean` after codecs, {_CODEC_NOTE}"),
        ),
    )


def choose(asked: Asked) -> dict[str, Choice]:
    """Trackers to compare by name, with the constant answer; unless chosen all that there are."""
    return asked.chosen(tracker_names(), tracker_class, (CONSTANT,))


def _scene_rows(part: TrackPart) -> Iterator[Row]:
    """Every score of trackers in a scene, or the reason why a tracker refused its frames."""
    scene = part.name
    frames = sequence(SCENES[scene], part.frames)
    for name, choice in part.trackers.items():
        try:
            found = scores(follow(choice, frames), frames)
        except UserError as error:
            yield reported((scene, name, "refused"), None, "", str(error))
            continue
        for score, value in found.items():
            target = TARGETS.get((scene, score)) if name == DEFAULT_TRACKER else None
            yield measured((scene, name, score), value, UNITS[score], target)


def _codec_rows(part: TrackPart) -> Iterator[Row]:
    """Errors of the default tracker over what it states, in the scene `clean` after a codec."""
    after = compressed(sequence(SCENES["clean"], FRAMES, limits=False), CODECS[part.name])
    found = stated_errors(follow(DEFAULT_TRACKER, after), after)
    found["places"] = max(found[f"{layer}_places"] for layer in LAYERS)
    for score, value in found.items():
        target = _STATED if score == "places" and part.name in _USABLE else None
        yield measured(("codec", part.name, score), value, CODEC_UNITS[score], target)


def _drifts(part: TrackPart) -> Iterator[Row]:
    """Error of the last frames over that of the first ones, of a motion that repeats itself."""
    noise = SCENES["sway"].noise
    quiet = sequence(replace(SCENES["sway"], noise=0.0), ROUND, limits=False)
    rest = [noisy(frame.image, noise, 2**31 + k, 0.0) for k, frame in enumerate(quiet.rest)]
    for name, choice in part.trackers.items():
        squares: list[float] = []
        ratio, note = np.nan, ""
        try:
            tracker = tracker_class(choice)(quiet.palette, noise)
            number = numbers(tracker.reset(rest), quiet)
            for k in range(part.frames):
                shot = quiet.shots[k % ROUND]
                tracks = tracker.update(noisy(shot.frame.image, noise, k, PERIOD * (k + 1)))
                if k < _END or k >= part.frames - _END:
                    offset = positions(tracks, number) - shot.centre
                    squares.append(float(np.nanmean(offset**2)))
            ratio = float(np.sqrt(np.mean(squares[-_END:]) / np.mean(squares[:_END])))
        except UserError as error:
            note = str(error)
        yield within(("long", name, "drift"), ratio, "", 0.9, 1.1, note)


def _memory(part: TrackPart) -> Iterator[Row]:
    """Largest memory of a process that follows the scene `clean`."""
    for name, choice in part.trackers.items():
        with suppress(UserError):  # refuses it
            yield reported(("clean", name, "memory"), peak_memory(choice), "MB")


_PARTS: dict[str, Callable[[TrackPart], Iterator[Row]]] = {
    "scene": _scene_rows,
    "codec": _codec_rows,
    "long": _drifts,
    "memory": _memory,
}


def _speed(rows: Sequence[Row], trackers: Collection[str]) -> Iterator[Row]:
    """Frames per second of the default, and of the fastest tracker within twice the limit."""
    found = values(rows)
    fast: dict[str, float] = {}
    for name in trackers:
        worst, time = _worst(found, "clean", name), found.get(("clean", name, "time"))
        if time is None or worst is None:
            continue
        if name == DEFAULT_TRACKER:
            yield at_least(("speed", name), 1e3 / time, "frames/s", 200.0)
        # A tracker that follows only what is easy would be fast, too.
        if worst <= 2.0 and (found["clean", name, "right"] or 0.0) >= 99.0:
            fast[name] = 1e3 / time
    if fast:
        best = max(fast, key=lambda name: fast[name])
        unit = f"frames/s ({best})"
        yield at_least(("speed", "fastest_within_twice_the_limit"), fast[best], unit, 1000.0)


def _lowest(rows: Sequence[Row]) -> Iterator[Row]:
    """Test of the bound itself: no tracker may be better."""
    # Layers that stand still make a constant answer better than any that looks at one frame.
    ratios = [
        row.value
        for row in rows
        if row.score in _RATIOS and row.value is not None and row.subject[1] != CONSTANT
    ]
    if ratios:
        yield at_least(("limit", "lowest_ratio"), min(ratios), "× limit", 0.95)


Values = Mapping[tuple[str, ...], float | None]


def _worst(found: Values, scene: str, tracker: str) -> float | None:
    """RMS error of the worse layer as a multiple of the limit."""
    ratios = [found.get((scene, tracker, ratio)) for ratio in _RATIOS]
    return max((ratio for ratio in ratios if ratio is not None), default=None)


def matrix(rows: Sequence[Row]) -> Table:
    """Table of scenes over trackers: RMS error of the worse layer over the limit, and marks."""
    found = values(rows)
    cases = [row.subject for row in rows if row.subject[0] in SCENES]
    trackers = dict.fromkeys(tracker for _, tracker in cases)
    return Table(
        header=("scene", *trackers),
        lines=tuple(
            (scene, *(_cell(found, scene, tracker) for tracker in trackers))
            for scene in dict.fromkeys(scene for scene, _ in cases)
        ),
    )


def plain(rows: Sequence[Row]) -> Iterator[Table]:
    """The same in pixels, what was lost, and the speed: tables of scenes over trackers."""
    found = values(rows)
    cases = [row.subject for row in rows if row.subject[0] in SCENES]
    trackers = dict.fromkeys(tracker for _, tracker in cases)

    def table(title: str, cell: Callable[[str, str], float | None], digits: int) -> Table:
        lines = []
        for scene in dict.fromkeys(scene for scene, _ in cases):
            told = (cell(scene, tracker) for tracker in trackers)
            lines.append((scene, *("–" if v is None else f"{v:.{digits}f}" for v in told)))
        return Table(("scene", *trackers), tuple(lines), title)

    def pixels(scene: str, tracker: str) -> float | None:
        each = [found.get((scene, tracker, f"{layer}_rms")) for layer in LAYERS]
        return max((one for one in each if one is not None), default=None)

    def rate(scene: str, tracker: str) -> float | None:
        time = found.get((scene, tracker, "time"))
        return None if not time else 1e3 / time

    yield table("RMS error of the worse layer [px]", pixels, 3)
    yield table(
        "Visible markers that were not reported, in frames",
        lambda scene, tracker: found.get((scene, tracker, "lost")),
        0,
    )
    yield table("Frames a second, one core", rate, 0)


def _cell(found: Values, scene: str, tracker: str) -> str:
    worst = _worst(found, scene, tracker)
    if worst is None:
        return "refused" if (scene, tracker, "refused") in found else "–"
    marks = "".join(mark for mark, score in _MARKS.items() if found[scene, tracker, score])
    digits = 2 if worst < 10.0 else 1 if worst < 100.0 else 0
    return f"{worst:.{digits}f} {marks}".strip()


def refusals(rows: Sequence[Row]) -> tuple[str, ...]:
    """A sentence for each tracker that refused scenes, with its own reason."""
    scenes: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if row.score == "refused":
            scene, tracker = row.subject
            scenes.setdefault((tracker, row.note), []).append(scene)
    return tuple(
        f"{tracker} refused {', '.join(where)}: {reason}"
        for (tracker, reason), where in scenes.items()
    )
