"""Time per simulated second of the dome against its error, over pitch and step."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model import Dome, Motion, Solid, dome_forces, simulate_contact
from ...model.shapes import Shape, ball, cylinder, plane
from .chart import Axis, Chart, Point

Array = NDArray[np.float64]

#: Grip, and the share of what friction holds up to which the load goes.
_GRIP, _SHARE = 2.0, 0.6
#: Instants of a grasp [s], and the shares of grip and load at them; straight in between.
_TIMES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
_PRESSED = (0.0, 0.5, 1.0, 1.0, 1.0, 1.0)
_PULLED = (0.0, 0.0, 0.0, 0.5, 1.0, 1.0)
#: Damper of the object, which carries a thousandth of the load [N·s/m].
_DRAG = 0.5
_SHAPES: tuple[Shape, ...] = (plane(), ball(20e-3), cylinder(5e-3))
AXES = (
    Axis(key="place_error", label="indentation or shift, largest error [%]", unit="%"),
    Axis(key="margin_error", label="Γ, largest error", unit=""),
)


@dataclass(frozen=True)
class Setting:
    """Pitch of a dome [m] and step [s]."""

    pitch: float
    step: float

    @property
    def name(self) -> str:
        """In mm and ms."""
        return f"dome, {1e3 * self.pitch:g} mm, {1e3 * self.step:g} ms"

    def run(self, shape: Shape) -> Array:
        """Indentation [m], shift [m] and Γ at the instants of a grasp, shape (K, 3)."""
        dome = Dome(pitch=self.pitch, reach=math.radians(50.0))
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
        steps = round(_TIMES[-1] / self.step)
        run = simulate_contact(dome, solid, motion, self.step, keep=steps)
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


def _settings(quick: bool) -> list[Setting]:
    pitches = (0.8e-3, 0.6e-3) if quick else (0.8e-3, 0.6e-3, 0.4e-3)
    steps = (5e-3, 10e-3) if quick else (2e-3, 5e-3, 10e-3)
    return [Setting(pitch, step) for pitch in pitches for step in steps]


def chart_dome(quick: bool, progress: Callable[[str], None]) -> Chart:
    """Measure pitches and steps of the dome; a quick run has fewer and a coarser truth.

    Errors are the largest of three objects at five instants, against a finer dome in finer steps.
    """
    fine = Setting(0.4e-3, 5e-3) if quick else Setting(0.28e-3, 1e-3)
    truth = []
    for shape in _SHAPES:
        progress(f"truth, {fine.name}, {shape.name}")
        truth.append(fine.run(shape))
    settings = _settings(quick)
    points = [
        Point(
            name=setting.name.removeprefix("dome, "),
            times=[],
            errors={},
            ours=True,
            settings="linear silicone with stiffening",
            command="chromagrip chart model",
        )
        for setting in settings
    ]
    for turn in range(2 if quick else 4):  # the first compiles, and makes tables of compliance
        for setting, point in zip(settings, points, strict=True):
            progress(f"{setting.name}, turn {turn + 1}")
            begin = time.process_time()
            runs = [setting.run(shape) for shape in _SHAPES]
            spent = 1e3 * (time.process_time() - begin) / (_TIMES[-1] * len(_SHAPES))
            if turn:
                point.times.append(spent)
            else:
                point.errors.update(_errors(runs, truth))
    title = (
        f"Dome: a grasp of {_GRIP:g} N by pitch and step, "
        f"against {1e3 * fine.pitch:g} mm in {1e3 * fine.step:g} ms steps"
    )
    return Chart(part="model-dome", title=title, per="simulated second", points=points, axes=AXES)


def _errors(runs: list[Array], truth: list[Array]) -> dict[str, float]:
    place, margin = 0.0, 0.0
    for run, true in zip(runs, truth, strict=True):
        off = abs(run - true)
        shift = off[:, 1].max() / abs(true[:, 1]).max()  # it begins at none
        place = max(place, float((off[:, 0] / true[:, 0]).max()), float(shift))
        margin = max(margin, float(off[:, 2].max()))
    return {"place_error": 100.0 * place, "margin_error": margin}
