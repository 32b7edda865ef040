"""Pictures of the maps of the closed loop: outcomes as colours, predicted boundaries over them."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from ...output.figure import legend_below, png
from . import cells
from .fields import draw_field, draw_lines, new_map, patches, remark, write_cell
from .grips import cells as grip_cells
from .grips import maps as grip_maps
from .maps import CRUSHING, LINEAR
from .panels import Map, Outcomes, Panel

#: Line styles of the predicted boundaries.
_STYLES = {LINEAR: "-", CRUSHING: ":"} | grip_maps.STYLES


@dataclass(frozen=True, kw_only=True)
class Look:
    """Look of the closed loop's maps in one world.

    Attributes
    ----------
    outcomes: of a run
    cell, around, legend: height of a cell, of what surrounds a panel, and of the legend [inches]
    turned: turn of the values below a panel [°]
    framed: meaning of the frame around the base of a panel; empty draws none
    """

    outcomes: Outcomes
    cell: float
    around: float
    legend: float
    turned: float = 0.0
    framed: str = ""


#: Maps of the chain, and those of a dome or of two fingers.
CHAIN = Look(
    outcomes=cells.OUTCOMES,
    cell=0.42,
    around=0.9,
    legend=1.5,
    turned=90.0,
    framed="the place of these gains",
)
GRIPS = Look(outcomes=grip_cells.OUTCOMES, cell=0.36, around=1.0, legend=1.3)


def draw_map(
    which: Map[Any], look: Look, results: Mapping[Any, Any], folder: Path, name: str, quick: bool
) -> None:
    """Write a map of the closed loop as NAME.svg and NAME.png."""
    figure, places = new_map(which, quick, look.cell, look.around, look.legend)
    labels: dict[str, None] = {}
    for axes, panel in zip(places, which.panels, strict=True):
        draw_field(axes, which, panel, results, look.outcomes)
        _mark(axes, which, look, panel, results)
        labels |= dict.fromkeys(draw_lines(axes, which, panel, _STYLES))
    legend_below(figure, _handles_of_loop(which, look, results, labels), 2)
    figure.savefig(folder / f"{name}.svg", metadata={"Date": None})
    (folder / f"{name}.png").write_bytes(png(figure))


def _mark(
    axes: Axes, which: Map[Any], look: Look, panel: Panel[Any], results: Mapping[Any, Any]
) -> None:
    """Write the outcome into each cell of a panel, and mark the base and runs with a camera."""
    axes.tick_params(axis="x", labelrotation=look.turned)
    grid = [[results[which.at(panel, x, y)] for x in panel.x] for y in panel.y]
    for (row, column), cell in np.ndenumerate(np.array(grid, dtype=object)):
        camera = cell.setting.through_camera() if which.camera else None
        seen = camera in which.camera
        write_cell(axes, _text(which, look, cell), (column, row + 0.22 if seen else row))
        if look.framed and which.lines and cell.setting == panel.base:
            frame = Rectangle((column - 0.42, row - 0.44), 0.84, 0.88, fill=False, lw=1.2)
            axes.add_patch(frame)
        if seen:
            outcome = look.outcomes[results[camera].outcome]
            ring = {"boxstyle": "circle,pad=0.15", "fc": outcome.colour, "ec": "black"}
            write_cell(axes, outcome.letter or " ", (column, row - 0.22), ring)


def _text(which: Map[Any], look: Look, cell: Any) -> str:
    """Text in a cell: outcome letter, marks of an observed and a predicted swing, and value.

    There is no value if the object was lost.
    """
    unstable = " ×" if which.lines is None and cell.root >= 1.0 else ""
    text = f"{look.outcomes[cell.outcome].letter}{_swings_too(look, cell)}{unstable}"
    number = np.nan
    if which.number and cell.outcome != "dropped":
        number = getattr(cell, which.number[0])
    return (text if np.isnan(number) else f"{text} {number:.{0 if number >= 9.95 else 1}f}").strip()


def _swings_too(look: Look, cell: Any) -> str:
    """Mark of a swing beside a worse outcome."""
    return "~" if cell.swing > cells.SWING and look.outcomes[cell.outcome].letter != "~" else ""


def _handles_of_loop(
    which: Map[Any], look: Look, results: Mapping[Any, Any], lines: Iterable[str]
) -> list[Patch | Line2D]:
    settings = which.settings()
    drawn = [results[setting] for setting in settings]
    handles = patches(drawn, look.outcomes)
    if which.lines is None:
        handles.append(remark(f"×  unstable, {LINEAR}"))
    handles += [Line2D([], [], color="black", lw=2, ls=_STYLES[x], label=x) for x in lines]
    if any(_swings_too(look, cell) for cell in drawn):
        handles.append(remark("~ behind a letter: it swings as well"))
    mark: dict[str, Any] = {"ls": "", "mfc": "none", "mec": "black"}
    if look.framed and which.lines and any(panel.base in settings for panel in which.panels):
        handles.append(Line2D([], [], marker="s", ms=8, label=f"frame: {look.framed}", **mark))
    if which.camera:
        label = "ring: the same through the camera"
        handles.append(Line2D([], [], marker="o", label=label, **mark))
    if which.number:
        handles.append(remark(f"numbers: {which.number[1]}"))
    return handles
