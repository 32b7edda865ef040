"""Plots of a pinch that fill with time: axes are drawn once, curves are painted on them."""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..columns import values_of
from ..results.figure import ESTIMATED, LOAD, TRUE
from ..sample import Sample

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Colour = tuple[int, int, int]

Curves = dict[str, list[float]]

#: Columns of a trace drawn for each finger.
MARGIN_NAMES = (
    "margin_true",
    "margin_estimated",
    "limit_margin_true",
    "limit_margin_estimated",
    "limit_margin_low",
    "limit_margin_high",
)
#: Columns of a trace drawn in the plot of forces.
FORCE_NAMES = ("grip_n", "table_n")


def _rgb(colour: str) -> Colour:
    red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
    return red, green, blue


#: Colours of the truth, the estimates and further lines, and of the estimates' intervals.
TRUTH = _rgb(TRUE)
SEEN = _rgb(ESTIMATED)
OTHER = _rgb(LOAD)
_BAND = "#f6decb"
BAND = _rgb(_BAND)


@dataclass(frozen=True, kw_only=True)
class Courses:
    """Values of all frames so far; NaN if unknown.

    Attributes
    ----------
    times: times of the frames [s]
    margins: margins of each finger, by `MARGIN_NAMES`
    forces: forces by `FORCE_NAMES` [N]
    """

    times: list[float] = field(default_factory=list)
    margins: tuple[Curves, Curves] = field(
        default_factory=lambda: (_curves(MARGIN_NAMES), _curves(MARGIN_NAMES))
    )
    forces: Curves = field(default_factory=lambda: _curves(FORCE_NAMES))

    def add(self, sample: Sample) -> None:
        """Append a frame."""
        self.times.append(sample.time)
        self.forces["grip_n"].append(sample.grip)
        self.forces["table_n"].append(sample.pinch.state.support)
        for finger, margins in enumerate(self.margins):
            for name, value in values_of(sample, MARGIN_NAMES, finger).items():
                margins[name].append(value)


def _curves(names: tuple[str, ...]) -> Curves:
    return {name: [] for name in names}


@dataclass(frozen=True, kw_only=True)
class Panel:
    """Axes in a picture.

    Attributes
    ----------
    left, right, bottom, top: edges of the axes [px]; rows are counted downwards
    duration: time at the right edge [s]; the left edge is at 0
    low, high: values at the lower and upper edge
    """

    left: float
    right: float
    bottom: float
    top: float
    duration: float
    low: float
    high: float

    def pixels(self, times: Array, values: Array) -> Array:
        """Places of values in the picture [px], shape (N, 2); values are clipped to the edges."""
        across = self.left + times / self.duration * (self.right - self.left)
        share = (np.clip(values, self.low, self.high) - self.low) / (self.high - self.low)
        return np.stack([across, self.bottom + share * (self.top - self.bottom)], axis=-1)


