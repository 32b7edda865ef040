"""Grip, forces, margins, turn and pressure of a pinch in one picture."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ...scene.scene import Scene
from ..shown.figure import ESTIMATED, LOAD, TRUE, finish
from ..trace import Trace, word_for_read
from .trace import FINGERS, OUTCOMES

#: Turn that the figure shows at least to both sides [°]: less is the solver's noise.
_TURN = 1.0


def draw_figure(scene: Scene, trace: Trace, path: Path) -> None:
    """Write the course of a pinch to a PNG."""
    figure = Figure(figsize=(8.0, 12.0), layout="constrained")
    FigureCanvasAgg(figure)
    force, contact, margin, friction, turn, pressure = figure.subplots(6, 1, sharex=True)
    time = trace["time_s"]
    force.step(time, trace["grip_n"], where="post", color=TRUE, label="grip")
    force.plot(time, trace["table_n"], "--", color=LOAD, label="table")
    force.set_ylabel("force [N]")
    for axes, column, name in (
        (contact, "friction_{}_n", "friction [N]"),
        (margin, "limit_margin_{}", "margin with torsion"),
        (friction, "mu_{}", "µ"),
    ):
        _of_both(scene, trace, axes, column)
        axes.set_ylabel(name)
    if scene.target_margin is not None:
        label = f"target {scene.target_margin:g}"
        margin.axhline(scene.target_margin, color=LOAD, lw=1.2, ls=":", label=label)
    margin.set_ylim(-0.15, 1.05)
    friction.set_ylim(0.0, min(2.0, friction.get_ylim()[1]))
    turn.plot(time, trace["turn_deg"], color=TRUE, label="turn, true")
    turn.plot(time, trace["elastic_deg"], ":", color=TRUE, label="elastic twist, true")
    turn.set_ylabel("turn [°]")
    low, high = turn.get_ylim()
    turn.set_ylim(min(low, -_TURN), max(high, _TURN))
    pressure.plot(time, trace["pressure_kpa"], color=TRUE, label="mean, true")
    pressure.set_ylabel("pressure [kPa]")
    pressure.set_xlabel("time [s]")
    pressure.set_xlim(0.0, scene.duration_s)
    for axes in (force, contact, margin, friction, turn, pressure):
        finish(axes)
    outcome = OUTCOMES[int(trace["outcome"][-1])]
    stopped = "" if len(trace) == scene.frames else f", interrupted at {time[-1]:.2f} s"
    figure.suptitle(
        f"{scene.controller}, {scene.path} path at {scene.camera.rate_hz:g} Hz: {outcome}{stopped}",
        fontsize=11,
    )
    figure.savefig(path, dpi=110)


def _of_both(scene: Scene, trace: Trace, axes: Axes, column: str) -> None:
    """True and estimated value of both fingers, the estimate thin over the truth."""
    time, seen = trace["time_s"], word_for_read(scene.path)
    for finger, style in zip(FINGERS, ("-", "--"), strict=True):
        true = trace[f"{finger}_{column.format('true')}"]
        axes.plot(time, true, style, color=TRUE, lw=2.6, alpha=0.55, label=f"{finger}, true")
        read = trace[f"{finger}_{column.format('estimated')}"]
        axes.plot(time, read, style, color=ESTIMATED, lw=0.9, label=f"{finger}, {seen}")
