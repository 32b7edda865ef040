"""Limits over depths of the layers, size and number of markers, resolution, camera and noise."""

import csv
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from msgspec import structs

from ....errors import UserError
from ....output.figure import WIDTH, legend_below, new_figure, plain_ticks, png
from ....render import SensorDesign
from ....render.design import Geodesic, Spiral
from ..sweep import DIALS as CHAIN_DIALS
from ..sweep import LOOKS, STEPS, legend_of
from .held import Grip
from .limit import Noise, Seen
from .report import NOISES, dome_of, held_by

Change = Callable[[SensorDesign, float], SensorDesign]

#: Look of the bound.
_BOUND: dict[str, Any] = {"ls": ":", "marker": "", "lw": 1.2}
#: Depths of both layers that are tried, over the silicone's thickness, and places of the camera
#: over the radius of the hollow, towards the apex.
OUTER = (0.05, 0.1, 0.17, 0.25, 0.35, 0.5)
INNER = (0.25, 0.35, 0.5, 0.65, 0.8, 0.95, 1.0)
PLACES = (-0.4, -0.2, 0.0, 0.2, 0.4, 0.6)
#: The inner layer lies at least so much deeper than the outer one, over the thickness.
_APART = 0.05


@dataclass(frozen=True, kw_only=True)
class DomePoint:
    """One design of a sweep.

    Attributes
    ----------
    dial: key of DOME_DIALS
    value: of the dial
    own: whether it is the unchanged design
    margin_bound: deviation of Γ of a contact at the bound; NaN for an impossible design
    margin: the same with the misfit
    normal: deviation of F_n of free tractions in the known zone, with the misfit [N]
    note: reason why it is impossible
    """

    dial: str
    value: float
    own: bool
    margin_bound: float = math.nan
    margin: float = math.nan
    normal: float = math.nan
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class DomeDial:
    """One property of a design that is varied; the noise is changed apart.

    Attributes
    ----------
    label, unit: of its value
    tried: values, from the easiest to make where there is an order
    multiples: whether they are multiples of the design's own
    change: the design with a value
    value: of a design; None is that of the noise
    """

    label: str
    unit: str
    tried: tuple[float, ...]
    multiples: bool
    change: Change
    value: Callable[[SensorDesign], float] | None


def _depths(sensor: SensorDesign, outer: float | None, inner: float | None) -> SensorDesign:
    thickness = 1e3 * dome_of(sensor).thickness
    depths = [outer, inner]
    layers = [
        layer if depth is None else structs.replace(layer, depth_mm=depth * thickness)
        for layer, depth in zip(sensor.layers, depths, strict=True)
    ]
    if layers[1].depth_mm - layers[0].depth_mm < _APART * thickness:
        raise UserError("the inner layer would not lie below the outer one")
    return structs.replace(sensor, magenta=layers[0], yellow=layers[1])


def _share(layer: int) -> Callable[[SensorDesign], float]:
    return lambda s: float(s.depths[layer]) / dome_of(s).thickness


def _camera_at(sensor: SensorDesign, place: float) -> SensorDesign:
    """The camera elsewhere on the axis, with a lens by which the markers fill as much of it."""
    camera = sensor.camera
    if camera.focal_px is None:
        raise UserError("a camera from a calibration file has its own lens")
    hollow = 1e3 * sensor.view.port
    points = np.concatenate([sensor.shape.points(sensor.places, depth) for depth in sensor.depths])
    middle = sensor.view.project(np.array([[0.0, 0.0, sensor.shape.radius]]))
    moved = replace(sensor.view, position=1e-3 * place * hollow)
    reach = [
        float(np.linalg.norm(view.project(points) - middle, axis=-1).max())
        for view in (sensor.view, moved)
    ]
    fx, fy = (reach[0] / reach[1] * focal for focal in camera.focal_px)
    camera = structs.replace(camera, position_mm=place * hollow, focal_px=(fx, fy))
    return structs.replace(sensor, camera=camera)


