"""Breakdown curves of the trackers: one condition turned at a time, until the markers are lost."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from threadpoolctl import threadpool_limits

from ...errors import UserError
from ...output.cells import read_cells, write_cells
from ...output.folder import prepare
from ...output.rows import Row, report, reported
from ...render import Defects
from ...tracking import DEFAULT_TRACKER
from ..bench.track import choose
from ..worlds.track_scenes import Conditions, Sequence, sequence
from ..worlds.track_scores import (
    RIGHT,
    Followed,
    all_numbers,
    errors_of,
    follow,
    right_share,
    swapped,
)

#: Share of the markers that have to be right in every frame [%].
HELD = 95.0
#: Frames of a point, and of one of a quick map; the first frames of the same motion.
FRAMES, QUICK_FRAMES = 12, 4
#: Of the trackers' curves, in turns.
_COLOURS = (
    *("#9e9e9e", "#d62828", "#1d70b8", "#2a9d8f", "#f4a261"),
    *("#6d1a86", "#222222", "#b08968", "#e377c2", "#8ac926"),
)
_MARKERS = "xo^svDP*<>"


@dataclass(frozen=True, kw_only=True)
class Dial:
    """One condition that is turned.

    Attributes
    ----------
    label: of the axis, with its unit
    unit: of the values
    values: from kind to hostile
    conditions: at a value
    """

    label: str
    unit: str
    values: tuple[float, ...]
    conditions: Callable[[float], Conditions]


_SHARES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
DIALS = {
    "shift": Dial(
        label="shift per frame [pitches]",
        unit="pitches",
        values=(0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.2, 1.5, 2.0),
        conditions=lambda v: Conditions(text="", grasp=0.0, sway_px=0.0, shift_pitch=v),
    ),
    "noise": Dial(
        label="noise [grey levels]",
        unit="levels",
        values=(1.0, 2.0, 4.0, 8.0, 12.0, 16.0, 24.0, 32.0),
        conditions=lambda v: Conditions(text="", noise=v),
    ),
    "blur": Dial(
        label="more defocus than at rest [px]",
        unit="px",
        values=(0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0),
        conditions=lambda v: Conditions(text="", defocus_px=v),
    ),
    "gain": Dial(
        label="light lost in the last frame",
        unit="",
        values=_SHARES,
        conditions=lambda v: Conditions(text="", light=1.0 - v),
    ),
    "shadow": Dial(
        label="light lost in a shadow",
        unit="",
        values=_SHARES,
        conditions=lambda v: Conditions(text="", shadow=v),
    ),
    "missing": Dial(
        label="markers vanished after rest, share",
        unit="",
        values=(0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5),
        conditions=lambda v: Conditions(text="", vanishing=v),
    ),
    "crosstalk": Dial(
        label="green that yellow takes, told 1 %",
        unit="",
        values=(0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5),
        conditions=lambda v: Conditions(text="", crosstalk=v, told_crosstalk=0.01),
    ),
    "jpeg": Dial(
        label="JPEG quality",
        unit="quality",
        values=(95.0, 85.0, 75.0, 60.0, 45.0, 30.0, 15.0, 5.0),
        conditions=lambda v: Conditions(text="", defects=Defects(jpeg_quality=round(v))),
    ),
}
#: Of each dial, in a quick map.
QUICK_VALUES = {"shift": (0.3, 0.6, 1.2), "noise": (2.0, 16.0)}


@dataclass(frozen=True)
class Cell:
    """One tracker at one value of one dial.

    Attributes
    ----------
    tracker, dial, value, frames: what was run
    right_percent: share of the markers that are right in the worst frame: reported within RIGHT of
        their own place, or not reported because they are not there
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


Key = tuple[str, str, float, int]


def stability_track(
    quick: bool,
    out: Path | None,
    force: bool,
    progress: Callable[[str], None],
    trackers: tuple[str, ...] = (),
) -> tuple[dict[str, Any], list[str]]:
    """Run the curves; picture and table go to a folder, where an interrupted map goes on.

    Parameters
    ----------
    quick: a few values of two dials, fewer frames
    out: folder; None writes nothing
    force: write over what is there
    progress: told what is being run
    trackers: names or module:Class; none are all that are there, beside a constant answer

    Returns
    -------
    Report of the rows, and a sentence for each tracker that loses identity.

    Raises
    ------
    UserError
        When there is no such tracker, or the folder is taken.
    """
    names = list(choose(trackers))
    values = QUICK_VALUES if quick else {name: dial.values for name, dial in DIALS.items()}
    count = QUICK_FRAMES if quick else FRAMES
    if out is None:
        found = list(cells(names, values, count, {}, progress))
    else:
        part = out / "map.unfinished.csv"
        prepare(out, force or part.exists())
        done = {_key(cell): cell for cell in read_cells(part, Cell)}
        found = []
        for cell in cells(names, values, count, done, progress):
            found.append(cell)
            if _key(cell) not in done:
                write_cells(found, part)
        _draw(found, out / "map.png", quick)
        write_cells(found, part)
        part.replace(out / "map.csv")
    rows = rows_of(found)
    return report(rows, quick), _sentences(rows)


def cells(
    names: list[str],
    values: dict[str, tuple[float, ...]],
    count: int,
    done: dict[Key, Cell],
    progress: Callable[[str], None],
) -> Iterator[Cell]:
    """Every point of the curves; those in `done` are not run again."""
    with threadpool_limits(1):
        cv2.setNumThreads(1)
        for dial, turned in values.items():
            for value in turned:
                seen: Sequence | None = None
                for name in names:
                    key = (name, dial, value, count)
                    if key in done:
                        yield done[key]
                        continue
                    progress(f"{dial} {value:g}: {name}")
                    if seen is None:
                        seen = sequence(DIALS[dial].conditions(value), count, limits=False)
                    yield _cell(name, dial, value, seen)


