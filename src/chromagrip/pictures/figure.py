"""Figures of estimates: their course over time, and each frame with its forces."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ..control import GripObservation
from ..folders import whole_file
from ..loop.results.figure import ESTIMATED, LOAD, TRUE, finish
from ..loop.results.tactile_video import ARROW
from ..model import REFERENCE_NODES, ForceField
from ..output.parquet import Row
from ..tracking import Tracks
from .overlay import Canvas

Image = NDArray[np.uint8]
#: True value of each frame by column.
Truth = Mapping[str, NDArray[np.generic]]
Place = Callable[[NDArray[np.float64]], NDArray[np.float64]]

#: Colours, RGB.
_TEXT = (20, 20, 20)
_FORCE = (30, 60, 200)
_MOTION = (0, 130, 60)


def draw_figure(rows: list[Row], flat: bool, path: Path, truth: Truth) -> None:
    """Write forces, µ and Γ with their intervals over time to a PNG, or displacements of a pad.

    Parameters
    ----------
    rows: of the frames
    flat: whether they are displacements of a flat pad
    path: of the picture
    truth: true value of each frame by column; it is drawn where it is known
    """
    time = _column(rows, "time_s")
    panels: list[tuple[str, list[tuple[str, str, str]]]] = (
        [
            ("into the pad [mm]", [("depth_mm", "", "95 % quantile of the markers")]),
            ("along the pad [mm]", [("shift_x_mm", "", "x"), ("shift_y_mm", "", "y")]),
        ]
        if flat
        else [
            ("force [N]", [("normal", "_n", "ΣFn, 90 %"), ("friction", "_n", "ΣFf, 90 %")]),
            ("friction coefficient µ", [("mu", "", "estimated, 90 %")]),
            ("safety margin Γ", [("margin", "", "estimated, 90 %")]),
        ]
    )
    figure = Figure(figsize=(8.0, 0.6 + 2.2 * len(panels)), layout="constrained")
    FigureCanvasAgg(figure)
    panel_axes: list[Axes] = np.atleast_1d(figure.subplots(len(panels), 1, sharex=True)).tolist()
    for axes, (label, curves) in zip(panel_axes, panels, strict=True):
        for curve, colour, dashes in zip(curves, (TRUE, ESTIMATED), ("--", ":"), strict=False):
            _curve(axes, rows, time, *curve, colour)
            _true_curve(axes, rows, time, truth.get("".join(curve[:2])), curve[2], dashes)
        axes.set_ylabel(label)
        if curves[0][0] == "mu":
            hidden = np.array([row.get("mu_observable") is False for row in rows])
            course = np.where(hidden, _column(rows, "mu"), np.nan)
            axes.plot(time, course, color=LOAD, lw=3.0, alpha=0.5, label="µ not observable")
        missing = np.array([bool(row["no_estimate"]) for row in rows])
        if missing.any():
            # At the lower edge, not at a value of 0.
            edge, low = axes.get_xaxis_transform(), np.full(missing.sum(), 0.03)
            axes.plot(time[missing], low, "|", color=LOAD, label="no estimate", transform=edge)
        finish(axes)
    if not flat:
        panel_axes[2].axhline(0.0, color=LOAD, lw=0.8, ls=":")
        panel_axes[2].set_ylim(-0.15, 1.05)
    panel_axes[-1].set_xlabel("time [s]")
    with whole_file(path) as part:
        figure.savefig(part, dpi=110)


def _column(rows: list[Row], name: str) -> NDArray[np.float64]:
    values = [row.get(name) for row in rows]
    return np.array([value if isinstance(value, float) else math.nan for value in values])


def _curve(
    axes: Axes,
    rows: list[Row],
    time: NDArray[np.float64],
    name: str,
    unit: str,
    words: str,
    colour: str,
) -> None:
    # A single frame has no line.
    style = "o" if len(rows) == 1 else "-"
    axes.plot(time, _column(rows, name + unit), style, color=colour, lw=1.0, label=words)
    low, high = (_column(rows, f"{name}_{end}{unit}") for end in ("low", "high"))
    if np.isfinite(low).any():
        axes.fill_between(time, low, high, color=colour, alpha=0.2, lw=0)


def _true_curve(
    axes: Axes,
    rows: list[Row],
    time: NDArray[np.float64],
    true: NDArray[np.generic] | None,
    words: str,
    dashes: str,
) -> None:
    """Draw the true values of a curve, if any are known."""
    frames = [int(str(row["frame"])) for row in rows]
    if true is None or max(frames) >= len(true):
        return
    values = np.array([float(true[frame]) for frame in frames])
    if np.isfinite(values).any():
        name = words.split(",")[0].replace("estimated", "")
        label = f"{name}, true".removeprefix(", ")
        style = "x" if len(rows) == 1 else dashes
        axes.plot(time, values, style, color="black", lw=1.0, label=label)


def draw_forces(
    image: Image,
    place: Place,
    tracks: Tracks,
    rest: Tracks,
    observation: GripObservation,
    magnify: int,
) -> Image:
    """Picture with the outer markers' motion, the force on every third node, and Γ as a bar.

    Parameters
    ----------
    image: of the frame
    place: gives the pixels (…, 2) of points (…, 3) of the sensor frame [m]
    tracks, rest: of the markers in the frame and at rest
    observation: of the frame
    magnify: factor by which motion is drawn longer than it is
    """
    canvas = Canvas(image, lines=3)
    both = tracks.visible[0] & rest.visible[0]
    start = rest.position[0, both]
    canvas.lines(start, start + magnify * (tracks.position[0, both] - start), _MOTION)
    missing = rest.visible[0] & ~tracks.visible[0]
    lost_colour = (215, 25, 30)
    canvas.crosses(rest.position[0, missing], 3.0, lost_colour)
    field = observation.field
    dome = field.directions is not None
    (_dome_forces if dome else _chain_forces)(canvas, place, field)
    lines = (
        [(observation.no_estimate, lost_colour)]
        if observation.no_estimate
        else [
            (f"normal {field.total_normal:.2f} N", _TEXT),
            (f"friction {field.total_friction:.2f} N", _TEXT),
            (f"mu {observation.friction:.2f}", _TEXT),
        ]
    )
    canvas.text([(f"{observation.time:.3f} s", _TEXT), *lines], 0)
    margin = f"{observation.margin:.2f}" if math.isfinite(observation.margin) else "unknown"
    canvas.text([("margin", _TEXT), (margin, _TEXT)], 1)
    _bar(canvas.pixels, observation)
    # Words for the forces of a chain and of a dome.
    legends = (
        "force per node: across friction, up normal",
        "force per node: circle normal, line friction",
    )
    canvas.text(
        [
            (f"{legends[dome]}, {field.normal.max(initial=0.0):.2g} N at most", _FORCE),
            (f"marker motion x{magnify}", _MOTION),
            (f"x lost {missing.sum()}", lost_colour),
        ],
        2,
    )
    return canvas.pixels


def _chain_forces(canvas: Canvas, place: Place, field: ForceField) -> None:
    """Force on every third node of a chain."""
    x, z = field.position[field.contact][::3].T
    base = place(np.stack([x, np.zeros_like(x), z], axis=-1))
    force = np.stack([field.friction, -field.normal], axis=-1)[field.contact][::3]
    tip = base + ARROW * len(field.normal) / REFERENCE_NODES * force
    canvas.lines(base, tip, _FORCE)
    canvas.circles(tip, np.full(len(tip), 1.0), _FORCE)


def _dome_forces(canvas: Canvas, place: Place, field: ForceField) -> None:
    """Normal force on the nodes of a dome as circles, friction as lines along the skin."""
    on = field.contact
    if not on.any():
        return
    largest = float(field.normal[on].max())
    base = place(field.position[on])
    # The largest normal force is a circle of 4 px, and as large a friction a line of 6 mm.
    circle, line = 4.0, 6e-3
    tip = place(field.position[on] + line / largest * field.friction[on])
    canvas.circles(base, circle * np.sqrt(np.maximum(field.normal[on], 0.0) / largest), _FORCE)
    canvas.lines(base, tip, _FORCE)


def _bar(pixels: Image, observation: GripObservation) -> None:
    """Γ from 0 to 1 as a bar on the second line of text, its 90 % interval paler."""
    left, width, top, bottom = 220, 600, 42, 60

    def at(value: float) -> int:
        return left + round(width * min(max(value, 0.0), 1.0))

    low, high = observation.margin_interval
    if math.isfinite(low) and math.isfinite(high):
        cv2.rectangle(pixels, (at(low), top), (at(high), bottom), (190, 220, 190), -1)
    if math.isfinite(observation.margin):
        cv2.rectangle(
            pixels, (left, top + 5), (at(observation.margin), bottom - 5), (90, 150, 90), -1
        )
    cv2.rectangle(pixels, (left, top), (left + width, bottom), _TEXT, 1)
