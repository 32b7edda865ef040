"""Pictures of the maps of a dome and of two fingers."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from ....output.figure import legend_below, png
from ..cells import SWING
from ..fields import draw_field, draw_lines, new_map, patches, write_cell
from .cells import LETTERS, OUTCOMES, WORDS, Cell, Setting
from .maps import STYLES, Map, Panel

#: Height of a cell, and of what surrounds a panel [inches].
_CELL, _AROUND = 0.36, 1.0
#: Height of the legend [inches].
_LEGEND = 1.3


def draw_map(which: Map, results: Mapping[Setting, Cell], path: Path, quick: bool) -> None:
    """Write a map: outcomes as colours and letters, boundaries by analysis over them."""
    figure, places = new_map(which, quick, _CELL, _AROUND, _LEGEND)
    labels: dict[str, None] = {}
    for axes, panel in zip(places, which.panels, strict=True):
        draw_field(axes, which, panel, results, OUTCOMES)
        _letter(axes, which, panel, results)
        labels |= dict.fromkeys(draw_lines(axes, which, panel, STYLES))
    present = [results[one] for one in which.settings()]
    outcomes = (cell.outcome for cell in present)
    handles = patches(outcomes, OUTCOMES, LETTERS, WORDS)
    handles += [Line2D([], [], color="black", lw=2, ls=STYLES[x], label=x) for x in labels]
    if any(cell.swing > SWING and cell.outcome != "swings" for cell in present):
        handles.append(Line2D([], [], ls="", label="~ behind a letter: it swings as well"))
    if which.number:
        handles.append(Line2D([], [], ls="", label=f"numbers: {which.number[1]}"))
    legend_below(figure, handles, 2)
    path.write_bytes(png(figure))


def _letter(axes: Axes, which: Map, panel: Panel, results: Mapping[Setting, Cell]) -> None:
    """Write what each cell of a panel came to, so that it is not told by colour alone."""
    grid = [[results[which.at(panel, x, y)] for x in panel.x] for y in panel.y]
    for (row, column), cell in np.ndenumerate(np.array(grid, dtype=object)):
        write_cell(axes, _text(which, cell), (column, row))


def _text(which: Map, cell: Cell) -> str:
    """Letter of a cell's outcome, and its number, which is nothing of an object that is gone."""
    letters = LETTERS[cell.outcome]
    if cell.swing > SWING and cell.outcome != "swings":
        letters += "~"
    gone = cell.outcome == "dropped"
    value = getattr(cell, which.number[0]) if which.number and not gone else np.nan
    return letters if np.isnan(value) else f"{letters} {value:.0f}".strip()
