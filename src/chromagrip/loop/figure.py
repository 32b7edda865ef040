"""The thesis's Figs. 13–15 of one run in one picture."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ..scene.scene import Scene
from .trace import Trace

TRUE = "#1f3b73"
ESTIMATED = "#d1495b"
LOAD = "#6c757d"


def draw_figure(scene: Scene, trace: Trace, path: Path) -> None:
    """Write load and grip, forces, margin, pressure and displacement over time to a PNG."""
    figure = Figure(figsize=(8.0, 10.0), layout="constrained")
    FigureCanvasAgg(figure)
    force, contact, margin, pressure, displacement = figure.subplots(5, 1, sharex=True)
    time = trace["time_s"]

    force.step(time, trace["load_n"], where="post", color=LOAD, label="load")
    force.step(time, trace["grip_n"], where="post", color=TRUE, label="grip")
    force.set_ylabel("force [N]")

    for name, style in (("normal", "-"), ("friction", "--")):
        estimated = trace[f"{name}_estimated_n"]
        contact.plot(time, estimated, style, color=ESTIMATED, lw=1.0, label=f"{name}, estimated")
        contact.plot(time, trace[f"{name}_true_n"], style, color=TRUE, label=f"{name}, true")
    contact.set_ylabel("contact force [N]")

    margin.fill_between(
        time, trace["margin_low"], trace["margin_high"], color=ESTIMATED, alpha=0.2, lw=0
    )
    margin.plot(time, trace["margin_estimated"], color=ESTIMATED, lw=1.0, label="estimated, 90 %")
    margin.plot(time, trace["margin_true"], color=TRUE, label="true")
    if scene.body == "dome":
        for name, colour in (("estimated", ESTIMATED), ("true", TRUE)):
            course, label = trace[f"limit_margin_{name}"], f"with torsion, {name}"
            margin.plot(time, course, "--", color=colour, lw=1.0, label=label)
    margin.axhline(scene.safety_margin.desired_margin, color=LOAD, lw=0.8, ls=":")
    margin.set_ylim(-0.15, 1.05)
    margin.set_ylabel("safety margin Γ")

    pressure.plot(time, trace["pressure_n_per_m"], color=TRUE, label="outermost nodes")
    pressure.plot(
        time, trace["pressure_pitch_n_per_m"], color=TRUE, ls=":", label="plus one node pitch"
    )
    pressure.set_ylabel("pressure [N/m]")

    displacement.plot(
        time, trace["lateral_displacement_mm"], color=TRUE, label="lateral displacement"
    )
    displacement.plot(time, trace["rigid_slip_mm"], color=TRUE, ls=":", label="rigid slip")
    top = max(0.05, float(np.nanmax(trace["lateral_displacement_mm"], initial=0.0)))
    displacement.set_ylim(-0.05 * top, 1.2 * top)
    displacement.set_ylabel("slip [mm]")
    displacement.set_xlabel("time [s]")
    displacement.set_xlim(0.0, scene.duration_s)

    for axes in (force, contact, margin, pressure, displacement):
        finish(axes)
    plural = "" if scene.camera.latency_frames == 1 else "s"
    stopped = "" if len(trace) == scene.frames else f", interrupted at {time[-1]:.2f} s"
    figure.suptitle(
        f"{scene.controller}, {scene.path} path at {scene.camera.rate_hz:g} Hz "
        f"with a latency of {scene.camera.latency_frames} frame{plural}{stopped}",
        fontsize=11,
    )
    figure.savefig(path, dpi=110)


def finish(axes: Axes) -> None:
    """Grid, frame and legend of a panel."""
    axes.grid(alpha=0.25, lw=0.5)
    axes.spines[["top", "right"]].set_visible(False)
    # Outside the axes a legend never hides a curve.
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)
