"""Runs as an HTML page with one time slider; it holds all that it shows and loads nothing."""

import base64
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..folders import whole_file
from .page import filled

Array = NDArray[np.float64]
#: What a curve is: colour and dashes tell it.
Role = Literal["true", "estimated", "commanded", "other"]

#: Instants that a page keeps of a run, at most.
MOST_INSTANTS = 4000


@dataclass(frozen=True, kw_only=True)
class Curve:
    """A value over time.

    Attributes
    ----------
    label: in the legend
    values: one an instant; NaN where there is none, shape (T,)
    role: see Role
    second: drawn in the second style of its role
    steps: whether each value holds until the next instant
    low, high: ends of its 90 % interval, shape (T,)
    """

    label: str
    values: Array
    role: Role
    second: bool = False
    steps: bool = False
    low: Array | None = None
    high: Array | None = None


@dataclass(frozen=True, kw_only=True)
class Panel:
    """Curves over one axis of values.

    Attributes
    ----------
    title: with the unit of the values
    curves: drawn in their order
    levels: labels and values of horizontal lines, such as a target
    span: values that are shown at least
    limits: values that are shown at most
    """

    title: str
    curves: Sequence[Curve]
    levels: Sequence[tuple[str, float]] = ()
    span: tuple[float, float] = (0.0, 0.0)
    limits: tuple[float, float] = (-math.inf, math.inf)


@dataclass(frozen=True, kw_only=True)
class RunOnPage:
    """A run as the page shows it.

    Attributes
    ----------
    name: of the run
    time: of each instant [s], shape (T,)
    panels: its curves
    words: sentences that say what happened
    facts: names and values of its table
    video: MP4 file of it; None where there is none
    slowdown: how many times slower than the run the video plays
    caption: what the video shows
    scene: what happens in it; runs of one scene share their plots
    """

    name: str
    time: Array
    panels: Sequence[Panel]
    words: Sequence[str]
    facts: Sequence[tuple[str, str]]
    video: Path | None = None
    slowdown: float = 1.0
    caption: str = ""
    scene: str = ""

    @property
    def _kept(self) -> NDArray[np.intp]:
        """Instants that the page keeps."""
        stride = max(1, math.ceil(len(self.time) / MOST_INSTANTS))
        return np.arange(0, len(self.time), stride)

    @property
    def left_out(self) -> bool:
        """Whether the page does not keep all instants."""
        return len(self._kept) < len(self.time)

    def data(self) -> dict[str, Any]:
        """Everything that the page's script draws."""
        kept = self._kept
        return {
            "name": self.name,
            "scene": self.scene,
            "time": _rounded(self.time[kept]),
            "slowdown": self.slowdown,
            "panels": [
                {
                    "title": panel.title,
                    "levels": list(panel.levels),
                    "span": panel.span,
                    "limits": [x if math.isfinite(x) else None for x in panel.limits],
                    "curves": [_curve(curve, kept) for curve in panel.curves],
                }
                for panel in self.panels
            ],
        }


def write_run_page(path: Path, runs: Sequence[RunOnPage], title: str) -> None:
    """Write a page of one run, or of several beside each other."""
    script = (files(__package__) / "run_page.js").read_text(encoding="utf-8")
    data = json.dumps([run.data() for run in runs], allow_nan=False, separators=(",", ":"))
    names = list(dict.fromkeys(name for run in runs for name, _ in run.facts))
    tables = [dict(run.facts) for run in runs]
    text = filled(
        "run_page.html",
        title=title,
        runs=runs,
        videos=[_encoded(run.video) for run in runs],
        facts=[(name, [table.get(name, "–") for table in tables]) for name in names],
        data=data.replace("<", "\\u003c"),  # no text in it ends the script
        script=script,
    )
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8")


def _curve(curve: Curve, kept: NDArray[np.intp]) -> dict[str, Any]:
    ends = (curve.low, curve.high)
    return {
        "label": curve.label,
        "role": curve.role,
        "second": curve.second,
        "steps": curve.steps,
        "values": _rounded(curve.values[kept]),
        "band": [_rounded(end[kept]) for end in ends if end is not None],
    }


def _rounded(values: Array) -> list[float | None]:
    """Values of a few digits; what is not finite is null, as JSON has no NaN."""
    digits = 5  # significant digits of the values on a page
    return [
        float(f"{value:.{digits}g}") if math.isfinite(value) else None for value in values.tolist()
    ]


def _encoded(video: Path | None) -> str:
    return "" if video is None else base64.b64encode(video.read_bytes()).decode("ascii")
