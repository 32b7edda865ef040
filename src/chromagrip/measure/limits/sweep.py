"""Limit of Γ over marker count, resolution, noise and marker size: chart, table, and needs."""

import csv
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from msgspec.structs import replace
from numpy.typing import NDArray

from ...errors import UserError
from ...output.figure import WIDTH, legend_below, new_figure, plain_ticks, png
from ...render import Membrane, SensorDesign, areas, centroids, outlines, rest_membrane
from ...render.design import Geodesic
from .forces import Press, force_limit, pair_covariance

Array = NDArray[np.float64]

#: Multiples of a design's own value, from the easiest to make to the hardest.
STEPS = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0)
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


@dataclass(frozen=True, kw_only=True)
class Point:
    """One design of a sweep.

    Attributes
    ----------
    dial: key of DIALS
    value: of the dial
    own: whether it is the unchanged design
    margin: smallest standard deviation of Γ; NaN for an impossible design
    note: reason why it is impossible
    """

    dial: str
    value: float
    own: bool
    margin: float
    note: str = ""


def _more_markers(sensor: SensorDesign, noise: float, share: float) -> tuple[SensorDesign, float]:
    plan = sensor.layout
    if not isinstance(plan, Geodesic):
        raise UserError("only a geodesic layout can have another count")
    pitch = plan.meridian_pitch_mm / np.sqrt(share)
    layout = replace(plan, count=round(plan.count * share), meridian_pitch_mm=pitch)
    return replace(sensor, layout=layout), noise


def _more_pixels(sensor: SensorDesign, noise: float, share: float) -> tuple[SensorDesign, float]:
    """More pixels, with the same blur in pixels."""
    old = sensor.camera
    if old.focal_px is None:
        raise UserError("a camera from a calibration file has its own resolution")
    fx, fy = old.focal_px
    camera = replace(
        old,
        width_px=round(old.width_px * share),
        height_px=round(old.height_px * share),
        focal_px=(fx * share, fy * share),
        centre_px=old.centre_px and tuple((c + 0.5) * share - 0.5 for c in old.centre_px),
    )
    return replace(sensor, camera=camera), noise


def _larger_markers(sensor: SensorDesign, noise: float, share: float) -> tuple[SensorDesign, float]:
    magenta, yellow = (replace(layer, size_mm=layer.size_mm * share) for layer in sensor.layers)
    return replace(sensor, magenta=magenta, yellow=yellow), noise


def _less_noise(sensor: SensorDesign, noise: float, share: float) -> tuple[SensorDesign, float]:
    return sensor, noise / share


@dataclass(frozen=True, kw_only=True)
class Dial:
    """One property of a design that is varied.

    Attributes
    ----------
    label: of its axis
    unit: of its value
    change: the design and noise with a multiple of it
    value: of a design and noise
    """

    label: str
    unit: str
    change: Callable[[SensorDesign, float, float], tuple[SensorDesign, float]]
    value: Callable[[SensorDesign, float], float]


DIALS = {
    "markers": Dial(
        label="marker pairs", unit="", change=_more_markers, value=lambda s, n: len(s.places)
    ),
    "height": Dial(
        label="image height",
        unit="px",
        change=_more_pixels,
        value=lambda s, n: s.camera.height_px,
    ),
    "size": Dial(
        label="marker size",
        unit="mm",
        change=_larger_markers,
        value=lambda s, n: s.magenta.size_mm,
    ),
    "noise": Dial(label="noise", unit="levels", change=_less_noise, value=lambda s, n: n),
}


def sweep(
    sensor: SensorDesign,
    pressed: Press,
    noise: float,
    *,
    frames: int = 1,
    dials: Iterable[str] = DIALS,
    progress: Callable[[str], None] = lambda text: None,
) -> list[Point]:
    """Limits of Γ of a design with one property changed; arguments as of `force_limit`."""
    points = []
    for name in dials:
        dial = DIALS[name]
        own = dial.value(sensor, noise)
        for share in STEPS:
            value = own / share if name == "noise" else own * share
            progress(f"{dial.label} {value:.3g} {dial.unit}")
            margin, note = np.nan, ""
            try:
                changed, level = dial.change(sensor, noise, share)
                value = dial.value(changed, level)
                margin = force_limit(changed, pressed, level, frames=frames).margin
            except UserError as error:
                note = str(error)
            points.append(Point(dial=name, value=value, own=share == 1.0, margin=margin, note=note))
    return points


