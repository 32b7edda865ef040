"""Drawing of maps: outcomes as colours, with their legend, in panels of equal cells."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from ...output.figure import WIDTH, new_figure
from .panels import Map, Panel

Array = NDArray[np.float64]
#: Size of the letters of cells, and of what is beside them [points].
SMALL = 7.5
#: Letters in a cell.
_LETTERS: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": SMALL, "zorder": 5}
#: Ground of a cell's text, so that a line behind it does not hide it.
_BEHIND: dict[str, Any] = {"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.7}


def title_of(text: str, quick: bool) -> str:
    """Title of a picture, which says where the run was a quick one."""
    return f"{text} (quick)" if quick else text


def mesh(
    axes: Axes, x: Array, y: Array, outcomes: Sequence[Sequence[str]], colours: Mapping[str, str]
) -> None:
    """Fill the cells between the edges x and y with the colours of their outcomes."""
    codes = [[list(colours).index(name) for name in row] for row in outcomes]
    colour_map = ListedColormap(list(colours.values()))
    last = len(colours) - 1
    axes.pcolormesh(x, y, codes, cmap=colour_map, vmin=0, vmax=last, edgecolors="white", lw=0.8)


def patches(
    outcomes: Iterable[str],
    colours: Mapping[str, str],
    letters: Mapping[str, str],
    words: Mapping[str, str],
) -> list[Patch | Line2D]:
    """Legend of the outcomes that occur: colour, letter, name and, where it has them, words."""
    present = set(outcomes)
    handles: list[Patch | Line2D] = []
    for name in (name for name in colours if name in present):
        letter = f"{letters[name]}  " if letters[name] else ""
        told = f": {words[name]}" if name in words else ""
        handles.append(Patch(color=colours[name], label=f"{letter}{name}{told}"))
    return handles


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
    colours: Mapping[str, str],
) -> None:
    """Draw equal cells.

    Parameters
    ----------
    cells: outcome and text by the keys of column and row
    x, y: labels of columns and rows by their keys
    colours: by outcome
    """
    outcomes = [[cells[column, row][0] for column in x] for row in y]
    mesh(axes, np.arange(len(x) + 1.0) - 0.5, np.arange(len(y) + 1.0) - 0.5, outcomes, colours)
    columns, rows = list(x), list(y)
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
    colours: Mapping[str, str],
) -> None:
    """Draw a panel: its axes, and the colours of the outcomes of its cells."""
    outcomes = [[results[which.at(panel, x, y)].outcome for x in panel.x] for y in panel.y]
    x_edges, y_edges = np.arange(len(panel.x) + 1.0) - 0.5, np.arange(len(panel.y) + 1.0) - 0.5
    mesh(axes, x_edges, y_edges, outcomes, colours)
    axes.set_xticks(range(len(panel.x)), [_text(x) for x in panel.x])
    axes.set_yticks(range(len(panel.y)), [_text(y) for y in panel.y])
    axes.tick_params(labelsize=SMALL, length=0)
    # No line goes beyond the cells.
    axes.set(xlim=(x_edges[0], x_edges[-1]), ylim=(y_edges[0], y_edges[-1]))
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


def _text(value: float | int | str) -> str:
    if value == np.inf:
        return "flat"
    return value if isinstance(value, str) else f"{value:g}"
