"""The map of a sweep: scores over one or two of the keys that are varied."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ...folders import write_whole
from ...output.figure import finish, new_figure, png
from ..score.intervals import share_interval
from .report import means, shown
from .runs import Axis, Plan, SweepCell, words

#: Panels in a row.
_COLUMNS = 3
#: Most letters of all values below a panel that stand side by side.
_MOST_LETTERS = 24
#: Longest value below or beside a panel.
_LONGEST = 20
#: Value, low and high end of its interval.
Figure = tuple[float, float, float]


def draw_sweep(plan: Plan, cells: Sequence[SweepCell], path: Path) -> None:
    """Draw the map: as cells over two keys, as points with intervals over one, or over scenes."""
    axes = [axis for axis in plan.axes if len(axis[1]) > 1][:2] or [("scene", plan.scenes)]
    others = [name for name, values in plan.axes if len(values) > 1][2:]
    notes = [f"mean over {', '.join(others)}"] if others else []
    if len(axes) == 2 and any(one.lost for one in cells):
        every = all(one.lost for one in cells)
        notes.append(f"in brackets: objects were lost in {'all' if every else 'some'} runs")
    footnote = "; ".join(notes)
    panels = {"lost": "share", **shown(cells)}
    rows = math.ceil(len(panels) / _COLUMNS)
    figure = new_figure("", 4.0 * _COLUMNS, 3.2 * rows, footnote)
    places = list(figure.subplots(rows, _COLUMNS, squeeze=False).flat)
    for place in places[len(panels) :]:
        place.set_visible(False)
    for place, (name, unit) in zip(places, panels.items(), strict=False):
        label = f"{name} [{unit}]"
        if len(axes) == 2:
            _field(place, axes[0], axes[1], name, label, _chosen(plan, cells))
        else:
            _points(place, axes[0], name, label, _chosen(plan, cells))
    write_whole(path, png(figure))


def _chosen(plan: Plan, cells: Sequence[SweepCell]) -> Callable[[dict[str, Any]], list[SweepCell]]:
    """Function that gives the cells at some values."""
    settings = {words(setting): setting for setting in plan.settings()}

    def at(wanted: dict[str, Any]) -> list[SweepCell]:
        chosen = []
        for one in cells:
            values = {"scene": one.scene} | settings[one.setting]
            if all(values[key] == value for key, value in wanted.items()):
                chosen.append(one)
        return chosen

    return at


def _value(name: str, cells: Sequence[SweepCell]) -> Figure:
    if name != "lost":
        return means(cells)[name]
    if not cells:
        return math.nan, math.nan, math.nan
    lost = sum(one.lost for one in cells)
    return lost / len(cells), *share_interval(lost, len(cells))


def _field(
    place: Axes,
    x: Axis,
    y: Axis,
    name: str,
    label: str,
    at: Callable[[dict[str, Any]], list[SweepCell]],
) -> None:
    cells = [[at({x[0]: a, y[0]: b}) for a in x[1]] for b in y[1]]
    values = np.array([[_value(name, some)[0] for some in row] for row in cells], dtype=float)
    lost = np.array([[any(one.lost for one in some) for some in row] for row in cells])
    most = 1.0 if name == "lost" else None
    # A score where an object was lost is no good one, however small: its cell has no colour.
    shown_values = values if name == "lost" else np.where(lost, np.nan, values)
    place.imshow(
        shown_values, origin="lower", aspect="auto", cmap="YlOrBr", alpha=0.5, vmin=0.0, vmax=most
    )
    for (row, column), value in np.ndenumerate(values):
        text = "–" if math.isnan(value) else f"{value:.3g}"
        if lost[row, column] and name != "lost":
            text = f"({text})"
        place.text(column, row, text, ha="center", va="center", fontsize=8, color="0.2")
    _name_ticks(place, x)
    place.set_yticks(range(len(y[1])), [_short(b) for b in y[1]])
    finish(place, y[0], x[0], legend=False, title=label)
    place.grid(visible=False)


def _short(value: Any) -> str:
    """Value as text; of a long one, such as the path of a file, the end."""
    text = str(value)
    return text if len(text) <= _LONGEST else f"…{text[1 - _LONGEST :]}"


def _name_ticks(place: Axes, x: Axis) -> None:
    """Write the values below a panel, turned where they would touch."""
    names = [_short(value) for value in x[1]]
    place.set_xticks(range(len(names)), names)
    if sum(map(len, names)) > _MOST_LETTERS:
        for label in place.get_xticklabels():
            label.set(rotation=30, ha="right")


def _points(
    place: Axes, x: Axis, name: str, label: str, at: Callable[[dict[str, Any]], list[SweepCell]]
) -> None:
    found = np.array([_value(name, at({x[0]: value})) for value in x[1]])
    low, high = found[:, 0] - found[:, 1], found[:, 2] - found[:, 0]
    errors = np.nan_to_num(np.maximum([low, high], 0.0))
    place.errorbar(range(len(x[1])), found[:, 0], yerr=errors, fmt="o-", capsize=3, lw=1.0)
    _name_ticks(place, x)
    finish(place, label, x[0], legend=False)
