"""The maps of the closed loop: their axes, and the boundaries that the linearised loop predicts."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq

from ...model import pressure
from ...thesis import FRICTIONS, RADII_MM, STIFFNESSES_KPA
from . import panels
from .cells import CRUSH, FIRST_LOAD, HELD, MARGIN, SWING, LoopSetting
from .linear import critical_gain, critical_integral, critical_period, held, noise_gain
from .panels import Line, place

#: Gains as printed, at the thesis's rate.
PRINTED = LoopSetting()
#: Gains as printed, at the rate and latency of a camera.
SLOW = LoopSetting(rate_hz=100.0, latency_frames=1)
#: Gains retuned for that rate (docs/controllers.md).
RETUNED = replace(SLOW, proportional_n=0.25, integral_n_per_s=30.0, window_s=0.3)
#: Controller of the scene `margin-60hz`, with its average of µ.
INVERSION = replace(SLOW, controller="margin-inversion", rate_hz=60.0, window_s=0.1)
#: Settings of shipped scenes, on the truth path with the default noise.
SHIPPED = {"thesis": PRINTED, "camera-100hz": RETUNED, "margin-60hz": INVERSION}
#: µ and radius [mm] of the thesis's object, and of the one whose plant has the largest gain.
KINDS = {"µ 0.5, flat": (0.5, math.inf), "µ 0.7, 5 mm radius": (0.7, 5.0)}
#: Points of a predicted curve.
_FINE = 60
#: Labels of the predicted boundaries.
LINEAR = "predicted by the linearised loop"
CRUSHING = "the grip for Γ = 0.3 crushes"

#: Camera rates of the map of rate and latency [Hz].
_PRINTED_RATES = (
    *(2000.0, 1600.0, 1250.0, 1000.0, 800.0, 630.0, 500.0, 400.0, 320.0, 250.0, 200.0, 160.0),
    *(125.0, 100.0),
)
_RETUNED_RATES = (160.0, 125.0, 100.0, 80.0, 63.0, 50.0, 40.0, 32.0, 25.0, 20.0, 16.0, 12.5)
#: Rate [Hz] and latency [frames] of the cells that go through the camera, with retuned gains.
_CAMERA = ((100.0, 0), (50.0, 0), (100.0, 1), (63.0, 1), (50.0, 1), (32.0, 1), (20.0, 1), (32.0, 3))
_CAMERA_SHARP = ((100.0, 1), (63.0, 1), (32.0, 1))
#: Settings under which all 27 objects are run.
PRESETS = {
    "printed, 1 kHz, no latency": PRINTED,
    "printed, 100 Hz, 1 frame": SLOW,
    "retuned, 100 Hz, 1 frame": RETUNED,
    "retuned, 60 Hz, 1 frame": replace(RETUNED, rate_hz=60.0),
    "retuned, 30 Hz, 1 frame": replace(RETUNED, rate_hz=30.0),
}
#: Settings of the maps of load and noise.
_AT_RATES = {"1 kHz, no latency, printed": PRINTED, "100 Hz, one frame, retuned": RETUNED}
#: Gains Kp [N] and Ki [N/s] of the map of gains.
_FAST_KP = (0.6, 1.3, 2.5, 3.5, 5.0, 7.0)
_FAST_KI = (25.0, 100.0, 200.0, 400.0, 800.0, 1600.0)
_SLOW_KP = (0.04, 0.08, 0.15, 0.25, 0.4, 0.6, 0.9, 1.3)
_SLOW_KI = (6.0, 12.0, 20.0, 30.0, 42.0, 60.0, 85.0, 120.0)
#: Steps of the load [N].
_STEPS = (0.1, 0.2, 0.4, 0.5, 0.6, 0.8, 1.2)
#: Friction coefficients of the map of the load.
_MU = (0.15, 0.2, 0.3, 0.5, 0.7, 0.9)
#: Controllers of the map of noise. On a chain, which has no torsion, Limit Surface is the second.
_CONTROLLERS = ("safety-margin", "margin-inversion", "react-to-slip", "conservative")
#: Standard deviations of the noise on Γ.
_NOISES = (0.001, 0.003, 0.006, 0.012, 0.025, 0.05, 0.1)


#: Field of a map, and a map, of runs of the chain.
Panel = panels.Panel[LoopSetting]
Map = panels.Map[LoopSetting]


def _rate_lines(panel: Panel) -> list[Line]:
    """Slowest rate that is stable at each latency, of the controller that is linearised."""
    lines = []
    for row, latency in enumerate(panel.y if panel.base.predicted else ()):
        loop = replace(panel.base, latency_frames=int(latency)).linear()
        # Rates fall along the axis, periods grow.
        x = place([1.0 / rate for rate in panel.x], np.full(2, critical_period(loop)))
        lines.append(Line(label=LINEAR, x=x, y=np.array([row - 0.5, row + 0.5])))
    return lines


def _gain_lines(panel: Panel) -> list[Line]:
    """Largest Ki that is stable at each Kp."""
    proportional = np.geomspace(panel.x[0] / 1.2, panel.x[-1] * 1.2, _FINE)
    integral = np.array(
        [
            critical_integral(replace(panel.base, proportional_n=float(kp)).linear())
            for kp in proportional
        ]
    )
    y = np.full(_FINE, -0.5)  # not stable at any Ki: along the lower edge
    some = integral > 0.0
    y[some] = place([float(ki) for ki in panel.y], integral[some])
    return [Line(label=LINEAR, x=place(panel.x, proportional), y=y)]


def _load_lines(panel: Panel) -> list[Line]:
    """Largest µ that is stable, and the load that cannot be held without crushing."""
    friction = np.array([float(mu) for mu in panel.y])
    ends = np.array([-0.5, len(panel.x) - 0.5])
    lines = []
    # How far the plant's gain is from the critical one, at every µ; where that changes sign.
    spare = [
        float(np.log(critical_gain(loop) / loop.plant.gain))
        for loop in (replace(panel.base, friction=float(mu)).linear() for mu in friction)
    ]
    for k, (low, high) in enumerate(pairwise(spare)):
        if low > 0.0 >= high:
            lines.append(Line(label=LINEAR, x=ends, y=np.full(2, k + low / (low - high))))
    steps = (1.0 - MARGIN) * friction * crushing_grip(panel.base) - FIRST_LOAD
    rows = np.arange(len(friction), dtype=float)
    lines.append(Line(label=CRUSHING, x=place(panel.x, steps), y=rows))
    return lines


def crushing_grip(setting: LoopSetting) -> float:
    """Grip under which the object bears CRUSH, held at the desired margin [N]."""
    scene = setting.scene()
    tip, obj = scene.build_fingertip(), scene.build_object()

    def excess(grip: float) -> float:
        load = (1.0 - MARGIN) * setting.friction * grip
        _, field, _ = held(tip, obj, load, MARGIN)
        return pressure(field, tip.pitch) - CRUSH

    return brentq(excess, 1.0, 20.0, rtol=1e-3)


def _noise_lines(panel: Panel) -> list[Line]:
    """Noise at which the command's own swing counts as one."""
    sigma = noise_limit(panel.base)
    row = panel.y.index("safety-margin")
    x = place(panel.x, np.full(2, sigma))
    return [Line(label=LINEAR, x=x, y=np.array([row - 0.5, row + 0.5]))]


