"""Time per simulated second of the node models, chain and dome, against their error."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.model.bench import SAFE, margins, smooth_grasp
from benchmarks.model.integrators import explicit_limit, integrate
from benchmarks.parts import Part, whole_chart
from chromagrip.measure.charts.chart import Axis, Chart, Point
from chromagrip.measure.study import Asked, Study, study
from chromagrip.model import (
    ContactObject,
    Dome,
    Fingertip,
    History,
    Motion,
    Solid,
    dome_forces,
    simulate_contact,
)
from chromagrip.model.shapes import Shape, ball, cylinder, plane

Array = NDArray[np.float64]

#: Grip force of a grasp [N].
_GRIP = 2.0
_MARGIN = Axis(key="margin_error", label="Γ, largest error", unit="")
#: Length of a grasp of the chain, and time between the instants that are compared [s].
_DURATION, _EVERY = 1.2, 0.3
#: Flat and hard, in between, sharp and soft.
_OBJECTS = (
    ContactObject(friction=0.5, stiffness=1000.0),
    ContactObject(friction=0.3, stiffness=160.0, curvature=50.0),
    ContactObject(friction=0.7, stiffness=80.0, curvature=200.0),
)
#: Share of what friction holds up to which the load on a dome goes.
_SHARE = 0.6
#: Instants of a grasp of the dome [s], and the shares of grip and load at them; straight between.
_TIMES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
_PRESSED = (0.0, 0.5, 1.0, 1.0, 1.0, 1.0)
_PULLED = (0.0, 0.0, 0.0, 0.5, 1.0, 1.0)
#: Damper of the object on a dome, which carries a thousandth of the load [N·s/m].
_DRAG = 0.5
_SHAPES: tuple[Shape, ...] = (plane(), ball(20e-3), cylinder(5e-3))


@dataclass(frozen=True, kw_only=True)
class ModelSetting:
    """A body and how it is stepped.

    Attributes
    ----------
    name, words: of the point, and its settings
    run: simulates the grasp of an object
    values: of an object and its run at the compared instants, shape (K, n)
    ours: whether it is drawn as the project's choice; others are run only once, as they take
        minutes and are far from the front
    """

    name: str
    words: str
    run: Callable[[Any], Any]
    values: Callable[[Any, Any], Array]
    ours: bool = True


def _chain(name: str, tip: Fingertip, step: float = 1e-3, method: str = "implicit") -> ModelSetting:
    return ModelSetting(
        name=name,
        words=f"{tip.law} chain, {method}",
        run=partial(_chain_grasp, tip, step, method),
        values=partial(margins, tip),
        ours=method == "implicit",
    )


def _chain_grasp(tip: Fingertip, step: float, method: str, obj: ContactObject) -> History:
    """Instants of a grasp; an explicit method takes SAFE of its stable step."""
    if method != "implicit":
        step = SAFE * explicit_limit(tip, obj, method=method)
    every = int(np.ceil(_EVERY / step))
    drive = smooth_grasp(_GRIP, 0.5 * obj.friction * _GRIP)
    dt = _EVERY / every
    return integrate(method, tip, obj, drive, dt=dt, duration=_DURATION, every=every)


def _chains(quick: bool) -> list[ModelSetting]:
    thesis, graded = Fingertip(), Fingertip.graded()
    chains = {"31": Fingertip(nodes=31), "51": Fingertip(nodes=51), "101": Fingertip(nodes=101)}
    chains |= {"251": thesis, f"{graded.nodes} graded": graded}
    steps = (2e-3, 1e-2) if quick else (1e-3, 5e-3, 1e-2, 2e-2)
    settings = [
        _chain(f"{name} nodes, {1e3 * step:g} ms", tip, step)
        for name, tip in chains.items()
        for step in steps
    ]
    if not quick:
        settings += [
            _chain("251 nodes, 0.1 ms", thesis, 1e-4),
            _chain("501 nodes, 1 ms", Fingertip(nodes=501)),
        ]
        small = Fingertip(nodes=51)
        settings += [
            _chain(f"51 nodes, {method}", small, method=method) for method in ("euler", "rk4")
        ]
    return settings


@study("project", "chart-model")
def model_chart(asked: Asked) -> Study[Part, Chart]:
    """Time of a grasp by node models and steps against their errors."""
    return whole_chart(chart_model, "node models", asked)


@study("project", "chart-dome")
def dome_chart(asked: Asked) -> Study[Part, Chart]:
    """Time of a grasp by pitches and steps of the dome against their errors."""
    return whole_chart(chart_dome, "domes", asked)


def chart_model(quick: bool) -> Chart:
    """Measure chains and steps; a quick run has fewer turns and a coarser truth.

    Errors are the largest of three objects at four instants, against a finer chain in finer steps.
    """
    nodes, step = (501, 1e-3) if quick else (1001, 1e-4)
    finer = f"{nodes} nodes in {1e3 * step:g} ms steps"
    fine = _chain(finer, Fingertip(nodes=nodes), step)
    return Chart(
        part="model",
        title=f"Node models: a grasp of {_GRIP:g} N, against {finer}",
        per="simulated second",
        points=_measured(_chains(quick), fine, _OBJECTS, _DURATION, _chain_errors, quick),
        axes=(Axis(key="normal_error", label="ΣFn, largest error [%]", unit="%"), _MARGIN),
    )


def _chain_errors(run: Array, true: Array) -> dict[str, float]:
    return {
        "normal_error": 100.0 * float(abs(run[:, 0] / true[:, 0] - 1.0).max()),
        "margin_error": float(np.nanmax(abs(run[:, 1] - true[:, 1]))),
    }


def _dome(pitch: float, step: float) -> ModelSetting:
    return ModelSetting(
        name=f"{1e3 * pitch:g} mm, {1e3 * step:g} ms",
        words="linear silicone with stiffening",
        run=partial(_dome_grasp, pitch, step),
        values=lambda _, run: run,
    )


def _dome_grasp(pitch: float, step: float, shape: Shape) -> Array:
    """Indentation [m], shift [m] and Γ at the instants of a grasp, shape (K, 3)."""
    dome = Dome(pitch=pitch, reach=math.radians(50.0))
    solid = Solid(shape=shape)
    loads = np.zeros((len(_TIMES), 6))
    loads[:, 2] = -_GRIP * np.array(_PRESSED)
    loads[:, 0] = _SHARE * solid.friction * _GRIP * np.array(_PULLED)
    motion = Motion(
        times=np.array(_TIMES),
        poses=np.zeros((len(_TIMES), 6)),
        free=("x", "z"),
        loads=loads,
        drag=(_DRAG, 0.0, _DRAG, 0.0, 0.0, 0.0),
    )
    steps = round(_TIMES[-1] / step)
    run = simulate_contact(dome, solid, motion, step, keep=steps)
    each = steps // (len(_TIMES) - 1)
    height = dome.radius + max(shape.reach_down(), 0.0)
    return np.array(
        [
            (
                height - state.place[2],
                state.place[0],
                dome_forces(dome, state).safety_margin(solid.friction),
            )
            for state in run.states[each - 1 :: each]
        ]
    )


def chart_dome(quick: bool) -> Chart:
    """Measure pitches and steps of the dome; a quick run has fewer and a coarser truth.

    Errors are the largest of three objects at five instants, against a finer dome in finer steps.
    """
    pitch, step = (0.4e-3, 5e-3) if quick else (0.28e-3, 1e-3)
    pitches = (0.8e-3, 0.6e-3) if quick else (0.8e-3, 0.6e-3, 0.4e-3)
    steps = (5e-3, 10e-3) if quick else (2e-3, 5e-3, 10e-3)
    settings = [_dome(*each) for each in product(pitches, steps)]
    fine = _dome(pitch, step)
    finer = f"{1e3 * pitch:g} mm in {1e3 * step:g} ms steps"
    place = "indentation or shift, largest error [%]"
    return Chart(
        part="model-dome",
        title=f"Dome: a grasp of {_GRIP:g} N by pitch and step, against {finer}",
        per="simulated second",
        points=_measured(settings, fine, _SHAPES, _TIMES[-1], _dome_errors, quick),
        axes=(Axis(key="place_error", label=place, unit="%"), _MARGIN),
    )


def _dome_errors(run: Array, true: Array) -> dict[str, float]:
    off = abs(run - true)
    shift = off[:, 1].max() / abs(true[:, 1]).max()  # it begins at none
    place = max(float((off[:, 0] / true[:, 0]).max()), float(shift))
    return {"place_error": 100.0 * place, "margin_error": float(off[:, 2].max())}


def _measured(
    settings: Sequence[ModelSetting],
    fine: ModelSetting,
    objects: Sequence[Any],
    duration: float,
    errors: Callable[[Array, Array], dict[str, float]],
    quick: bool,
) -> list[Point]:
    """Time of every setting, and the largest of its errors over the objects.

    Parameters
    ----------
    fine: setting of the truth
    duration: of a grasp [s]
    errors: of the values of a run and of the truth
    """
    truth = [fine.values(obj, fine.run(obj)) for obj in objects]
    points = [
        Point(
            name=setting.name,
            times=[],
            errors={},
            ours=setting.ours,
            settings=setting.words,
            command="./run bench chart-model chart-dome",
        )
        for setting in settings
    ]
    for turn in range(2 if quick else 4):  # the first compiles, and makes tables of compliance
        for setting, point in zip(settings, points, strict=True):
            if turn and not setting.ours:
                continue
            begin = time.process_time()
            runs = [setting.run(obj) for obj in objects]
            spent = 1e3 * (time.process_time() - begin) / (duration * len(objects))
            if turn or not setting.ours:
                point.times.append(spent)
            if not turn:
                values = map(setting.values, objects, runs)
                each = [errors(run, true) for run, true in zip(values, truth, strict=True)]
                point.errors.update({key: max(one[key] for one in each) for key in each[0]})
    return points