class CoursePlot:
    """Margins of both fingers and the grip over time, side by side.

    Parameters
    ----------
    size: width and height [px]
    duration: length of the scene [s]
    desired: margin that the controller aims at, drawn as a line; None: no line
    kind: word for the controller's values, such as `estimated`
    """

    def __init__(
        self, size: tuple[int, int], duration: float, desired: float | None, kind: str
    ) -> None:
        self._size, self._duration, self._desired, self._kind = size, duration, desired, kind
        first_force = 5.0  # highest force of the axes at first; it grows by steps [N]
        self._most = first_force
        self.panels: tuple[Panel, ...]
        self._empty: Image
        self._draw_axes()

    def draw(self, courses: Courses) -> Image:
        """Picture of the courses so far, RGB."""
        largest = max(np.nanmax(values, initial=0.0) for values in courses.forces.values())
        if largest > self._most:
            self._most = _next_step(largest)
            self._draw_axes()
        picture = self._empty.copy()
        times = np.array(courses.times)
        for panel, margins in zip(self.panels[:2], courses.margins, strict=True):
            values = {name: np.array(course) for name, course in margins.items()}
            paint_band(
                picture, panel, times, values["limit_margin_low"], values["limit_margin_high"]
            )
            if self._desired is not None:
                _paint_level(picture, panel, self._desired)
            paint_curve(picture, panel, times, values["margin_estimated"], SEEN, 1)
            paint_curve(picture, panel, times, values["margin_true"], TRUTH, 1)
            paint_curve(picture, panel, times, values["limit_margin_estimated"], SEEN, 2)
            paint_curve(picture, panel, times, values["limit_margin_true"], TRUTH, 2)
        force = self.panels[2]
        paint_curve(picture, force, times, np.array(courses.forces["table_n"]), OTHER, 2)
        paint_curve(picture, force, times, np.array(courses.forces["grip_n"]), TRUTH, 2)
        for panel in self.panels:
            column = round(float(panel.pixels(times[-1:], np.zeros(1))[0, 0]))
            cv2.line(picture, (column, round(panel.top)), (column, round(panel.bottom)), OTHER, 1)
        return picture

    def _draw_axes(self) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        width, height = self._size
        dpi = 100  # pixels of an inch in matplotlib
        figure = Figure(figsize=(width / dpi, height / dpi), dpi=dpi)
        canvas: Any = FigureCanvasAgg(figure)
        grid = figure.subplots(1, 3)
        figure.subplots_adjust(left=0.045, right=0.985, bottom=0.2, top=0.8, wspace=0.16)
        margin_range = (-0.15, 1.05)  # lowest and highest drawn margin
        for axes, title in zip(
            grid, ("margins, finger 1", "margins, finger 2", "force"), strict=True
        ):
            axes.set_xlim(0.0, self._duration)
            axes.set_xlabel("time [s]", fontsize=9, labelpad=1)
            axes.set_ylabel(f"{title} [N]" if title == "force" else title, fontsize=9)
            axes.set_ylim(*((0.0, self._most) if title == "force" else margin_range))
            axes.tick_params(labelsize=8)
            axes.grid(alpha=0.25, lw=0.5)
            axes.spines[["top", "right"]].set_visible(False)
        true, seen = TRUE, ESTIMATED
        keys = [
            Line2D([], [], color=true, lw=2, label="true, with torsion"),
            Line2D([], [], color=true, lw=0.8, label="true Γ"),
            Line2D([], [], color=seen, lw=2, label=f"{self._kind}, with torsion"),
            Patch(color=_BAND, label="its 90 % interval"),
            Line2D([], [], color=seen, lw=0.8, label=f"{self._kind} Γ"),
        ]
        if self._desired is not None:
            label = f"target {self._desired:g}"
            keys.append(Line2D([], [], color=LOAD, lw=1, ls=":", label=label))
        look = {"frameon": False, "fontsize": 8.5, "handlelength": 1.4, "columnspacing": 1.3}
        figure.legend(handles=keys, loc="upper left", bbox_to_anchor=(0.03, 1.01), ncol=6, **look)
        forces = [
            Line2D([], [], color=true, lw=2, label="grip of each finger"),
            Line2D([], [], color=LOAD, lw=2, label="force of the table"),
        ]
        figure.legend(
            handles=forces, loc="upper right", bbox_to_anchor=(0.99, 1.01), ncol=2, **look
        )
        canvas.draw()
        self._empty = np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3])
        self.panels = tuple(_panel(axes, height, self._duration) for axes in grid)


def _panel(axes: "Axes", height: int, duration: float) -> Panel:
    """Place of axes in the picture."""
    box = axes.get_window_extent()
    low, high = axes.get_ylim()
    return Panel(
        left=box.x0, right=box.x1, bottom=height - box.y0, top=height - box.y1,
        duration=duration, low=low, high=high,
    )  # fmt: skip


def paint_curve(
    picture: Image, panel: Panel, times: Array, values: Array, colour: Colour, width: int
) -> None:
    """Paint a curve, with gaps at unknown values."""
    for part in _known(np.isfinite(values)):
        points = np.rint(16.0 * panel.pixels(times[part], values[part])).astype(np.int32)
        cv2.polylines(picture, [points], False, colour, width, cv2.LINE_AA, shift=4)


def paint_band(picture: Image, panel: Panel, times: Array, low: Array, high: Array) -> None:
    """Paint the area between two curves, where both are known."""
    for part in _known(np.isfinite(low) & np.isfinite(high)):
        there = panel.pixels(times[part], low[part])
        back = panel.pixels(times[part], high[part])[::-1]
        points = np.rint(16.0 * np.concatenate([there, back])).astype(np.int32)
        cv2.fillPoly(picture, [points], BAND, cv2.LINE_AA, shift=4)


def _paint_level(picture: Image, panel: Panel, level: float) -> None:
    row = round(float(panel.pixels(np.zeros(1), np.array([level]))[0, 1]))
    for column in range(round(panel.left), round(panel.right), 6):
        cv2.line(picture, (column, row), (column + 2, row), OTHER, 1)


def _known(known: NDArray[np.bool_]) -> list[slice]:
    """Runs of consecutive known values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(np.int8)))
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _next_step(force: float) -> float:
    """The next of 1, 2, 5, 10, 20, … that is above a force [N]."""
    power = 10.0 ** math.floor(math.log10(force))
    return float(next(power * step for step in (1.0, 2.0, 5.0, 10.0, 20.0) if power * step > force))
