"""The course of one run in one picture, after the thesis's Figs. 13–15."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ...model import GROSS_SLIP
from ...scene.scene import Scene
from ...tracking import Z90
from ..trace import Trace, may_slide, word_for_read

Array = NDArray[np.float64]

#: Colours that people with any colour vision tell apart (Okabe and Ito).
TRUE = "#0072b2"
ESTIMATED = "#d55e00"
LOAD = "#5a5a5a"


def draw_figure(scene: Scene, trace: Trace, path: Path) -> None:
    """Write grip, forces, margin, µ, slip and pressure over time to a PNG."""
    figure = Figure(figsize=(8.0, 11.0), layout="constrained")
    FigureCanvasAgg(figure)
    grip, contact, margin, friction, slip, pressure = figure.subplots(
        6, 1, sharex=True, height_ratios=(1.0, 1.1, 1.4, 1.0, 0.8, 0.8)
    )
    time, read = trace["time_s"], word_for_read(scene.path)

    grip.step(time, trace["load_n"], "--", where="post", color=LOAD, label="load")
    grip.step(time, trace["grip_n"], where="post", color=TRUE, label="grip")
    grip.set_ylabel("drive [N]")

    for name, sign, style in (("normal", "ΣFn", "-"), ("friction", "ΣFf", "--")):
        _estimated(
            contact,
            time,
            trace[f"{name}_estimated_n"],
            Z90 * trace[f"{name}_deviation_n"],
            f"{sign} {read}",
            style,
        )
        contact.plot(time, trace[f"{name}_true_n"], style, color=TRUE, label=f"{sign} true")
    contact.set_ylabel("contact [N]")
    contact.set_ylim(bottom=0.0)

    _margins(scene, trace, margin)
    half = 0.5 * (trace["mu_high"] - trace["mu_low"])
    _estimated(friction, time, trace["mu_high"] - half, half, "90 % interval", line=False)
    friction.plot(time, trace["mu_estimated"], "-", color=ESTIMATED, lw=1.0, label=read)
    friction.plot(time, trace["mu_true"], color=TRUE, label="true")
    friction.set_ylim(0.0, min(2.0, friction.get_ylim()[1]))
    friction.set_ylabel("µ")

    _slip(trace, slip)
    pressure.plot(time, trace["pressure_n_per_m"], color=TRUE, label="outermost nodes")
    pressure.plot(
        time, trace["pressure_pitch_n_per_m"], color=TRUE, ls=":", label="plus one node pitch"
    )
    pressure.set_ylim(bottom=0.0)
    pressure.set_ylabel("pressure [N/m]")
    pressure.set_xlabel("time [s]")
    pressure.set_xlim(0.0, scene.duration_s)
    for axes in (grip, contact, margin, friction, slip, pressure):
        finish(axes)
    figure.suptitle(_title(scene, trace), fontsize=11)
    figure.savefig(path, dpi=110)


def _margins(scene: Scene, trace: Trace, axes: Axes) -> None:
    """Γ, and on a dome the margin of force and torsion together, with the target."""
    time, read = trace["time_s"], word_for_read(scene.path)
    axes.fill_between(
        time, trace["margin_low"], trace["margin_high"], color=ESTIMATED, alpha=0.2, lw=0,
        label="90 % interval",
    )  # fmt: skip
    axes.plot(time, trace["margin_estimated"], color=ESTIMATED, lw=1.0, label=read)
    axes.plot(time, trace["margin_true"], color=TRUE, label="true")
    if scene.body == "dome":
        for name, word, colour in (("estimated", read, ESTIMATED), ("true", "true", TRUE)):
            course, label = trace[f"limit_margin_{name}"], f"with torsion, {word}"
            axes.plot(time, course, "--", color=colour, lw=1.0, label=label)
    target = scene.target_margin
    if target is not None:
        axes.axhline(target, color=LOAD, lw=1.2, ls=":", label=f"target {target:g}")
    if scene.sliding_margin is not None:
        label = f"interval reaches\n{scene.sliding_margin:g}: Grip First"
        axes.fill_between(
            time, 0.0, 1.0, where=may_slide(scene, trace.columns), step="mid", color=LOAD,
            transform=axes.get_xaxis_transform(), alpha=0.13, lw=0, hatch="..", label=label,
        )  # fmt: skip
    axes.set_ylim(-0.15, 1.05)
    axes.set_ylabel("safety margin Γ")


def _slip(trace: Trace, axes: Axes) -> None:
    """Slip of the object, and from where on it is gross."""
    time, way = trace["time_s"], trace["lateral_displacement_mm"]
    axes.plot(time, way, color=TRUE, label="lateral displacement")
    axes.plot(time, trace["rigid_slip_mm"], color=TRUE, ls=":", label="rigid slip")
    gross = 1e3 * GROSS_SLIP
    axes.axhline(gross, color=LOAD, lw=1.2, ls="-.", label=f"gross slip from {gross:g}")
    axes.fill_between(
        time, 0.0, way, where=way > gross, color=ESTIMATED, alpha=0.3, lw=0, hatch="//"
    )
    axes.set_ylim(0.0, 1.15 * max(gross, float(np.nanmax(way, initial=0.0))))
    axes.set_ylabel("slip [mm]")


def _estimated(
    axes: Axes,
    time: Array,
    value: Array,
    half: Array,
    label: str,
    style: str = "-",
    *,
    line: bool = True,
) -> None:
    """An estimate with the half width of its interval."""
    axes.fill_between(
        time, value - half, value + half, color=ESTIMATED, alpha=0.2, lw=0,
        label=None if line else label,
    )  # fmt: skip
    if line:
        axes.plot(time, value, style, color=ESTIMATED, lw=1.0, label=f"{label}, 90 % shaded")


def _title(scene: Scene, trace: Trace) -> str:
    plural = "" if scene.camera.latency_frames == 1 else "s"
    ended = "" if len(trace) == scene.frames else f", ended at {trace['time_s'][-1]:.2f} s"
    return (
        f"{scene.controller}, {scene.path} path at {scene.camera.rate_hz:g} Hz "
        f"with a latency of {scene.camera.latency_frames} frame{plural}{ended}"
    )


def finish(axes: Axes) -> None:
    """Grid, frame and legend of a panel."""
    axes.grid(alpha=0.25, lw=0.5)
    axes.spines[["top", "right"]].set_visible(False)
    # Outside the axes a legend never hides a curve.
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)
