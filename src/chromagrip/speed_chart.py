"""Charts of time against error: one point per method, and the front that no other one beats."""

import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

#: Points within this factor of each other in time and error are close.
_CLOSE = 2.0


@dataclass(frozen=True, kw_only=True)
class Point:
    """One method at one setting.

    Attributes
    ----------
    name: of method and setting
    times: of each pass [ms]
    errors: by name
    ours: whether it is drawn as the project's choice
    """

    name: str
    times: list[float]
    errors: dict[str, float]
    ours: bool

    @property
    def milliseconds(self) -> float:
        """Median of the passes [ms]."""
        return float(np.median(self.times))


@dataclass(frozen=True, kw_only=True)
class Axis:
    """One error to draw.

    Attributes
    ----------
    key: of the error
    label: of its axis
    unit: of the error
    lines: levels to draw across, by name
    """

    key: str
    label: str
    unit: str
    lines: dict[str, float] = field(default_factory=dict)


def write_chart(
    points: Sequence[Point],
    axes: Sequence[Axis],
    title: str,
    per: str,
    result: dict[str, Any],
    out: Path,
) -> None:
    """Leave chart.svg, chart.png, chart.csv and chart.json in a folder.

    Parameters
    ----------
    points: methods
    axes: errors, two a row
    title: of the figure
    per: what the time is of, such as "frame"
    result: what chart.json holds; names the machine
    out: folder
    """
    matplotlib.use("Agg", force=False)
    rows = -(-len(axes) // 2)
    figure = Figure(figsize=(11.0, 1.0 + 4.0 * rows), layout="constrained")
    for panel, axis in zip(figure.subplots(rows, 2).flat, axes, strict=True):
        _draw(panel, points, axis, per)
    listed = ", ".join(f"{key} {value}" for key, value in result["machine"].items())
    figure.suptitle(f"{title}; lower left is better")
    figure.supxlabel(listed, fontsize=6)
    figure.savefig(out / "chart.svg")
    figure.savefig(out / "chart.png", dpi=110)
    with (out / "chart.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        keys = [axis.key for axis in axes]
        table.writerow(["name", "milliseconds", "fastest", "slowest", *keys])
        for p in points:
            spent = [p.milliseconds, min(p.times), max(p.times)]
            table.writerow([p.name, *spent, *(p.errors[key] for key in keys)])
    (out / "chart.json").write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


def _draw(panel: Any, points: Sequence[Point], axis: Axis, per: str) -> None:
    best = front(points, axis.key)
    panel.plot([p.milliseconds for p in best], [p.errors[axis.key] for p in best], "-", color="0.8")
    for point in points:
        x, y = point.milliseconds, point.errors[axis.key]
        panel.errorbar(
            x,
            y,
            xerr=[[x - min(point.times)], [max(point.times) - x]],
            fmt="o" if point in best else "x",
            color="tab:blue" if point.ours else "tab:orange",
        )
        panel.annotate(
            point.name,
            (x, y),
            textcoords="offset points",
            xytext=(6, -12 if _below_another(point, points, axis.key) else 6),
            fontsize=8,
        )
    for name, level in axis.lines.items():
        panel.axhline(level, color="0.5", linestyle="--", linewidth=0.8)
        # Named at the left edge, above its line.
        panel.annotate(
            name,
            (0.0, level),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            xytext=(4, 2),
            fontsize=8,
            color="0.4",
        )
    panel.set(
        xscale="log", yscale="log", xlabel=f"time per {per} [ms], one core", ylabel=axis.label
    )
    panel.grid(alpha=0.3, which="both")
    panel.margins(0.2)


def _below_another(point: Point, points: Sequence[Point], key: str) -> bool:
    """Whether another point stands close above, so that names must part."""

    def close(a: float, b: float) -> bool:
        return a < _CLOSE * b and b < _CLOSE * a

    rank = (point.errors[key], point.name)
    return any(
        close(other.milliseconds, point.milliseconds)
        and close(other.errors[key], point.errors[key])
        and (other.errors[key], other.name) > rank
        for other in points
    )


def front(points: Sequence[Point], key: str) -> list[Point]:
    """Points that no other one beats in both, by time."""
    best, found = np.inf, []
    for point in sorted(points, key=lambda p: p.milliseconds):
        if point.errors[key] < best:
            best = point.errors[key]
            found.append(point)
    return found
