"""Pictures of the closed loop's maps: outcomes as colours, the predicted boundary over them."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from .cells import OUTCOMES, WORDS, Cell, Setting
from .maps import CRUSHING, LINEAR, Line, Map, Panel

_STYLES = {LINEAR: "-", CRUSHING: ":"}
#: Size of a cell, and of what stands around a panel [inches].
_CELL, _AROUND, _LEGEND = (0.27, 0.33), (1.0, 0.9), 1.5


def draw(which: Map, found: Mapping[Setting, Cell], folder: Path, name: str, quick: bool) -> None:
    """Leave a map as NAME.svg and NAME.png."""
    rows = -(-len(which.panels) // which.columns)
    wide, high = len(which.panels[0].x), len(which.panels[0].y)
    size = (
        max(which.columns * (wide * _CELL[0] + _AROUND[0]), 9.5),
        rows * (high * _CELL[1] + _AROUND[1]) + _LEGEND,
    )
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, which.columns, squeeze=False)
    lines: list[Line] = []
    for axes, panel in zip(panels.flat, which.panels, strict=False):
        _panel(axes, which, panel, found)
        for line in which.lines(panel) if which.lines else []:
            lines.append(line)
            axes.plot(line.x, line.y, _STYLES[line.label], color="black", lw=2.0)
    for axes in panels.flat[len(which.panels) :]:
        axes.axis("off")
    figure.suptitle(f"{which.title}{' (quick)' if quick else ''}", fontsize=11)
    _legend(figure, which, found, dict.fromkeys(line.label for line in lines))
    figure.savefig(folder / f"{name}.svg", metadata={"Date": None})
    figure.savefig(folder / f"{name}.png", dpi=110)


def _panel(axes: Axes, which: Map, panel: Panel, found: Mapping[Setting, Cell]) -> None:
    for row, y in enumerate(panel.y):
        for column, x in enumerate(panel.x):
            setting = which.at(panel, x, y)
            cell = found[setting]
            axes.add_patch(
                Rectangle(
                    (column - 0.5, row - 0.5),
                    1.0,
                    1.0,
                    facecolor=OUTCOMES[cell.outcome],
                    edgecolor="white",
                    lw=0.8,
                )
            )
            if which.lines and setting == panel.base:
                axes.add_patch(
                    Rectangle(
                        (column - 0.44, row - 0.44), 0.88, 0.88, fill=False, ec="black", lw=1.2
                    )
                )
            if cell.swings and cell.outcome != "limit cycle":
                axes.plot(column, row, ".", color="white", ms=3)
            if which.lines is None and cell.root >= 1.0:
                colour = "white" if cell.outcome == "crush" else "black"
                axes.plot(column, row, "x", color=colour, ms=7, mew=1.4)
            seen = found.get(replace(setting, path="camera", margin_noise=0.0))
            if seen is not None and seen.setting in which.camera:
                axes.plot(
                    column, row, "o", ms=9, mec="black", mew=1.2, color=OUTCOMES[seen.outcome]
                )
    axes.set_xlim(-0.5, len(panel.x) - 0.5)
    axes.set_ylim(-0.5, len(panel.y) - 0.5)
    axes.set_xticks(range(len(panel.x)), [_text(x) for x in panel.x], rotation=90)
    axes.set_yticks(range(len(panel.y)), [_text(y) for y in panel.y])
    axes.tick_params(labelsize=7, length=0)
    axes.set_title(panel.title, fontsize=9)
    axes.set_xlabel(which.x_label, fontsize=8)
    axes.set_ylabel(which.y_label, fontsize=8)


def _text(value: float | int | str) -> str:
    if value == np.inf:
        return "flat"
    return value if isinstance(value, str) else f"{value:g}"


def _legend(
    figure: Figure, which: Map, found: Mapping[Setting, Cell], lines: Iterable[str]
) -> None:
    settings = set(which.settings())
    mine = [found[setting] for setting in settings]
    present = [name for name in OUTCOMES if any(cell.outcome == name for cell in mine)]
    handles: list[Patch | Line2D] = [
        Patch(color=OUTCOMES[name], label=f"{name}: {WORDS[name]}") for name in present
    ]
    if which.lines is None:
        handles.append(
            Line2D([], [], color="black", marker="x", ls="", label=f"unstable, {LINEAR}")
        )
    handles += [Line2D([], [], color="black", ls=_STYLES[x], lw=2, label=x) for x in lines]
    if any(cell.swings and cell.outcome != "limit cycle" for cell in mine):
        # White would not show on the page.
        dot = Line2D([], [], color="0.6", marker=".", ls="", label="white dot: it swings as well")
        handles.append(dot)
    if which.lines and any(panel.base in settings for panel in which.panels):
        label = "frame: the gains' own place"
        handles.append(
            Line2D([], [], marker="s", ls="", mfc="none", mec="black", ms=8, label=label)
        )
    if which.camera:
        label = "ring: the same through the camera"
        handles.append(Line2D([], [], marker="o", ls="", mfc="none", mec="black", label=label))
    figure.legend(handles=handles, loc="outside lower center", ncols=2, fontsize=7.5)
