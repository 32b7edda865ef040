"""Breakdown curves of the trackers: one condition changed at a time, until markers are lost."""

import itertools
from collections.abc import Callable, Generator, Iterable, Mapping
from collections.abc import Sequence as Listed
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...by_name import Choice
from ...errors import UserError
from ...output.processes import one_thread
from ...output.report import Report, Row, reported
from ...render import Defects
from ..worlds.track_scenes import Conditions, Sequence, sequence
from ..worlds.track_scores import (
    Followed,
    all_numbers,
    errors_of,
    follow,
    right_share,
    swapped,
)

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


class Setting(NamedTuple):
    """Tracker, dial, its value, and the number of frames."""

    tracker: str
    dial: str
    value: float
    frames: int


@dataclass(frozen=True)
class Cell:
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

    @property
    def setting(self) -> Setting:
        """Setting of this cell."""
        return Setting(self.tracker, self.dial, self.value, self.frames)


def settings(trackers: Iterable[str], quick: bool) -> list[Setting]:
    """Every point of the curves of some trackers."""
    values = QUICK_VALUES if quick else {name: dial.values for name, dial in DIALS.items()}
    return [
        Setting(tracker, dial, value, QUICK_FRAMES if quick else FRAMES)
        for dial in values
        for value in values[dial]
        for tracker in trackers
    ]


def cells(
    wanted: Listed[Setting], trackers: Mapping[str, Choice], progress: Callable[[str], None]
) -> Generator[Cell]:
    """Run settings; those of one condition, one after the other, share their frames."""
    with one_thread():
        for (dial, value, count), group in itertools.groupby(wanted, lambda one: one[1:]):
            frames = sequence(DIALS[dial].conditions(value), count, limits=False)
            for setting in group:
                progress(f"{dial} {value:g}: {setting.tracker}")
                yield _cell(setting, trackers[setting.tracker], frames)


def _cell(setting: Setting, tracker: Choice, frames: Sequence) -> Cell:
    try:
        followed = follow(tracker, frames)
    except UserError as error:
        return Cell(*setting, 0.0, np.nan, 0, str(error))
    return Cell(*setting, *_scores(followed, frames), "")


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


def report(results: Listed[Cell], quick: bool) -> Report:
    """Value of each dial at which each tracker breaks, and each loss of identity in a sentence."""
    rows = rows_of(results)
    notes = [
        f"{row.subject[0]} takes one marker for another from a {row.subject[1]} of {row.value:g} "
        f"{row.unit} on"
        for row in rows
        if row.score == "identity_lost_at" and row.value is not None
    ]
    return Report(rows=tuple(rows), notes=tuple(notes), quick=quick)


def rows_of(results: Listed[Cell]) -> list[Row]:
    """Two figures for each tracker and dial.

    `breaks_at` is the last value up to which it holds, `identity_lost_at` the first with a swap.
    """
    rows = []
    for tracker, dial in dict.fromkeys((cell.tracker, cell.dial) for cell in results):
        curve = [cell for cell in results if (cell.tracker, cell.dial) == (tracker, dial)]
        unit, first, last = DIALS[dial].unit, curve[0].value, curve[-1].value
        held = [*itertools.takewhile(lambda cell: cell.right_percent >= HELD, curve)]
        note = "" if held else f"not even at {first:g}"
        if len(held) == len(curve):
            note = "holds to the end"
        value = held[-1].value if held else None
        rows.append(reported((tracker, dial, "breaks_at"), value, unit, note))
        if dial in ("shift", "twist"):
            lost = next((cell.value for cell in curve if cell.swaps), None)
            note = f"never, up to {last:g}" if lost is None else ""
            rows.append(reported((tracker, dial, "identity_lost_at"), lost, unit, note))
    return rows
