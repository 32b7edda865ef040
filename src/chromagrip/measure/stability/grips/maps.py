"""The maps of a dome and of two fingers: their axes, and the boundaries that analysis gives."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .. import panels
from ..panels import Line, place
from .cells import GripSetting, World
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
#: Panels in a row.
_COLUMNS = 2
#: Number that a cell shows, with its meaning: a grip that is far too strong holds as well.
_GRIP = ("grip_n", "grip at the end [N]")
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


#: Field of a map, and a map, of grips.
Panel = panels.Panel[GripSetting]
Map = panels.Map[GripSetting]


def maps(world: World, quick: bool, own: Sequence[str] = ()) -> dict[str, Map]:
    """Every map of a world by name; a quick one has a few cells of each.

    Parameters
    ----------
    own: further controllers, which all maps show beside ours
    """
    return {"dome": _dome_maps, "pinch": _pinch_maps}[world](quick, own)


def _dome_maps(quick: bool, own: Sequence[str]) -> dict[str, Map]:
    bases = [
        GripSetting(world="dome", controller=name, load_n=load)
        for name in (*_FOLLOWING, *own)
        for load in (_LOADS[:1] if quick else _LOADS)
    ]
    titles = [f"{base.controller}, {base.load_n:g} N" for base in bases]
    return {"rate-latency": _rates(quick, "one dome and a load", titles, bases)}


def _pinch_maps(quick: bool, own: Sequence[str]) -> dict[str, Map]:
    bases = [
        GripSetting(world="pinch", controller=name, mass_g=mass)
        for mass in (_LIFTED[:1] if quick else _LIFTED)
        for name in (*_FOLLOWING, *own)
    ]
    titles = [f"{base.controller}, {base.mass_g:g} g" for base in bases]
    return {
        "rate-latency": _rates(quick, "two fingers that lift an object", titles, bases),
        "mass-friction": _masses(quick, own),
        "offset-mass": _offsets(quick, own),
    }


def _few(values: tuple[float, ...], quick: bool) -> tuple[float, ...]:
    return values[::3] if quick else values


def _rates(quick: bool, what: str, titles: Sequence[str], bases: Sequence[GripSetting]) -> Map:
    latencies = _LATENCIES[1:2] if quick else _LATENCIES
    fields = [
        Panel(title=title, base=base, x=_few(_RATES, quick), y=latencies)
        for title, base in zip(titles, bases, strict=True)
    ]
    return Map(
        title=f"Camera rate and latency, {what}",
        x="rate_hz",
        y="latency_frames",
        x_label="frames per second",
        y_label="latency [frames]",
        columns=_COLUMNS,
        panels=tuple(fields),
        lines=_rate_lines,
        number=_GRIP,
    )


def _controllers(
    names: Sequence[str], x: tuple[float, ...], y: tuple[float, ...]
) -> tuple[Panel, ...]:
    """A panel for each controller; its title says which grips it can choose from."""
    fields = []
    for name in names:
        base = GripSetting(world="pinch", controller=name)
        start, most = grip_range(base.scene())
        words = f"{start:g} N" if start == most else f"{start:g} N on the table"
        if start < most < math.inf:
            words += f", {most:g} N at most"
        fields.append(Panel(title=f"{name}, {words}", base=base, x=x, y=y))
    return tuple(fields)


def _masses(quick: bool, own: Sequence[str]) -> Map:
    return Map(
        title="Mass and friction of the object that two fingers lift",
        x="mass_g",
        y="friction",
        x_label="mass [g]",
        y_label="µ",
        columns=_COLUMNS,
        panels=_controllers((*_FOLLOWING, *own), _few(_MASSES, quick), _few(_MU, quick)),
        lines=_mass_lines,
        number=_GRIP,
    )


def _offsets(quick: bool, own: Sequence[str]) -> Map:
    names = (*_FOLLOWING, "conservative", *own)
    return Map(
        title="Centre of mass beside the fingers, and mass",
        x="offset_mm",
        y="mass_g",
        x_label="offset of the centre of mass [mm]",
        y_label="mass [g]",
        columns=_COLUMNS,
        panels=_controllers(names, _few(_OFFSETS, quick), _few(_TURNED_MASSES, quick)),
        lines=_offset_lines,
        number=("turn_deg", "largest turn in the hand [°]"),
    )


def _rate_lines(panel: Panel) -> list[Line]:
    """Slowest rates at each latency: of a loop that does not swing, and of one that is in time.

    Margin Inversion has no memory that could swing.
    """
    bounds = {"dome": {}, "pinch": {REACTION: slowest_reaction}}[panel.base.world]
    if panel.base.controller == "safety-margin":
        bounds[LOOP] = slowest_rate
    # Rates fall along the axis, periods grow.
    periods = [1.0 / rate for rate in panel.x]
    lines = []
    for label, slowest in bounds.items():
        for row, latency in enumerate(panel.y):
            rate = slowest(replace(panel.base, latency_frames=int(latency)))
            if math.isfinite(rate):
                x = place(periods, np.full(2, 1.0 / rate))
                lines.append(Line(label=label, x=x, y=np.array([row - 0.5, row + 0.5])))
    return lines


def _mass_lines(panel: Panel) -> list[Line]:
    """Mass at which friction under a grip no longer bears the weight."""
    rows = np.arange(len(panel.y), dtype=float)
    start, _ = grip_range(panel.base.scene())
    lines = []
    for label, grip in ((WEIGHT_START, start), (WEIGHT_REACHED, reached(panel.base))):
        masses = np.array([heaviest(float(mu), grip) for mu in panel.y])
        lines.append(Line(label=label, x=place(panel.x, masses), y=rows))
    return lines


def _offset_lines(panel: Panel) -> list[Line]:
    """Offset at which friction and torsion together no longer bear the weight."""
    mapped = [float(mass) for mass in panel.y]
    masses = np.geomspace(mapped[0] / 1.2, mapped[-1] * 1.2, _FINE)
    start, most = grip_range(panel.base.scene())
    lines = []
    for label, grip in ((SURFACE_START, start), (SURFACE_MOST, most)):
        if math.isfinite(grip):
            ways = np.array([farthest(replace(panel.base, mass_g=float(m)), grip) for m in masses])
            known = np.isfinite(ways)
            x, y = place(panel.x, ways[known]), place(mapped, masses[known])
            lines.append(Line(label=label, x=x, y=y))
    return lines