def noise_limit(setting: LoopSetting) -> float:
    """Noise on Γ with which the command of the linearised loop swings by SWING of its mean.

    Peak to peak of n samples of a normal distribution is 2·m standard deviations, m the mean of
    their largest (Cramér's asymptote).
    """
    count = HELD * setting.rate_hz
    root = np.sqrt(2.0 * np.log(count))
    largest = root - (np.log(np.log(count)) + np.log(4.0 * np.pi)) / (2.0 * root)
    grip = FIRST_LOAD / (setting.friction * (1.0 - MARGIN))
    return float(SWING * grip / (2.0 * largest * noise_gain(setting.linear())))


def maps(quick: bool, own: Sequence[str] = ()) -> dict[str, Map]:
    """Every map by name; a quick one has a few cells of each.

    Parameters
    ----------
    own: further controllers, which the maps of rate and latency and of noise show beside ours
    """
    return {
        "rate-latency": _rate_latency_map(quick, own),
        "gains": _gains_map(quick),
        "load": _load_map(quick),
        "noise": _noise_map(quick, own),
        "objects": _objects_map(quick),
    }


def _few(values: tuple[float, ...], quick: bool) -> tuple[float, ...]:
    return values[2::3] if quick else values


def _rate_latency_map(quick: bool, own: Sequence[str]) -> Map:
    kinds = list(KINDS.items())[: 1 if quick else None]
    sharp = _of_kind(RETUNED, *KINDS["µ 0.7, 5 mm radius"])
    camera = [replace(RETUNED, rate_hz=rate, latency_frames=late) for rate, late in _CAMERA]
    camera += [replace(sharp, rate_hz=rate, latency_frames=late) for rate, late in _CAMERA_SHARP]
    camera += [replace(PRINTED, rate_hz=250.0), SLOW]
    return Map(
        title="Camera rate and latency",
        x="rate_hz",
        y="latency_frames",
        x_label="frames per second",
        y_label="latency [frames]",
        columns=len(kinds),
        panels=tuple(
            Panel(
                title=f"{name} gains, {kind}",
                base=_of_kind(base, *values),
                x=_few(rates, quick),
                y=(0, 1) if quick else (0, 1, 2, 3),
            )
            for name, base, rates in (
                ("printed", PRINTED, _PRINTED_RATES),
                ("retuned", RETUNED, _RETUNED_RATES),
            )
            for kind, values in kinds
        )
        + tuple(
            Panel(
                title=f"{name}, {kind}",
                base=_of_kind(replace(INVERSION, controller=name), *values),
                x=_few(_RETUNED_RATES, quick),
                y=(0, 1) if quick else (0, 1, 2, 3),
            )
            for name in (INVERSION.controller, *own)
            for kind, values in kinds
        ),
        camera=tuple(one.through_camera() for one in (camera[2:3] if quick else camera)),
        lines=_rate_lines,
    )


