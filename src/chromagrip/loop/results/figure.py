"""Figure of one run over time, after the thesis's Figs. 13–15."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ...output.run_page import Curve, Panel
from ...scene.scene import Scene
from ..column import OUTCOMES
from ..trace import Trace
from .panels import panels_of

Array = NDArray[np.float64]

#: Colours that people with any colour vision can distinguish (Okabe and Ito).
TRUE = "#0072b2"
ESTIMATED = "#d55e00"
LOAD = "#5a5a5a"
#: Colours of the roles of curves.
_COLOURS = {"true": TRUE, "estimated": ESTIMATED, "commanded": "#000000", "other": LOAD}


def draw_figure(scene: Scene, trace: Trace, path: Path) -> None:
    """Write the panels of a run's report to a PNG."""
    panels = list(panels_of(scene, trace.columns))
    figure = Figure(figsize=(8.0, 1.0 + 1.6 * len(panels)), layout="constrained")
    FigureCanvasAgg(figure)
    plots: list[Axes] = np.ravel(figure.subplots(len(panels), 1, sharex=True)).tolist()
    for axes, panel in zip(plots, panels, strict=True):
        _draw(axes, trace["time_s"], panel)
    plots[-1].set_xlabel("time [s]")
    plots[-1].set_xlim(0.0, scene.duration_s)
    figure.suptitle(_title(scene, trace), fontsize=11)
    figure.savefig(path, dpi=110)


def _draw(axes: Axes, time: Array, panel: Panel) -> None:
    """Draw a panel: estimates thin over the truth, intervals shaded."""
    for curve in panel.curves:
        _draw_curve(axes, time, curve)
    for (label, level), style in zip(panel.levels, (":", "-."), strict=False):
        axes.axhline(level, color=LOAD, lw=1.2, ls=style, label=label)
    low, high = axes.get_ylim()
    least, most = panel.limits
    axes.set_ylim(max(least, min(low, panel.span[0])), min(most, max(high, panel.span[1])))
    axes.set_title(panel.title, loc="left", fontsize=9)
    finish(axes)


def _draw_curve(axes: Axes, time: Array, curve: Curve) -> None:
    colour, shaded = _COLOURS[curve.role], curve.role == "estimated" and curve.low is not None
    if curve.low is not None and curve.high is not None:
        step: Any = "mid" if curve.role == "other" else None  # a single instant has a width
        axes.fill_between(time, curve.low, curve.high, color=colour, alpha=0.2, lw=0, step=step)
        if curve.role == "other":  # only the shade is drawn
            axes.collections[-1].set_label(curve.label)
            return
    axes.plot(
        time,
        curve.values,
        "--" if curve.second else "-",
        drawstyle="steps-post" if curve.steps else "default",
        color=colour,
        lw=1.0 if curve.role == "estimated" else 1.6,
        label=f"{curve.label}, 90 % shaded" if shaded else curve.label,
    )


def _title(scene: Scene, trace: Trace) -> str:
    plural = "" if scene.camera.latency_frames == 1 else "s"
    ended = "" if len(trace) == scene.frames else f", ended at {trace['time_s'][-1]:.2f} s"
    outcome = f": {OUTCOMES[int(trace['outcome'][-1])]}" if "outcome" in trace.columns else ""
    return (
        f"{scene.controller}, {scene.path} path at {scene.camera.rate_hz:g} Hz "
        f"with a latency of {scene.camera.latency_frames} frame{plural}{outcome}{ended}"
    )


def finish(axes: Axes) -> None:
    """Draw grid, frame and legend of a panel."""
    axes.grid(alpha=0.25, lw=0.5)
    axes.spines[["top", "right"]].set_visible(False)
    # Outside the axes a legend never hides a curve.
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)
