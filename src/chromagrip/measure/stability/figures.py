"""Pictures of the stability maps: outcomes as colours, predicted boundaries over them."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from ...output.figure import legend_below, new_figure, png
from ...tracking import DEFAULT_TRACKER
from ..worlds.track_scores import RIGHT
from . import cells, dome, force, model, track
from .cells import Setting
from .fields import draw_field, draw_lines, mesh, new_map, patches, title_of
from .maps import CRUSHING, LINEAR, Map, Panel

Array = NDArray[np.float64]

#: Line styles of the predicted boundaries.
_STYLES = {LINEAR: "-", CRUSHING: ":"}
#: Width and height of a cell of the loop's maps [inches].
_CELL = (0.27, 0.33)
#: Width and height of what surrounds a panel [inches].
_AROUND = (1.0, 0.9)
#: Height of the legend [inches].
_LEGEND = 1.5
#: Colours of the trackers' curves, used in turns.
_COLOURS = (
    *("#9e9e9e", "#d62828", "#1d70b8", "#2a9d8f", "#f4a261"),
    *("#6d1a86", "#222222", "#b08968", "#e377c2", "#8ac926"),
)
#: Markers of the trackers' curves, used in turns.
_MARKERS = "xo^svDP*<>"


def draw_map(
    which: Map, results: Mapping[Setting, cells.Cell], folder: Path, name: str, quick: bool
) -> None:
    """Write a map of the closed loop as NAME.svg and NAME.png."""
    figure, places = new_map(which, quick, _CELL, _AROUND, _LEGEND)
    labels: dict[str, None] = {}
    for axes, panel in zip(places, which.panels, strict=True):
        draw_field(axes, which, panel, results, cells.OUTCOMES)
        _mark(axes, which, panel, results)
        labels |= dict.fromkeys(draw_lines(axes, which, panel, _STYLES))
    legend_below(figure, _handles_of_loop(which, results, labels), 2)
    figure.savefig(folder / f"{name}.svg", metadata={"Date": None})
    (folder / f"{name}.png").write_bytes(png(figure))


def _mark(axes: Axes, which: Map, panel: Panel, results: Mapping[Setting, cells.Cell]) -> None:
    """Mark cells of a panel that are more than their outcome."""
    axes.tick_params(axis="x", labelrotation=90)
    grid = [[results[which.at(panel, x, y)] for x in panel.x] for y in panel.y]
    for (row, column), cell in np.ndenumerate(np.array(grid, dtype=object)):
        if which.lines and cell.setting == panel.base:
            axes.plot(column, row, "s", ms=15, mfc="none", mec="black", mew=1.2)
        if cell.swings and cell.outcome != "limit cycle":
            axes.plot(column, row, ".", color="white", ms=3)
        if which.lines is None and cell.root >= 1.0:
            colour = "white" if cell.outcome == "crush" else "black"
            axes.plot(column, row, "x", color=colour, ms=7, mew=1.4)
        camera = cell.setting.through_camera()
        if camera in which.camera:
            colour = cells.OUTCOMES[results[camera].outcome]
            axes.plot(column, row, "o", ms=9, mec="black", mew=1.2, color=colour)


def _handles_of_loop(
    which: Map, results: Mapping[Setting, cells.Cell], lines: Iterable[str]
) -> list[Patch | Line2D]:
    settings = which.settings()
    drawn = [results[setting] for setting in settings]
    handles = patches((cell.outcome for cell in drawn), cells.OUTCOMES)
    for patch in handles:
        patch.set_label(f"{patch.get_label()}: {cells.WORDS[str(patch.get_label())]}")
    marks: list[tuple[bool, str, dict[str, object]]] = [
        (which.lines is None, f"unstable, {LINEAR}", {"color": "black", "marker": "x"}),
        *((True, label, {"color": "black", "ls": _STYLES[label], "lw": 2}) for label in lines),
        (
            any(cell.swings and cell.outcome != "limit cycle" for cell in drawn),
            "white dot: it swings as well",
            {"color": "0.6", "marker": "."},  # white would not show on the page
        ),
        (
            which.lines is not None and any(panel.base in settings for panel in which.panels),
            "frame: the place of these gains",
            {"marker": "s", "mfc": "none", "mec": "black", "ms": 8},
        ),
        (
            bool(which.camera),
            "ring: the same through the camera",
            {"marker": "o", "mfc": "none", "mec": "black"},
        ),
    ]
    return handles + [
        Line2D([], [], label=label, **({"ls": ""} | style))  # type: ignore[arg-type]
        for present, label, style in marks
        if present
    ]


def draw_model(results: Sequence[model.Cell], path: Path, quick: bool) -> None:
    """Write the map of the integrators: a panel for each method and node count.

    Step size goes across, stiffness up.
    """
    methods = list(dict.fromkeys(cell.method for cell in results))
    counts = sorted({cell.nodes for cell in results})
    title = title_of("Press to 1 N, pull with 0.25 N, hold: outcome of each method", quick)
    figure = new_figure(title, 3.1 * len(methods), 2.3 * len(counts) + 1.3)
    panels = figure.subplots(len(counts), len(methods), squeeze=False)
    for (row, column), axes in np.ndenumerate(panels):
        nodes, method = counts[row], methods[column]
        _panel_of_model(axes, [c for c in results if c.method == method and c.nodes == nodes])
        axes.set_title(f"{method}, {nodes} nodes", fontsize=9)
        if column == 0:
            axes.set_ylabel("contact stiffness [N/m]", fontsize=8)
        if row == len(counts) - 1:
            axes.set_xlabel("step", fontsize=8)
    handles = patches((cell.outcome for cell in results), model.OUTCOMES)
    handles.append(Line2D([], [], color="black", ls="--", lw=1, label="predicted explicit limit"))
    legend_below(figure, handles, len(handles))
    path.write_bytes(png(figure))


def _panel_of_model(axes: Axes, part: Sequence[model.Cell]) -> None:
    """Cells between half-way steps, on logarithmic axes."""
    stiffness = sorted({cell.stiffness_n_per_m for cell in part})
    y = _edges(np.array(stiffness)) if len(stiffness) > 1 else np.array([0.5, 2.0])
    for level, bottom, top in zip(stiffness, y, y[1:], strict=False):
        line = [cell for cell in part if cell.stiffness_n_per_m == level]
        line.sort(key=lambda cell: cell.step_s)
        steps = 1e3 * np.array([cell.step_s for cell in line])
        x = _edges(steps) if len(steps) > 1 else np.array([steps[0] / 1.5, steps[0] * 1.5])
        outcomes = [[cell.outcome for cell in line]]
        mesh(axes, x, np.array([bottom, top]), outcomes, model.OUTCOMES)
        axes.plot(np.full(2, 1e3 * line[0].limit_s), [bottom, top], "k--", lw=1)
    axes.set(xscale="log", yscale="log", xlim=(5e-4, 100.0), ylim=(y[0], y[-1]))
    axes.set_xticks([1e-3, 1e-2, 1e-1, 1.0, 10.0], ["1 µs", "10 µs", "0.1 ms", "1 ms", "10 ms"])
    axes.minorticks_off()
    axes.tick_params(labelsize=7)


def draw_dome(results: Sequence[dome.Cell], path: Path, quick: bool) -> None:
    """Write the map of the dome: a panel for each shape and Dahl exponent.

    Travel in a step goes across, stiffness of the object up. A cell whose steps were halved says
    how often, in percent of the steps.
    """
    shapes = list(dict.fromkeys(cell.shape for cell in results))
    exponents = list(dict.fromkeys(cell.exponent for cell in results))
    title = title_of("Dome: press 0.4 mm, shift 0.8 mm; outcome by the travel in a step", quick)
    figure = new_figure(title, 3.4 * len(exponents) + 1.0, 2.7 * len(shapes) + 1.2)
    panels = figure.subplots(len(shapes), len(exponents), squeeze=False)
    for (row, column), axes in np.ndenumerate(panels):
        shape, exponent = shapes[row], exponents[column]
        part = [cell for cell in results if (cell.shape, cell.exponent) == (shape, exponent)]
        _panel_of_dome(axes, part)
        axes.set_title(f"{shape}, Dahl exponent {exponent:g}", fontsize=9)
        if column == 0:
            axes.set_ylabel("object stiffness [N/m³]", fontsize=8)
        if row == len(shapes) - 1:
            axes.set_xlabel("travel in a step [µm]", fontsize=8)
    handles = patches((cell.outcome for cell in results), dome.OUTCOMES)
    handles.append(Line2D([], [], ls="", label="numbers: halved steps [%]"))
    legend_below(figure, handles, len(handles))
    path.write_bytes(png(figure))


def _panel_of_dome(axes: Axes, part: Sequence[dome.Cell]) -> None:
    travel = sorted({cell.travel_m for cell in part})
    stiffness = sorted({cell.stiffness_n_per_m3 for cell in part})
    at = {(cell.stiffness_n_per_m3, cell.travel_m): cell for cell in part}
    outcomes = [[at[level, step].outcome for step in travel] for level in stiffness]
    x, y = np.arange(len(travel) + 1.0) - 0.5, np.arange(len(stiffness) + 1.0) - 0.5
    mesh(axes, x, y, outcomes, dome.OUTCOMES)
    for cell in part:
        if cell.halved > 0.0:
            place = travel.index(cell.travel_m), stiffness.index(cell.stiffness_n_per_m3)
            text = f"{100.0 * cell.halved:.0f}" if cell.halved >= 0.005 else "<1"
            axes.annotate(text, place, ha="center", va="center", fontsize=7)
    axes.set_xticks(range(len(travel)), [f"{1e6 * step:g}" for step in travel])
    powers = [f"$10^{{{np.log10(level):.0f}}}$" for level in stiffness]
    axes.set_yticks(range(len(stiffness)), powers)
    axes.tick_params(labelsize=7, length=0)


def draw_force(results: Sequence[force.Cell], path: Path, quick: bool) -> None:
    """Write the map of the reconstructors: a panel for each dial, a line for each of them.

    A cell has the largest error of ΣFn of the frames that are read, in percent.
    """
    dials = list(dict.fromkeys(cell.dial for cell in results))
    readers = list(dict.fromkeys((cell.method, cell.design) for cell in results))
    columns = min(4, len(dials))
    rows = -(-len(dials) // columns)
    title = title_of("Domes, pressed and pulled to Γ ≈ .1: what each reconstructor reads", quick)
    height = rows * (0.34 * len(readers) + 0.8) + 1.2
    figure = new_figure(title, max(3.5 * columns, 9.0), height)
    panels = figure.subplots(rows, columns, squeeze=False)
    for axes, dial in zip(panels.flat, dials, strict=False):
        _panel_of_force(axes, [cell for cell in results if cell.dial == dial], readers)
        axes.set_xlabel(force.DIALS[dial].label, fontsize=8)
    for axes in panels.flat[len(dials) :]:
        axes.axis("off")
    for axes in panels[:, 1:].flat:
        axes.set_yticklabels([])
    handles = patches((cell.outcome for cell in results), force.OUTCOMES)
    handles.append(Line2D([], [], ls="", label="numbers: largest error of ΣFn [%]"))
    legend_below(figure, handles, 3)
    path.write_bytes(png(figure))


def _panel_of_force(
    axes: Axes, part: Sequence[force.Cell], readers: Sequence[tuple[str, str]]
) -> None:
    values = list(dict.fromkeys(cell.value for cell in part))
    at = {(cell.method, cell.design, cell.value): cell for cell in part}
    outcomes = [[at[*reader, value].outcome for value in values] for reader in readers]
    x, y = np.arange(len(values) + 1.0) - 0.5, np.arange(len(readers) + 1.0) - 0.5
    mesh(axes, x, y, outcomes, force.OUTCOMES)
    for cell in part:
        place = values.index(cell.value), readers.index((cell.method, cell.design))
        error = cell.normal_percent
        text = "" if np.isnan(error) else f"{error:.0f}" if error >= 0.95 else "<1"
        axes.annotate(text, place, ha="center", va="center", fontsize=7)
    axes.set_xticks(range(len(values)), values)
    axes.set_yticks(range(len(readers)), [", ".join(reader) for reader in readers])
    axes.invert_yaxis()
    axes.tick_params(labelsize=7, length=0)


def _edges(values: Array) -> Array:
    """Edges of cells around two or more increasing positive values."""
    middle = np.sqrt(values[1:] * values[:-1])
    return np.r_[values[0] ** 2 / middle[0], middle, values[-1] ** 2 / middle[-1]]


def draw_track(results: Sequence[track.Cell], path: Path, quick: bool) -> None:
    """Write the curves of all trackers: share of right markers, and error, over each dial."""
    dials = list(dict.fromkeys(cell.dial for cell in results))
    columns = min(4, len(dials))
    blocks = -(-len(dials) // columns)
    title = f"Share of markers within {RIGHT:g} px of their own place; error of those reported"
    figure = new_figure(title_of(title, quick), 3.3 * columns, 4.6 * blocks + 0.9)
    panels = figure.subplots(2 * blocks, columns, squeeze=False)
    for place in range(blocks * columns):
        block, column = divmod(place, columns)
        right, error = panels[2 * block : 2 * block + 2, column]
        if place < len(dials):
            _curves(right, error, [cell for cell in results if cell.dial == dials[place]])
        else:
            right.axis("off")
            error.axis("off")
        if column == 0:
            right.set_ylabel("right, worst frame [%]", fontsize=8)
            error.set_ylabel("RMS error [px]", fontsize=8)
    legend_below(figure, panels[0, 0].get_lines()[:-1], 2 * columns)
    path.write_bytes(png(figure))


def _curves(right: Axes, error: Axes, part: Sequence[track.Cell]) -> None:
    values = list(dict.fromkeys(cell.value for cell in part))
    for axes in (right, error):
        axes.set_prop_cycle(color=_COLOURS, marker=list(_MARKERS))
        axes.set_xticks(range(len(values)), [f"{value:g}" for value in values])
        axes.tick_params(labelsize=7)
    for name in dict.fromkeys(cell.tracker for cell in part):
        curve = [cell for cell in part if cell.tracker == name]
        x = [values.index(cell.value) for cell in curve]
        width, order = (2.4, 3.0) if name == DEFAULT_TRACKER else (1.1, 2.0)
        shares, errors = [c.right_percent for c in curve], [c.rms_px for c in curve]
        right.plot(x, shares, ms=4.0, lw=width, zorder=order, label=name)
        error.plot(x, errors, ms=4.0, lw=width, zorder=order)
    right.axhline(track.HELD, color="0.6", lw=0.8, ls=":", marker="")
    right.set_ylim(-4.0, 104.0)
    error.set_yscale("log")
    error.set_xlabel(track.DIALS[part[0].dial].label, fontsize=8)