def _of_kind(base: LoopSetting, friction: float, radius_mm: float) -> LoopSetting:
    return replace(base, friction=friction, radius_mm=radius_mm)


def _gains_map(quick: bool) -> Map:
    return Map(
        title="Gains",
        x="proportional_n",
        y="integral_n_per_s",
        x_label="Kp [N]",
        y_label="Ki [N/s]",
        columns=2,
        panels=tuple(
            Panel(title=title, base=base, x=_few(kp, quick), y=_few(ki, quick))
            for title, base, kp, ki in (
                ("1 kHz, no latency, µ over 0.05 s", PRINTED, _FAST_KP, _FAST_KI),
                ("100 Hz, one frame, µ over 0.3 s", RETUNED, _SLOW_KP, _SLOW_KI),
            )
        ),
        lines=_gain_lines,
    )


def _load_map(quick: bool) -> Map:
    bases = _AT_RATES | {"40 Hz, one frame, retuned": replace(RETUNED, rate_hz=40.0)}
    return Map(
        title="A step of the load from 0.25 N, and friction",
        x="step_n",
        y="friction",
        x_label="step of the load [N]",
        y_label="µ",
        columns=3,
        panels=tuple(
            Panel(title=f"{title} gains", base=base, x=_few(_STEPS, quick), y=_few(_MU, quick))
            for title, base in bases.items()
        ),
        lines=_load_lines,
    )


def _noise_map(quick: bool, own: Sequence[str]) -> Map:
    return Map(
        title="White noise on Γ, and the controller",
        x="margin_noise",
        y="controller",
        x_label="standard deviation of the noise on Γ",
        y_label="",
        columns=2,
        panels=tuple(
            Panel(
                title=f"{title} gains", base=base, x=_few(_NOISES, quick), y=(*_CONTROLLERS, *own)
            )
            for title, base in _AT_RATES.items()
        ),
        lines=_noise_lines,
    )


def _objects_map(quick: bool) -> Map:
    return Map(
        title="The 27 objects of the thesis",
        x="stiffness_kpa",
        y="radius_mm",
        x_label="stiffness [kPa]",
        y_label="radius [mm]",
        columns=3,
        panels=tuple(
            Panel(
                title=f"{title}, µ {mu:g}",
                base=replace(base, friction=mu),
                x=STIFFNESSES_KPA[::-1],
                y=RADII_MM[::-1],
            )
            for title, base in list(PRESETS.items())[slice(1, 2) if quick else slice(None)]
            for mu in FRICTIONS
        ),
    )