def needed(points: list[Point], wanted: float) -> float | None:
    """Easiest value of a dial at which the error of Γ is as small as wanted; None if there is none.

    The points of one dial are in the order of `sweep`, from easy to hard. Between two points the
    error is taken as a power of the value; values before the first point are not considered.
    """
    before: Point | None = None
    for point in points:
        if np.isnan(point.margin):
            continue
        if point.margin <= wanted:
            if before is None:
                return point.value
            share = np.log(before.margin / wanted) / np.log(before.margin / point.margin)
            return float(before.value * (point.value / before.value) ** share)
        before = point
    return None


def pair_precision(sensor: SensorDesign, noise: float) -> tuple[Array, Array, Array]:
    """Precision of the displacement of the skin from one marker pair at rest.

    Returns
    -------
    angle: from the apex [°], shape (M,)
    radial, along: standard deviations of a displacement of the skin [m], shape (M,)
    """
    rest, nudge = rest_membrane(sensor), 1e-6
    radial, azimuthal = rest.normals[0], sensor.shape.tangents(sensor.places)[1]
    columns = []
    for axis in (radial, np.cross(azimuthal, radial), azimuthal):
        shown = []
        for sign in (nudge, -nudge):
            shift = sign * sensor.follow[:, None, None] * axis
            image = outlines(Membrane(centres=rest.centres + shift, axes=rest.axes), sensor.view)
            size = 0.5 * np.log(areas(image, square=False))
            both = np.concatenate([centroids(image, square=False), size[..., None]], axis=-1)
            shown.append(np.swapaxes(both, 0, 1).reshape(-1, 6))
        columns.append((shown[0] - shown[1]) / (2 * nudge))
    slope = np.stack(columns, axis=-1)
    covariance = noise**2 * pair_covariance(sensor, np.zeros((11, 2)))
    moved = np.linalg.inv(np.swapaxes(slope, -1, -2) @ np.linalg.inv(covariance) @ slope)
    angle = np.rad2deg(sensor.places[:, 0])
    return angle, np.sqrt(moved[:, 0, 0]), np.sqrt(moved[:, 1, 1])


def write_table(sweeps: dict[str, list[Point]], path: Path) -> None:
    """Every point of every sensor's sweep as CSV."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["sensor", "dial", "value", "unit", "own", "margin_error", "note"])
        for sensor, points in sweeps.items():
            for p in points:
                margin = "" if np.isnan(p.margin) else f"{p.margin:.6g}"
                row = [p.dial, f"{p.value:.6g}", DIALS[p.dial].unit, int(p.own), margin, p.note]
                writer.writerow([sensor, *row])


def draw(
    sensors: dict[str, SensorDesign],
    sweeps: dict[str, list[Point]],
    noise: float,
    title: str,
    path: Path,
) -> None:
    """Chart of sweeps by sensor, and of the precision of a single pair of each, as PNG."""
    figure = new_figure(title, WIDTH, 8.6)
    axes = figure.subplots(3, 2).ravel()
    for axis, (name, dial) in zip(axes[:4], DIALS.items(), strict=True):
        axis.sharey(axes[0])
        for look, points in zip(LOOKS, sweeps.values(), strict=False):
            mine = [p for p in points if p.dial == name]
            axis.plot([p.value for p in mine], [p.margin for p in mine], ms=4, **look)
            here = [p for p in mine if p.own]
            axis.plot([p.value for p in here], [p.margin for p in here], ms=10, **look)
        unit = f" [{dial.unit}]" if dial.unit else ""
        axis.set(xscale="log", xlabel=dial.label + unit, ylabel="standard deviation of Γ")
        plain_ticks(axis.xaxis)
    for axis, number, label in ((axes[4], 1, "radially"), (axes[5], 2, "along the skin")):
        for look, sensor in zip(LOOKS, sensors.values(), strict=False):
            found = pair_precision(sensor, noise)
            some = look | {"ls": "", "ms": 2.5}
            axis.plot(found[0], 1e6 * found[number], **some)
        axis.set(xlabel="angle from the apex [°]", ylabel=f"one pair shows,\n{label} [µm]")
        axis.set_xlim(left=0.0)
    for axis in axes:
        axis.set_yscale("log")
        plain_ticks(axis.yaxis)
        axis.tick_params(labelsize=8)
        axis.grid(alpha=0.3, which="both")
    legend_below(figure, legend_of(sensors), 4)
    path.write_bytes(png(figure))


def legend_of(sensors: Iterable[str]) -> list[Line2D]:
    """The look of each sensor, and of its own value."""
    lines = [
        Line2D([], [], ms=4, label=name, **look) for look, name in zip(LOOKS, sensors, strict=False)
    ]
    own = "large: the design as it is"
    return [*lines, Line2D([], [], color="0.4", marker="o", ms=10, ls="", label=own)]
