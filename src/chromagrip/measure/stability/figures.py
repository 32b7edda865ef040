"""Pictures of the stability maps: outcomes as colours, predicted boundaries over them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from ...output.figure import WIDTH, legend_below, new_figure, plain_ticks, png
from ...tracking import DEFAULT_TRACKER
from ..worlds.track_scores import RIGHT
from . import cells, dome, force, model, track
from .fields import (
    SMALL,
    draw_cells,
    draw_field,
    draw_lines,
    new_map,
    patches,
    remark,
    title_of,
    write_cell,
)
from .grips import cells as grip_cells
from .grips import maps as grip_maps
from .maps import CRUSHING, LINEAR
from .panels import Map, Outcomes, Panel

#: Line styles of the predicted boundaries.
_STYLES = {LINEAR: "-", CRUSHING: ":"} | grip_maps.STYLES
#: Colours of the trackers' curves, used in turns.
_COLOURS = (
    *("#777777", "#d55e00", "#0072b2", "#009e73", "#e69f00"),
    *("#6d1a86", "#222222", "#8c5a2b", "#cc79a7", "#56b4e9"),
)
#: Markers of the trackers' curves, used in turns.
_MARKERS = "xo^svDP*<>"
#: Line styles of the trackers' curves, used in turns.
_DASHES = ["-", "-", "--", "-.", ":", "--", "-", "-.", ":", "--"]


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
    return (text if np.isnan(number) else f"{text} {number:.0f}").strip()


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


def draw_model(results: Sequence[model.Cell], path: Path, quick: bool) -> None:
    """Write the map of the integrators: panels of methods for each node count.

    Steps go across, of explicit methods over the predicted limit; stiffness goes up. Methods that
    choose their steps share a panel.
    """
    methods = dict.fromkeys(cell.method for cell in results)
    adaptive = [name for name in methods if name in model.ADAPTIVE]
    groups = [[name] for name in methods if name not in adaptive]
    groups += [adaptive] if adaptive else []
    counts = sorted({cell.nodes for cell in results})
    high = 0.24 * len({cell.stiffness_n_per_m for cell in results}) + 0.75
    title = title_of("Press to 1 N, pull with 0.25 N, hold: outcome of each method", quick)
    figure = new_figure(title, WIDTH, 2 * high * len(counts) + 1.6)
    # Two panels in a row, then three.
    places = figure.add_gridspec(2 * len(counts), 6)
    for row, nodes in enumerate(counts):
        for k, group in enumerate(groups):
            lower, width = int(k >= 2), 3 if k < 2 else 2
            start = k * 3 if k < 2 else (k - 2) * 2
            axes = figure.add_subplot(places[2 * row + lower, start : start + width])
            part = [cell for cell in results if cell.method in group and cell.nodes == nodes]
            _panel_of_model(axes, part)
            axes.set_title(f"{', '.join(group)}, {nodes} nodes", fontsize=9)
            if start == 0:
                axes.set_ylabel("stiffness [N/m]", fontsize=8)
    handles = patches(results, model.OUTCOMES)
    label = "largest stable step of an explicit method by linear theory"
    handles.append(Line2D([], [], color="black", ls="--", label=label))
    legend_below(figure, handles, 2)
    path.write_bytes(png(figure))


def _panel_of_model(axes: Axes, part: Sequence[model.Cell]) -> None:
    """Cells of one method by step, or of adaptive methods by their name."""
    method = part[0].method

    def column(cell: model.Cell) -> float | str:
        if cell.method in model.ADAPTIVE:
            return cell.method
        return round(cell.step_s / (cell.limit_s if method in model.EXPLICIT else 1e-3), 6)

    x = {at: f"{at:g}" if isinstance(at, float) else at for at in map(column, part)}
    y = {level: f"{level:g}" for level in sorted({cell.stiffness_n_per_m for cell in part})}
    shown = {
        (column(cell), cell.stiffness_n_per_m): (cell.outcome, model.OUTCOMES[cell.outcome].letter)
        for cell in part
    }
    draw_cells(axes, shown, x, y, model.OUTCOMES)
    label = "step [ms]"
    if method in model.EXPLICIT:
        label = "step over the largest stable one"
        axes.axvline(sum(float(at) < 1.0 for at in x) - 0.5, color="black", ls="--", lw=1.5)
    elif method in model.ADAPTIVE:
        label = "steps of their own choice"
    axes.set_xlabel(label, fontsize=8)


def draw_dome(results: Sequence[dome.Cell], path: Path, quick: bool) -> None:
    """Write the map of the dome: a panel for each Dahl exponent and shape.

    Travel in a step goes across, stiffness of the object up. A cell whose steps were halved says
    how often, in percent of the steps.
    """
    shapes = list(dict.fromkeys(cell.shape for cell in results))
    exponents = list(dict.fromkeys(cell.exponent for cell in results))
    title = title_of("Dome: press 0.4 mm, shift 0.8 mm; outcome by the travel in a step", quick)
    figure = new_figure(title, WIDTH, 2.5 * len(exponents) + 1.2)
    panels = figure.subplots(len(exponents), len(shapes), squeeze=False)
    for (row, column), axes in np.ndenumerate(panels):
        shape, exponent = shapes[column], exponents[row]
        part = [cell for cell in results if (cell.shape, cell.exponent) == (shape, exponent)]
        x = {cell.travel_m: f"{1e6 * cell.travel_m:g}" for cell in part}
        levels = sorted({cell.stiffness_n_per_m3 for cell in part})
        y = {level: f"$10^{{{np.log10(level):.0f}}}$" for level in levels}
        shown = {(c.travel_m, c.stiffness_n_per_m3): (c.outcome, _text_of_dome(c)) for c in part}
        draw_cells(axes, shown, x, y, dome.OUTCOMES)
        axes.set_title(f"{shape}, Dahl exponent {exponent:g}", fontsize=9)
        if column == 0:
            axes.set_ylabel("object stiffness [N/m³]", fontsize=8)
        if row == len(exponents) - 1:
            axes.set_xlabel("travel in a step [µm]", fontsize=8)
    handles = [*patches(results, dome.OUTCOMES), remark("numbers: steps that were halved [%]")]
    legend_below(figure, handles, 2)
    path.write_bytes(png(figure))


def _text_of_dome(cell: dome.Cell) -> str:
    number = f"{100.0 * cell.halved:.0f}" if cell.halved >= 0.005 else "<1"
    return f"{dome.OUTCOMES[cell.outcome].letter} {number if cell.halved > 0.0 else ''}".strip()


def draw_force(results: Sequence[force.Cell], path: Path, quick: bool) -> None:
    """Write the map of the reconstructors: a panel for each dial, a line for each of them.

    A cell has the largest error of ΣFn of the frames that are read, in percent.
    """
    dials = list(dict.fromkeys(cell.dial for cell in results))
    readers = list(dict.fromkeys((cell.method, cell.design) for cell in results))
    columns = min(2, len(dials))
    rows = -(-len(dials) // columns)
    title = title_of("Domes, pressed and pulled to Γ ≈ .1: what each reconstructor reads", quick)
    figure = new_figure(title, WIDTH, rows * (0.24 * len(readers) + 0.65) + 1.4)
    panels = figure.subplots(rows, columns, squeeze=False)
    y = {reader: ", ".join(reader) for reader in readers}
    for axes, dial in zip(panels.flat, dials, strict=False):
        part = [cell for cell in results if cell.dial == dial]
        x = {cell.value: cell.value for cell in part}
        shown = {(c.value, (c.method, c.design)): (c.outcome, _text_of_force(c)) for c in part}
        draw_cells(axes, shown, x, y, force.OUTCOMES)
        axes.invert_yaxis()
        axes.set_xlabel(force.DIALS[dial].label, fontsize=8)
    for axes in panels.flat[len(dials) :]:
        axes.axis("off")
    for axes in panels[:, 1:].flat:
        axes.set_yticklabels([])
    numbers = remark("numbers: largest error of ΣFn in a frame that is read [%]")
    legend_below(figure, [*patches(results, force.OUTCOMES), numbers], 2)
    path.write_bytes(png(figure))


def _text_of_force(cell: force.Cell) -> str:
    error = cell.normal_percent
    number = "" if np.isnan(error) else f"{error:.0f}" if error >= 0.95 else "<1"
    return f"{force.OUTCOMES[cell.outcome].letter} {number}".strip()


def draw_track(results: Sequence[track.Cell], path: Path, quick: bool) -> None:
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


def _curves(right: Axes, error: Axes, part: Sequence[track.Cell]) -> None:
    values = list(dict.fromkeys(cell.value for cell in part))
    for axes in (right, error):
        axes.set_prop_cycle(color=_COLOURS, marker=list(_MARKERS), linestyle=_DASHES)
        axes.set_xticks(range(len(values)), [f"{value:g}" for value in values])
        axes.tick_params(labelsize=SMALL)
        axes.set_xlabel(track.DIALS[part[0].dial].label, fontsize=8)
    for name in dict.fromkeys(cell.tracker for cell in part):
        curve = [cell for cell in part if cell.tracker == name]
        x = [values.index(cell.value) for cell in curve]
        width, order = (2.6, 1.5) if name == DEFAULT_TRACKER else (1.1, 2.0)
        shares, errors = [c.right_percent for c in curve], [c.rms_px for c in curve]
        right.plot(x, shares, ms=4.5, mfc="none", lw=width, zorder=order, label=name)
        error.plot(x, errors, ms=4.5, mfc="none", lw=width, zorder=order)
    text = f"{track.HELD:g} %: identity is held above"
    right.axhline(track.HELD, color="0.3", lw=0.9, ls=(0, (1, 3)), marker="", label=text)
    right.set_ylim(-6.0, 106.0)
    error.set_yscale("log")
    plain_ticks(error.yaxis)
