"""Breakdown curves of the trackers: one condition changed at a time, until markers are lost."""

import itertools
from collections.abc import Callable
from collections.abc import Sequence as Listed
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from ...by_name import Choice
from ...errors import UserError
from ...output.figure import WIDTH, legend_below, new_figure, plain_ticks, png
from ...output.report import Report, Row, reported
from ...render import Defects
from ...tracking import DEFAULT_TRACKER
from ..bench.track import choose
from ..study import Asked, Study, study
from ..worlds.track_scenes import Conditions, Sequence, sequence
from ..worlds.track_scores import (
    CONSTANT,
    RIGHT,
    Followed,
    all_numbers,
    errors_of,
    follow,
    right_share,
    swapped,
)
from .fields import SMALL, title_of
from .panels import map_study

#: Share of the markers that have to be right in every frame [%].
HELD = 95.0
#: Frames of a point.
FRAMES = 12
#: Frames of a point of a quick map: the first frames of the same motion.
QUICK_FRAMES = 4


@dataclass(frozen=True)
class Dial:
    """One condition that is changed.

    Attributes
    ----------
    label: of the axis, with its unit
    unit: of the values
    values: from easy to hard
    conditions: at a value
    """

    label: str
    unit: str
    values: tuple[float, ...]
    conditions: Callable[[float], Conditions]


_SHARES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
_SMALL_SHARES = (0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5)
DIALS = {
    "shift": Dial(
        "shift per frame [pitches]",
        "pitches",
        (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.2, 1.5, 2.0),
        lambda v: Conditions(text="", grasp=0.0, sway_px=0.0, shift_pitch=v),
    ),
    "noise": Dial(
        "noise [grey levels]",
        "levels",
        (1.0, 2.0, 4.0, 8.0, 12.0, 16.0, 24.0, 32.0),
        lambda v: Conditions(text="", noise=v),
    ),
    "blur": Dial(
        "more defocus than at rest [px]",
        "px",
        (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0),
        lambda v: Conditions(text="", defocus_px=v),
    ),
    "gain": Dial(
        "light lost in the last frame",
        "",
        _SHARES,
        lambda v: Conditions(text="", light=1.0 - v),
    ),
    "shadow": Dial(
        "light lost in a shadow",
        "",
        _SHARES,
        lambda v: Conditions(text="", shadow=v),
    ),
    "missing": Dial(
        "markers vanished after rest, share",
        "",
        _SMALL_SHARES,
        lambda v: Conditions(text="", vanishing=v),
    ),
    "crosstalk": Dial(
        "green that yellow takes, calibrated as 1 %",
        "",
        _SMALL_SHARES,
        lambda v: Conditions(text="", crosstalk=v, stated_crosstalk=0.01),
    ),
    "jpeg": Dial(
        "JPEG quality",
        "quality",
        (95.0, 85.0, 75.0, 60.0, 45.0, 30.0, 15.0, 5.0),
        lambda v: Conditions(text="", defects=Defects(jpeg_quality=round(v))),
    ),
    "twist": Dial(
        "twist of a ball on the dome [°]",
        "°",
        (10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 90.0),
        lambda v: Conditions(text="", contact="twist", contact_scale=v / 40.0),
    ),
    "edge": Dial(
        "press of an edge over the silicone's thickness",
        "",
        (0.1, 0.2, 0.3, 0.4, 0.5, 0.6),
        lambda v: Conditions(text="", contact="edge", contact_deeper=v / 0.35),
    ),
}
#: Values of each dial of a quick map.
QUICK_VALUES = {"shift": (0.3, 0.6, 1.2), "noise": (2.0, 16.0)}


class TrackCondition(NamedTuple):
    """Dial, its value, the number of frames, and the trackers that follow them by name."""

    dial: str
    value: float
    frames: int
    trackers: dict[str, Choice]


@dataclass(frozen=True)
class TrackCell:
    """One tracker at one value of one dial.

    Attributes
    ----------
    tracker, dial, value, frames: the setting
    right_percent: share of the markers that are right in the worst frame: reported within RIGHT of
        their own place, or absent and not reported
    rms_px: per coordinate, of visible markers that are reported; NaN for none
    swaps: reports at the place of another marker
    note: why the tracker refused
    """

    tracker: str
    dial: str
    value: float
    frames: int
    right_percent: float
    rms_px: float
    swaps: int
    note: str


@study("stability", "track", method="tracker", example="--tracker lk --quick")
def track_map(asked: Asked) -> Study[TrackCondition, list[TrackCell]]:
    """Trackers over one condition at a time, until markers are lost.

    A quick map has a few values of two conditions, and fewer frames.
    """
    trackers, quick = choose(asked), asked.quick
    values = QUICK_VALUES if quick else {name: dial.values for name, dial in DIALS.items()}
    return map_study(
        "map",
        [
            TrackCondition(dial, value, QUICK_FRAMES if quick else FRAMES, trackers)
            for dial, of_dial in values.items()
            for value in of_dial
        ],
        cells,
        TrackCell,
        report,
        partial(draw_track, quick=quick),
        words=lambda one: f"{one.dial} {one.value:g}",
    )


def cells(setting: TrackCondition) -> list[TrackCell]:
    """What all trackers make of one condition."""
    frames = sequence(DIALS[setting.dial].conditions(setting.value), setting.frames, limits=False)
    return [_cell(name, each, setting, frames) for name, each in setting.trackers.items()]


def _cell(name: str, tracker: Choice, setting: TrackCondition, frames: Sequence) -> TrackCell:
    found, note = (0.0, np.nan, 0), ""
    try:
        found = _scores(follow(tracker, frames), frames)
    except UserError as error:
        note = str(error)
    return TrackCell(name, setting.dial, setting.value, setting.frames, *found, note)