def _cell(name: str, dial: str, value: float, seen: Sequence) -> Cell:
    count = len(seen.shots)
    try:
        said = follow(name, seen)
    except UserError as error:
        return Cell(name, dial, value, count, 0.0, np.nan, 0, str(error))
    right, rms, swaps = _judge(said, seen)
    return Cell(name, dial, value, count, right, rms, swaps, "")


def _judge(said: Followed, seen: Sequence) -> tuple[float, float, int]:
    """Share right in the worst frame [%], RMS error [px] and swaps."""
    at, error, reported_ = errors_of(said, all_numbers(said, seen), seen)
    worst = min(
        right_share(error[k], reported_[k], shot.visible, shot.hidden & seen.there)
        for k, shot in enumerate(seen.shots)
    )
    known = error[np.isfinite(error)]
    rms = float(np.sqrt((known**2).mean())) if known.size else np.nan
    swaps = sum(int(swapped(at[k], seen, k).sum()) for k in range(len(at)))
    return 100.0 * worst, rms, swaps


def _key(cell: Cell) -> Key:
    return cell.tracker, cell.dial, cell.value, cell.frames


def rows_of(found: list[Cell]) -> list[Row]:
    """Where each tracker breaks on each dial, and where it takes one marker for another.

    `breaks_at` is the last value up to which it holds, `identity_lost_at` the first with a swap.
    """
    rows = []
    for tracker, dial in dict.fromkeys((cell.tracker, cell.dial) for cell in found):
        mine = [cell for cell in found if (cell.tracker, cell.dial) == (tracker, dial)]
        unit = DIALS[dial].unit
        held = []
        for cell in mine:
            if cell.right_percent < HELD:
                break
            held.append(cell.value)
        name = f"{tracker}/{dial}/breaks_at"
        if not held:
            rows.append(Row(name, None, unit, f"not even at {mine[0].value:g}", True))
        elif len(held) == len(mine):
            rows.append(Row(name, held[-1], unit, "holds to the end", True))
        else:
            rows.append(reported(name, held[-1], unit))
        if dial == "shift":
            lost = [cell.value for cell in mine if cell.swaps]
            name = f"{tracker}/{dial}/identity_lost_at"
            if lost:
                rows.append(reported(name, lost[0], unit))
            else:
                rows.append(Row(name, None, unit, f"never, up to {mine[-1].value:g}", True))
    return rows


def _sentences(rows: list[Row]) -> list[str]:
    """Who takes one marker for another, and from where on."""
    return [
        f"{row.name.split('/')[0]} takes one marker for another from {row.value:g} pitches per "
        "frame on"
        for row in rows
        if row.name.endswith("identity_lost_at") and row.value is not None
    ]


def _draw(found: list[Cell], path: Path, quick: bool) -> None:
    """Curves of all trackers: share of the markers that are right, and error, over each dial."""
    dials = list(dict.fromkeys(cell.dial for cell in found))
    names = list(dict.fromkeys(cell.tracker for cell in found))
    columns = min(4, len(dials))
    blocks = -(-len(dials) // columns)
    figure = Figure(figsize=(3.3 * columns, 4.6 * blocks + 0.9), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2 * blocks, columns, squeeze=False)
    for place, dial in enumerate(dials):
        block, column = divmod(place, columns)
        part = [cell for cell in found if cell.dial == dial]
        pair = (panels[2 * block, column], panels[2 * block + 1, column])
        _curves(pair, part, names)
        if column == 0:
            pair[0].set_ylabel("right, worst frame [%]", fontsize=8)
            pair[1].set_ylabel("RMS error [px]", fontsize=8)
    for place in range(len(dials), blocks * columns):
        block, column = divmod(place, columns)
        panels[2 * block, column].axis("off")
        panels[2 * block + 1, column].axis("off")
    handles = [Line2D([], [], **_style(names, name), label=name) for name in names]
    figure.legend(handles=handles, loc="outside lower center", ncols=2 * columns, fontsize=8)
    title = f"Share of markers within {RIGHT:g} px of their own place; error of those reported"
    figure.suptitle(f"{title} (quick)" if quick else title, fontsize=10)
    figure.savefig(path, dpi=110)


def _curves(panels: tuple[Axes, Axes], part: list[Cell], names: list[str]) -> None:
    values = list(dict.fromkeys(cell.value for cell in part))
    for name in names:
        mine = [cell for cell in part if cell.tracker == name]
        at = [values.index(cell.value) for cell in mine]
        style = _style(names, name)
        panels[0].plot(at, [cell.right_percent for cell in mine], **style)
        panels[1].plot(at, [cell.rms_px for cell in mine], **style)
    panels[0].axhline(HELD, color="0.6", lw=0.8, ls=":")
    panels[0].set_ylim(-4.0, 104.0)
    panels[1].set_yscale("log")
    panels[1].set_xlabel(DIALS[part[0].dial].label, fontsize=8)
    for panel in panels:
        panel.set_xticks(range(len(values)), [f"{value:g}" for value in values])
        panel.tick_params(labelsize=7)


def _style(names: list[str], name: str) -> dict[str, Any]:
    place = names.index(name)
    first = name == DEFAULT_TRACKER
    return {
        "color": _COLOURS[place % len(_COLOURS)],
        "marker": _MARKERS[place % len(_MARKERS)],
        "markersize": 4.0,
        "lw": 2.4 if first else 1.1,
        "zorder": 3 if first else 2,
    }