def _more_markers(sensor: SensorDesign, share: float) -> SensorDesign:
    plan = sensor.layout
    if isinstance(plan, Spiral):
        plan = structs.replace(plan, count=round(plan.count * share))
        return structs.replace(sensor, layout=plan)
    if isinstance(plan, Geodesic):
        return CHAIN_DIALS["markers"].change(sensor, 1.0, share)[0]
    raise UserError("only a spiral or a geodesic layout can have another count")


DOME_DIALS = {
    "outer": DomeDial(
        label="depth of the outer layer",
        unit="thicknesses",
        tried=OUTER,
        multiples=False,
        change=lambda s, depth: _depths(s, depth, None),
        value=_share(0),
    ),
    "inner": DomeDial(
        label="depth of the inner layer",
        unit="thicknesses",
        tried=INNER,
        multiples=False,
        change=lambda s, depth: _depths(s, None, depth),
        value=_share(1),
    ),
    "size": DomeDial(
        label="marker size",
        unit="mm",
        tried=STEPS,
        multiples=True,
        change=lambda s, share: CHAIN_DIALS["size"].change(s, 1.0, share)[0],
        value=lambda s: s.magenta.size_mm,
    ),
    "height": DomeDial(
        label="image height",
        unit="px",
        tried=STEPS,
        multiples=True,
        change=lambda s, share: CHAIN_DIALS["height"].change(s, 1.0, share)[0],
        value=lambda s: s.camera.height_px,
    ),
    "camera": DomeDial(
        label="camera towards the apex",
        unit="hollows",
        tried=PLACES,
        multiples=False,
        change=_camera_at,
        value=lambda s: 1e-3 * s.camera.position_mm / s.view.port,
    ),
    "markers": DomeDial(
        label="marker pairs",
        unit="",
        tried=STEPS,
        multiples=True,
        change=_more_markers,
        value=lambda s: len(s.places),
    ),
    "noise": DomeDial(
        label="noise",
        unit="levels",
        tried=tuple(1.0 / share for share in STEPS),
        multiples=True,
        change=lambda s, share: s,
        value=None,
    ),
}
#: Dials that the chart has a column for.
_DRAWN = ("outer", "inner", "size", "height", "camera")


def sweep_dome(
    sensor: SensorDesign,
    grip: Grip,
    noises: dict[str, Noise],
    *,
    dials: Iterable[str] = DOME_DIALS,
    progress: Callable[[str], None] = lambda text: None,
) -> list[DomePoint]:
    """Limits of a design with one property changed; arguments as of `dome_limit`.

    The contact is that of the design: it does not depend on markers and camera.
    """
    held = held_by(dome_of(sensor), grip)
    designed = Seen(sensor, held)
    points = []
    for name in dials:
        dial = DOME_DIALS[name]
        before = dial.value(sensor) if dial.value else noises[NOISES[0]].levels
        unit = before if dial.multiples else 1.0
        values = {round(unit * tried, 6): tried for tried in dial.tried}
        near = [v for v in values if abs(v - before) <= 0.02 * max(abs(before), 0.5)]
        for close in near:  # the design's own value stands for those beside it
            del values[close]
        values[before] = before / unit
        for value in sorted(values):
            progress(f"{dial.label} {value:.3g} {dial.unit}")
            some = noises
            if name == "noise":
                some = {key: replace(noise, levels=value) for key, noise in noises.items()}
            own = value == before
            try:
                seen, at = designed, value
                if not own and dial.value:
                    changed = dial.change(sensor, values[value])
                    seen, at = Seen(changed, held), dial.value(changed)
                points.append(_point(name, at, own, seen, some))
            except UserError as error:
                points.append(DomePoint(dial=name, value=value, own=own, note=str(error)))
    return points


