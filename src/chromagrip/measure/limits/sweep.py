"""Limits over the dials of a design: points, needed values, table and chart."""

import csv
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from ...errors import UserError
from ...output.figure import WIDTH, legend_below, new_figure, plain_ticks, png
from .body import BodyLimit
from .dials import DIALS, Dial

#: Look of each sensor in a chart: more than its colour.
LOOKS: tuple[dict[str, Any], ...] = tuple(
    {"color": colour, "marker": marker, "ls": line}
    for colour, marker, line in zip(
        ("#1f3b73", "#d1495b", "#c98a12", "#00798c", "#6c757d", "#7b4b94"),
        "os^Dvp",
        ("-", "--", "-.", "-", "--", "-."),
        strict=True,
    )
)
#: Look of the bound without misfit.
_BOUND: dict[str, Any] = {"ls": ":", "marker": "", "lw": 1.2}
#: Largest number of dials in a chart, the first ones of the body.
_DRAWN = 5


@dataclass(frozen=True, kw_only=True)
class Point:
    """One design of a sweep.

    Attributes
    ----------
    dial: key of DIALS
    value: of the dial
    own: whether it is the unchanged design
    errors: smallest standard deviations by column of the table; empty for an impossible design
    note: reason why it is impossible
    """

    dial: str
    value: float
    own: bool
    errors: Mapping[str, float] = field(default_factory=dict)
    note: str = ""

    def error(self, name: str = "margin_error") -> float:
        """Smallest standard deviation; NaN for an impossible design."""
        return self.errors.get(name, math.nan)


def sweep(limit: BodyLimit, progress: Callable[[str], None] = lambda text: None) -> list[Point]:
    """Limits of a design with one property changed, in the same contact."""
    points, same = [], limit.errors(limit.design, limit.levels)
    for name in limit.DIALS:
        dial = DIALS[name]
        own = dial.value(limit.design) if dial.value else limit.levels
        for value, setting in _tried(dial, own, limit.NEAREST).items():
            progress(f"{dial.label} {value:.3g} {dial.unit}")
            if value == own:
                points.append(Point(dial=name, value=own, own=True, errors=same))
            else:
                points.append(_point(limit, name, value, setting))
    return points


def _tried(dial: Dial, own: float, ascending: bool) -> dict[float, float]:
    """Settings of a dial by their values, and the own value; from easy to hard, or ascending."""
    if dial.multiples:
        found = {own * s if dial.value else own / s: s for s in dial.tried} | {own: 1.0}
    else:  # the design's own value stands for those beside it
        near = 0.02 * max(abs(own), 0.5)
        found = {value: value for value in dial.tried if abs(value - own) > near} | {own: own}
    if not ascending:
        return found
    return dict(sorted((v if v == own else round(v, 6), s) for v, s in found.items()))


def _point(limit: BodyLimit, name: str, value: float, setting: float) -> Point:
    """Limits of a changed design."""
    measure, errors, note = DIALS[name].value, {}, ""
    try:
        if measure is None:
            errors = limit.errors(limit.design, value)
        else:
            changed = DIALS[name].change(limit.design, setting)
            value = measure(changed)
            errors = limit.errors(changed, limit.levels)
    except UserError as error:
        note = str(error)
    return Point(dial=name, value=value, own=False, errors=errors, note=note)


def needed(points: list[Point], wanted: float, nearest: bool) -> float | None:
    """Value of a dial at which the error of Γ is as small as wanted; None if no value is enough.

    Between two points the error is taken as a power of the value, or exponential in it for the
    nearest one. Values outside the points are not considered.

    Parameters
    ----------
    points: of one dial, from easy to hard, or ascending for the nearest one
    wanted: deviation of Γ
    nearest: take the nearest to the design's own in place of the easiest
    """
    known = [p for p in points if not math.isnan(p.error())]
    ways = [known]
    if nearest:
        own = [k for k, p in enumerate(known) if p.own]
        ways = [way for k in own for way in (known[k:], known[k::-1])]
    found = [hit for way in ways if (hit := _first(way, wanted, nearest)) is not None]
    return min(found)[1] if found else None