def _scores(followed: Followed, frames: Sequence) -> tuple[float, float, int]:
    """Share right in the worst frame [%], RMS error [px] and swaps."""
    position, error, visible = errors_of(followed, all_numbers(followed, frames), frames)
    worst = min(
        right_share(error[k], visible[k], shot.visible, shot.hidden & frames.there)
        for k, shot in enumerate(frames.shots)
    )
    known = error[np.isfinite(error)]
    rms = float(np.sqrt((known**2).mean())) if known.size else np.nan
    swaps = sum(int(swapped(position[k], frames, k).sum()) for k in range(len(position)))
    return 100.0 * worst, rms, swaps


def report(results: Listed[TrackCell]) -> Report:
    """Value of each dial at which each tracker breaks, and each loss of identity in a sentence."""
    rows = rows_of(results)
    notes = [
        f"{row.subject[0]} takes one marker for another from a {row.subject[1]} of {row.value:g} "
        f"{row.unit} on"
        for row in rows
        if row.score == "identity_lost_at" and row.value is not None
    ]
    held = f"holds: {HELD:g} % of the markers are right in every frame. {CONSTANT}: {_CONSTANT}"
    return Report(rows=tuple(rows), notes=(held, *notes))


#: Meaning of the constant answer.
_CONSTANT = "every marker stays at its place at rest, which is the answer that uses no picture."


def rows_of(results: Listed[TrackCell]) -> list[Row]:
    """Two figures for each tracker and dial.

    `holds_up_to` is the last value up to which it holds, `identity_lost_at` the first with a swap.
    """
    rows = []
    for tracker, dial in dict.fromkeys((cell.tracker, cell.dial) for cell in results):
        curve = [cell for cell in results if (cell.tracker, cell.dial) == (tracker, dial)]
        unit, first, last = DIALS[dial].unit, curve[0].value, curve[-1].value
        held = [*itertools.takewhile(lambda cell: cell.right_percent >= HELD, curve)]
        note = f"fails at {curve[len(held)].value:g}" if 0 < len(held) < len(curve) else ""
        if not held:
            note = (
                f"fails already at the easiest setting ({first:g}): "
                f"{curve[0].right_percent:.0f} % right, {HELD:g} % needed"
            )
        elif len(held) == len(curve):
            note = "holds at all values"
        value = held[-1].value if held else None
        rows.append(reported((tracker, dial, "holds_up_to"), value, unit, note))
        if dial in ("shift", "twist"):
            lost = next((cell.value for cell in curve if cell.swaps), None)
            note = f"never, up to {last:g}" if lost is None else ""
            rows.append(reported((tracker, dial, "identity_lost_at"), lost, unit, note))
    return rows


#: Colours of the trackers' curves, used in turns.
_COLOURS = (
    *("#777777", "#d55e00", "#0072b2", "#009e73", "#e69f00"),
    *("#6d1a86", "#222222", "#8c5a2b", "#cc79a7", "#56b4e9"),
)
#: Markers of the trackers' curves, used in turns.
_MARKERS = "xo^svDP*<>"
#: Line styles of the trackers' curves, used in turns.
_DASHES = ["-", "-", "--", "-.", ":", "--", "-", "-.", ":", "--"]


def draw_track(results: Listed[TrackCell], path: Path, quick: bool) -> None:
    """Write the curves of all trackers: share of right markers, and error, over each dial."""
    dials = list(dict.fromkeys(cell.dial for cell in results))
    title = f"Share of markers within {RIGHT:g} px of their own place; error of those reported"
    figure = new_figure(title_of(title, quick), WIDTH, 1.6 * len(dials) + 1.5)
    panels = figure.subplots(len(dials), 2, squeeze=False)
    for (right, error), dial in zip(panels, dials, strict=True):
        _curves(right, error, [cell for cell in results if cell.dial == dial])
    panels[0, 0].set_title("right, worst frame [%]", fontsize=9)
    panels[0, 1].set_title("RMS error [px]", fontsize=9)
    legend_below(figure, panels[0, 0].get_lines(), 4)
    path.write_bytes(png(figure))


def _curves(right: Axes, error: Axes, part: Listed[TrackCell]) -> None:
    values = list(dict.fromkeys(cell.value for cell in part))
    for axes in (right, error):
        axes.set_prop_cycle(color=_COLOURS, marker=list(_MARKERS), linestyle=_DASHES)
        axes.set_xticks(range(len(values)), [f"{value:g}" for value in values])
        axes.tick_params(labelsize=SMALL)
        axes.set_xlabel(DIALS[part[0].dial].label, fontsize=8)
    for name in dict.fromkeys(cell.tracker for cell in part):
        curve = [cell for cell in part if cell.tracker == name]
        x = [values.index(cell.value) for cell in curve]
        width, order = (2.6, 1.5) if name == DEFAULT_TRACKER else (1.1, 2.0)
        shares, errors = [c.right_percent for c in curve], [c.rms_px for c in curve]
        right.plot(x, shares, ms=4.5, mfc="none", lw=width, zorder=order, label=name)
        error.plot(x, errors, ms=4.5, mfc="none", lw=width, zorder=order)
    text = f"{HELD:g} %: identity is held above"
    right.axhline(HELD, color="0.3", lw=0.9, ls=(0, (1, 3)), marker="", label=text)
    right.set_ylim(-6.0, 106.0)
    error.set_yscale("log")
    plain_ticks(error.yaxis)
