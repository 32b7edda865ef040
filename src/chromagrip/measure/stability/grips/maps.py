"""The maps of a dome and of two fingers: their axes, and the boundaries that analysis gives."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..maps import Line, place
from .cells import Setting
from .predicted import (
    farthest,
    grip_range,
    heaviest,
    reached,
    slowest_rate,
    slowest_reaction,
)

#: Camera rates [Hz] and latencies [frames].
_RATES = (120.0, 60.0, 30.0, 20.0, 15.0, 10.0, 7.5, 5.0)
_LATENCIES = (0, 1, 2, 3)
#: Masses [g], friction coefficients, and offsets of the centre of mass [mm].
_MASSES = (50.0, 100.0, 200.0, 300.0, 400.0, 600.0, 1000.0, 1600.0)
_MU = (0.15, 0.3, 0.5, 0.9)
_OFFSETS = (2.0, 4.0, 8.0, 12.0)
_TURNED_MASSES = (50.0, 100.0, 200.0, 400.0)
#: Loads of a dome that are mapped [N], and masses of a pinch [g].
_LOADS = (0.5, 2.0)
_LIFTED = (200.0, 600.0)
#: Points of a predicted curve.
_FINE = 40
#: Controllers that follow the load.
_FOLLOWING = ("safety-margin", "margin-inversion")
#: Labels of the boundaries, with their line styles.
LOOP = "slowest stable rate of the linearised loop"
REACTION = "slowest rate whose commands come before a slide of 5 mm"
WEIGHT_START = "2µF = mg at the grip of the start"
WEIGHT_REACHED = "2µF = mg at the grip reached before a slide of 5 mm, at least"
SURFACE_START = "limit surface at the grip of the start"
SURFACE_MOST = "limit surface at the largest grip"
#: Line style of each.
STYLES = {
    LOOP: "-",
    REACTION: "--",
    WEIGHT_START: ":",
    WEIGHT_REACHED: "-",
    SURFACE_START: ":",
    SURFACE_MOST: "-",
}


@dataclass(frozen=True, kw_only=True)
class Panel:
    """One field of a map.

    Attributes
    ----------
    title: of the panel
    base: setting that all of its cells share but for the two axes
    """

    title: str
    base: Setting


@dataclass(frozen=True, kw_only=True)
class Map:
    """Panels of one kind.

    Attributes
    ----------
    title: over the picture
    x, y: attributes of a Setting that change along the axes
    x_label, y_label: with units
    x_values, y_values: of the axes
    panels: of the map
    lines: boundaries of a panel by analysis
    number: attribute of a Cell that a cell shows, with its meaning; none shows letters only
    """

    title: str
    x: str
    y: str
    x_label: str
    y_label: str
    x_values: tuple[float, ...]
    y_values: tuple[float, ...]
    panels: tuple[Panel, ...]
    lines: Callable[["Map", Panel], list[Line]]
    number: tuple[str, str] | None = None

    def at(self, panel: Panel, x: float, y: float) -> Setting:
        """Setting of one cell."""
        return replace(panel.base, **{self.x: x, self.y: y})  # type: ignore[arg-type]

    def settings(self) -> list[Setting]:
        """Every setting."""
        return [
            self.at(panel, x, y)
            for panel in self.panels
            for y in self.y_values
            for x in self.x_values
        ]


def maps(world: str, quick: bool) -> dict[str, Map]:
    """Every map of a world by name; a quick one has a few cells of each."""
    if world == "dome":
        # Margin Inversion has no memory that could swing.
        bases = [Setting(world="dome", controller="safety-margin", load_n=load) for load in _LOADS]
        titles = [f"safety-margin, {base.load_n:g} N" for base in bases]
        return {"rate-latency": _rates(quick, "one dome and a load", titles, bases)}
    bases = [
        Setting(world="pinch", controller=name, mass_g=mass)
        for mass in _LIFTED
        for name in _FOLLOWING
    ]
    titles = [f"{base.controller}, {base.mass_g:g} g" for base in bases]
    return {
        "rate-latency": _rates(quick, "two fingers that lift an object", titles, bases),
        "mass-friction": _masses(quick),
        "offset-mass": _offsets(quick),
    }


def _few(values: tuple[float, ...], quick: bool) -> tuple[float, ...]:
    return values[::3] if quick else values


def _rates(quick: bool, what: str, titles: Sequence[str], bases: Sequence[Setting]) -> Map:
    panels = [Panel(title=title, base=base) for title, base in zip(titles, bases, strict=True)]
    return Map(
        title=f"Camera rate and latency, {what}",
        x="rate_hz",
        y="latency_frames",
        x_label="frames per second",
        y_label="latency [frames]",
        x_values=_few(_RATES, quick),
        y_values=_LATENCIES[1:2] if quick else _LATENCIES,
        panels=tuple(panels[:2] if quick else panels),
        lines=_rate_lines,
    )


def _controllers(names: Sequence[str]) -> tuple[Panel, ...]:
    """A panel for each controller; its title says which grips it can choose from."""
    panels = []
    for name in names:
        base = Setting(world="pinch", controller=name)
        start, most = grip_range(base.scene())
        words = f"{start:g} N" if start == most else f"{start:g} N on the table"
        if start < most < math.inf:
            words += f", {most:g} N at most"
        panels.append(Panel(title=f"{name}, {words}", base=base))
    return tuple(panels)


def _masses(quick: bool) -> Map:
    return Map(
        title="Mass and friction of the object that two fingers lift",
        x="mass_g",
        y="friction",
        x_label="mass [g]",
        y_label="µ",
        x_values=_few(_MASSES, quick),
        y_values=_few(_MU, quick),
        panels=_controllers(_FOLLOWING),
        lines=_mass_lines,
        number=("grip_n", "grip at the end [N]"),
    )


def _offsets(quick: bool) -> Map:
    return Map(
        title="Centre of mass beside the fingers, and mass",
        x="offset_mm",
        y="mass_g",
        x_label="offset of the centre of mass [mm]",
        y_label="mass [g]",
        x_values=_few(_OFFSETS, quick),
        y_values=_few(_TURNED_MASSES, quick),
        panels=_controllers((*_FOLLOWING, "conservative")),
        lines=_offset_lines,
        number=("turn_deg", "largest turn in the hand [°]"),
    )


def _rate_lines(which: Map, panel: Panel) -> list[Line]:
    """Slowest rates at each latency: of a loop that does not swing, and of one that is in time.

    Margin Inversion has no memory that could swing.
    """
    bounds = {}
    if panel.base.controller == "safety-margin":
        bounds[LOOP] = slowest_rate
    if panel.base.world == "pinch":
        bounds[REACTION] = slowest_reaction
    # Rates fall along the axis, periods grow.
    periods = [1.0 / rate for rate in which.x_values]
    lines = []
    for label, slowest in bounds.items():
        for row, latency in enumerate(which.y_values):
            rate = slowest(replace(panel.base, latency_frames=int(latency)))
            if math.isfinite(rate):
                x = place(periods, np.full(2, 1.0 / rate))
                lines.append(Line(label=label, x=x, y=np.array([row - 0.5, row + 0.5])))
    return lines


def _mass_lines(which: Map, panel: Panel) -> list[Line]:
    """Mass at which friction under a grip no longer bears the weight."""
    rows = np.arange(len(which.y_values), dtype=float)
    start, _ = grip_range(panel.base.scene())
    lines = []
    for label, grip in ((WEIGHT_START, start), (WEIGHT_REACHED, reached(panel.base))):
        masses = np.array([heaviest(mu, grip) for mu in which.y_values])
        lines.append(Line(label=label, x=place(which.x_values, masses), y=rows))
    return lines


def _offset_lines(which: Map, panel: Panel) -> list[Line]:
    """Offset at which friction and torsion together no longer bear the weight."""
    masses = np.geomspace(which.y_values[0] / 1.2, which.y_values[-1] * 1.2, _FINE)
    start, most = grip_range(panel.base.scene())
    lines = []
    for label, grip in ((SURFACE_START, start), (SURFACE_MOST, most)):
        if math.isfinite(grip):
            ways = np.array([farthest(replace(panel.base, mass_g=float(m)), grip) for m in masses])
            known = np.isfinite(ways)
            x, y = place(which.x_values, ways[known]), place(which.y_values, masses[known])
            lines.append(Line(label=label, x=x, y=y))
    return lines
