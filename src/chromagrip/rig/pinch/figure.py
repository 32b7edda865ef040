"""Grip, forces, margins, turn and pressure of a pinch in one picture."""

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ...loop.shown.figure import ESTIMATED, LOAD, TRUE, finish
from ...loop.trace import Trace
from ...scene.scene import Scene
from .trace import FINGERS, OUTCOMES

#: Turn that the figure shows at least to both sides [°]: less is the solver's noise.
_TURN = 1.0


def draw_figure(scene: Scene, trace: Trace, path: Path) -> None:
    """Write the course of a pinch to a PNG."""
    figure = Figure(figsize=(8.0, 10.0), layout="constrained")
    FigureCanvasAgg(figure)
    force, contact, margin, turn, pressure = figure.subplots(5, 1, sharex=True)
    time = trace["time_s"]
    force.step(time, trace["grip_n"], where="post", color=TRUE, label="grip")
    force.plot(time, trace["table_n"], color=LOAD, label="table")
    force.set_ylabel("force [N]")
    for finger, style in zip(FINGERS, ("-", "--"), strict=True):
        seen = "observed" if scene.path == "truth" else "estimated"
        for name, colour in (("true", TRUE), ("estimated", ESTIMATED)):
            label = f"{finger}, {name if name == 'true' else seen}"
            course = trace[f"{finger}_friction_{name}_n"]
            contact.plot(time, course, style, color=colour, lw=1.0, label=label)
            course = trace[f"{finger}_limit_margin_{name}"]
            margin.plot(time, course, style, color=colour, lw=1.0, label=label)
    contact.set_ylabel("friction [N]")
    if scene.target_margin is not None:
        label = f"target {scene.target_margin:g}"
        margin.axhline(scene.target_margin, color=LOAD, lw=1.2, ls=":", label=label)
    margin.set_ylim(-0.15, 1.05)
    margin.set_ylabel("margin with torsion")
    turn.plot(time, trace["turn_deg"], color=TRUE, label="turn")
    turn.plot(time, trace["elastic_deg"], ":", color=TRUE, label="elastic twist")
    turn.set_ylabel("turn [°]")
    low, high = turn.get_ylim()
    turn.set_ylim(min(low, -_TURN), max(high, _TURN))
    pressure.plot(time, trace["pressure_kpa"], color=TRUE, label="pressure")
    pressure.set_ylabel("pressure [kPa]")
    pressure.set_xlabel("time [s]")
    pressure.set_xlim(0.0, scene.duration_s)
    for axes in (force, contact, margin, turn, pressure):
        finish(axes)
    outcome = OUTCOMES[int(trace["outcome"][-1])]
    stopped = "" if len(trace) == scene.frames else f", interrupted at {time[-1]:.2f} s"
    figure.suptitle(
        f"{scene.controller}, {scene.path} path at {scene.camera.rate_hz:g} Hz: {outcome}{stopped}",
        fontsize=11,
    )
    figure.savefig(path, dpi=110)
