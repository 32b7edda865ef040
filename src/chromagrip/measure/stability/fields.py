"""Drawing of maps: outcomes as colours, with their legend, in panels of equal cells."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ...output.figure import WIDTH, new_figure
from .panels import Map, Outcomes, Panel, text_of

#: Size of the letters of cells, and of what is beside them [points].
SMALL = 7.5
#: Letters in a cell.
_LETTERS: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": SMALL, "zorder": 5}
#: Ground of a cell's text, so that a line behind it does not hide it.
_BEHIND: dict[str, Any] = {"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.7}


def title_of(text: str, quick: bool) -> str:
    """Title of a picture, which says where the run was a quick one."""
    return f"{text} (quick)" if quick else text


def patches(cells: Iterable[Any], outcomes: Outcomes) -> list[Patch | Line2D]:
    """Legend of the outcomes that occur: colour, letter, name and, where it has them, words."""
    present = {cell.outcome for cell in cells}
    handles: list[Patch | Line2D] = []
    for name, (colour, letter, words) in outcomes.items():
        if name in present:
            label = f"{letter}  {name}" if letter else name
            handles.append(Patch(color=colour, label=f"{label}: {words}" if words else label))
    return handles


def remark(label: str) -> Line2D:
    """Line of a legend without a mark."""
    return Line2D([], [], ls="", label=label)


def write_cell(
    axes: Axes, text: str, place: tuple[float, float], box: dict[str, Any] | None = None
) -> None:
    """Write into a cell, above the lines that cross it, in a box or on a light ground."""
    if text:
        axes.annotate(text, place, bbox=box or _BEHIND, **_LETTERS)


def draw_cells(
    axes: Axes,
    cells: Mapping[tuple[Any, Any], tuple[str, str]],
    x: Mapping[Any, str],
    y: Mapping[Any, str],
    outcomes: Outcomes,
) -> None:
    """Draw equal cells.

    Parameters
    ----------
    cells: outcome and text by the keys of column and row
    x, y: labels of columns and rows by their keys
    outcomes: that there are
    """
    names, columns, rows = list(outcomes), list(x), list(y)
    codes = [[names.index(cells[column, row][0]) for column in columns] for row in rows]
    colours = ListedColormap([outcome.colour for outcome in outcomes.values()])
    edges = [np.arange(len(values) + 1.0) - 0.5 for values in (x, y)]
    look: dict[str, Any] = {"vmax": len(names) - 1, "edgecolors": "white", "lw": 0.8}
    axes.pcolormesh(*edges, codes, cmap=colours, vmin=0, **look)
    for (column, row), (_, text) in cells.items():
        write_cell(axes, text, (columns.index(column), rows.index(row)))
    axes.set_xticks(range(len(x)), list(x.values()))
    axes.set_yticks(range(len(y)), list(y.values()))
    axes.tick_params(labelsize=SMALL, length=0)


def new_map(
    which: Map[Any], quick: bool, cell: float, around: float, legend: float
) -> tuple[Figure, list[Axes]]:
    """Empty picture of a map, with axes for each panel.

    Parameters
    ----------
    cell, around, legend: height of a cell, of what surrounds a panel, and of the legend [inches]
    """
    rows = -(-len(which.panels) // which.columns)
    height = rows * (len(which.panels[0].y) * cell + around) + legend
    figure = new_figure(title_of(which.title, quick), WIDTH, height)
    places = list(figure.subplots(rows, which.columns, squeeze=False).flat)
    for axes in places[len(which.panels) :]:
        axes.axis("off")
    return figure, places[: len(which.panels)]


def draw_field(
    axes: Axes,
    which: Map[Any],
    panel: Panel[Any],
    results: Mapping[Any, Any],
    outcomes: Outcomes,
) -> None:
    """Draw a panel: its axes, and the colours of the outcomes of its cells."""
    cells = {(x, y): (results[which.at(panel, x, y)].outcome, "") for y in panel.y for x in panel.x}
    x, y = ({value: text_of(value) for value in values} for values in (panel.x, panel.y))
    draw_cells(axes, cells, x, y, outcomes)
    # No line goes beyond the cells.
    axes.set(xlim=(-0.5, len(panel.x) - 0.5), ylim=(-0.5, len(panel.y) - 0.5))
    axes.set_title(panel.title, fontsize=9)
    axes.set_xlabel(which.x_label, fontsize=8)
    axes.set_ylabel(which.y_label, fontsize=8)


def draw_lines(
    axes: Axes, which: Map[Any], panel: Panel[Any], styles: Mapping[str, str]
) -> list[str]:
    """Draw the boundaries of a panel by analysis; their labels."""
    lines = which.lines(panel) if which.lines else []
    for line in lines:
        axes.plot(line.x, line.y, styles[line.label], color="black", lw=2.0)
    return [line.label for line in lines]