def _first(way: list[Point], wanted: float, linear: bool) -> tuple[int, float] | None:
    """Number of the first point of a way whose error of Γ is small enough, and the value needed."""
    k = next((k for k, p in enumerate(way) if p.error() <= wanted), None)
    if not k:
        return None if k is None else (k, way[k].value)
    before, after = way[k - 1], way[k]
    part = math.log(before.error() / wanted) / math.log(before.error() / after.error())
    if linear:
        return k, before.value + part * (after.value - before.value)
    return k, float(before.value * (after.value / before.value) ** part)


def write_table(
    limits: Mapping[str, BodyLimit], sweeps: dict[str, list[Point]], path: Path
) -> None:
    """Write every point of every sensor's sweep as CSV."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        errors = next(iter(limits.values())).ERRORS
        writer.writerow(["sensor", "dial", "value", "unit", "own", *errors, "note"])
        for sensor, points in sweeps.items():
            for p in points:
                numbers = [f"{p.errors[name]:.6g}" if p.errors else "" for name in errors]
                at = (f"{p.value:.6g}", DIALS[p.dial].unit, int(p.own))
                writer.writerow([sensor, p.dial, *at, *numbers, p.note])


def draw(
    limits: Mapping[str, BodyLimit], sweeps: dict[str, list[Point]], title: str, path: Path
) -> None:
    """Draw sweeps by sensor, and the precision of single marker pairs where it is known, as PNG."""
    body = next(iter(limits.values()))
    pairs = [limit.pair_errors() for limit in limits.values()]
    panels = [*product(body.DIALS[:_DRAWN], body.CURVES)]
    rows = (len(panels) + len(pairs[0][1])) // 2
    figure = new_figure(title, WIDTH, 5.0 + 1.2 * rows)
    axes = figure.subplots(rows, 2).ravel()
    first: dict[str, Axes] = {}
    for axis, (name, curve) in zip(axes, panels, strict=False):
        axis.sharey(first.setdefault(curve[0], axis))
        _draw_curve(axis, name, curve, sweeps)
    for axis, way in zip(axes[len(panels) :], pairs[0][1], strict=True):
        for look, (angle, shown) in zip(LOOKS, pairs, strict=False):
            axis.plot(angle, 1e6 * shown[way], **look | {"ls": "", "ms": 2.5})
        axis.set(xlabel="angle from the apex [°]", ylabel=f"one pair shows,\n{way} [µm]")
        axis.set_xlim(left=0.0)
    for axis in axes:
        axis.set_yscale("log")
        plain_ticks(axis.yaxis)
        axis.tick_params(labelsize=8)
        axis.grid(alpha=0.3, which="both")
    lines = legend_of(limits)
    if "margin_bound" in body.ERRORS:
        text = "dotted: by the noise alone, no misfit"
        lines.append(Line2D([], [], color="0.4", label=text, **_BOUND))
    legend_below(figure, lines, 3)
    path.write_bytes(png(figure))


def _draw_curve(
    axis: Axes, name: str, curve: tuple[str, str, float], sweeps: dict[str, list[Point]]
) -> None:
    """Draw an error over a dial."""
    error, label, factor = curve
    for look, points in zip(LOOKS, sweeps.values(), strict=False):
        mine = [p for p in points if p.dial == name]
        for some, size in ((mine, 4), ([p for p in mine if p.own], 10)):
            values = [factor * p.error(error) for p in some]
            axis.plot([p.value for p in some], values, ms=size, **look)
        if error == "margin_error":
            bound = [p.error("margin_bound") for p in mine]
            axis.plot([p.value for p in mine], bound, **_BOUND | {"color": look["color"]})
    axis.set_xlabel(DIALS[name].axis, fontsize=9)
    axis.set_ylabel(label, fontsize=9)
    if DIALS[name].multiples:
        axis.set_xscale("log")
        plain_ticks(axis.xaxis)


def legend_of(sensors: Iterable[str]) -> list[Line2D]:
    """The look of each sensor, and of its own value."""
    lines = [
        Line2D([], [], ms=4, label=name, **look) for look, name in zip(LOOKS, sensors, strict=False)
    ]
    own = "large: the design as it is"
    return [*lines, Line2D([], [], color="0.4", marker="o", ms=10, ls="", label=own)]