def _point(dial: str, value: float, own: bool, seen: Seen, noises: dict[str, Noise]) -> DomePoint:
    bound, misfit = (noises[name] for name in NOISES)
    return DomePoint(
        dial=dial,
        value=value,
        own=own,
        margin_bound=seen.contact(bound).margin,
        margin=seen.contact(misfit).margin,
        normal=seen.tractions([misfit], seen.held.touching)[0].normal,
    )


def needed_of(points: list[DomePoint], wanted: float) -> float | None:
    """Value of a dial nearest to the design's own at which Γ, misfit included, is told as well.

    Between two points the error is taken as a power of its own; None where no value is enough.

    Parameters
    ----------
    points: of one dial
    wanted: deviation of Γ
    """
    told = sorted((p for p in points if not math.isnan(p.margin)), key=lambda p: p.value)
    start = next((k for k, p in enumerate(told) if p.own), None)
    if start is None:
        return None
    if told[start].margin <= wanted:
        return told[start].value
    found: list[tuple[int, float]] = []
    for way in (told[start:], told[start::-1]):
        for k, (before, after) in enumerate(pairwise(way)):
            if after.margin <= wanted:
                part = math.log(before.margin / wanted) / math.log(before.margin / after.margin)
                found.append((k, before.value + part * (after.value - before.value)))
                break
    return min(found)[1] if found else None


def write_dome_table(sweeps: dict[str, list[DomePoint]], path: Path) -> None:
    """Every point of every sensor's sweep as CSV."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        header = ["sensor", "dial", "value", "unit", "own", "margin_bound", "margin_error"]
        writer.writerow([*header, "normal_error_n", "note"])
        for sensor, points in sweeps.items():
            for p in points:
                numbers = (p.margin_bound, p.margin, p.normal)
                told = ["" if math.isnan(number) else f"{number:.6g}" for number in numbers]
                unit = DOME_DIALS[p.dial].unit
                writer.writerow([sensor, p.dial, f"{p.value:.6g}", unit, int(p.own), *told, p.note])


def draw_dome(sweeps: dict[str, list[DomePoint]], title: str, path: Path) -> None:
    """Chart of sweeps by sensor as PNG: Γ of a contact, and F_n of free tractions."""
    figure = new_figure(title, WIDTH, 11.0)
    axes = figure.subplots(len(_DRAWN), 2, sharex="row", sharey="col")
    for row, name in enumerate(_DRAWN):
        dial = DOME_DIALS[name]
        for look, points in zip(LOOKS, sweeps.values(), strict=False):
            mine = [p for p in points if p.dial == name]
            at = [p.value for p in mine]
            columns = ([p.margin for p in mine], [1e3 * p.normal for p in mine])
            for axis, values in zip(axes[row], columns, strict=True):
                axis.plot(at, values, ms=4, **look)
                here = [(p.value, v) for p, v in zip(mine, values, strict=True) if p.own]
                axis.plot(*zip(*here, strict=True), ms=10, **look)
            bound = [p.margin_bound for p in mine]
            axes[row, 0].plot(at, bound, **_BOUND | {"color": look["color"]})
        if dial.multiples:
            axes[row, 0].set_xscale("log")
            plain_ticks(axes[row, 0].xaxis)
        unit = f" [{dial.unit}]" if dial.unit else ""
        for axis in axes[row]:
            axis.set_xlabel(dial.label + unit, fontsize=9)
    axes[0, 0].set_title("deviation of Γ of a contact", fontsize=10)
    axes[0, 1].set_title("deviation of F_n of free tractions, zone known [mN]", fontsize=10)
    for axis in axes.ravel():
        axis.set_yscale("log")
        axis.tick_params(labelsize=8, labelbottom=True)
        axis.grid(alpha=0.3, which="both")
    for axis in axes[0]:
        plain_ticks(axis.yaxis)
    told = Line2D([], [], color="0.4", label="dotted: by the noise alone, no misfit", **_BOUND)
    legend_below(figure, [*legend_of(sweeps), told], 3)
    path.write_bytes(png(figure))
