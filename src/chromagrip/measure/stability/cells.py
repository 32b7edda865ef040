"""One run of the closed loop as a cell of a map: its setting and its outcome."""

from dataclasses import dataclass, fields, replace
from functools import cache
from itertools import islice

import numpy as np

from ...errors import UserError
from ...loop.columns import Rows
from ...loop.grasp import grasp
from ...loop.run import run
from ...loop.trace import Trace, make_trace
from ...model import GROSS_SLIP
from ...scene.scene import Scene, load_scene
from ...sensing.camera import SimulatedCamera
from ...sensing.sensor import open_camera
from ...thesis import DESIRED_MARGIN, DURATION_S, LOAD_TIMES_S, LOADS_N
from .linear import LinearLoop, Plant, largest_root, plant_of
from .panels import Outcome, Outcomes, worst

#: Outcomes, best first. Where several hold, the last counts.
OUTCOMES: Outcomes = {
    "holds": Outcome("#8fd0c5", "", "none of the others"),
    "micro-slip": Outcome(
        "#e9d26a", "m", "true Γ below 0.02 for a moment: all of the contact slides"
    ),
    "limit cycle": Outcome(
        "#7aa6d6", "~", "the command still swings by over 30 % at the end of a load"
    ),
    "gross slip": Outcome("#f0a35e", "s", "true lateral displacement over 0.2 mm"),
    "crush": Outcome("#c79ad6", "c", "true pressure over 1000 N/m"),
    "no answer": Outcome("#d9d9d9", "–", "the node model found none"),
}
#: Γ below which the whole contact slides. Friction never leaves its cone, so Γ is never negative.
MICRO_SLIP = 0.02
#: Peak to peak of the command, less a straight line, over its mean, from which on it swings.
SWING = 0.30
#: Time at the end of each load over which that is measured [s].
HELD = 0.4
#: Pressure that crushes, over the width of the contact plus one node pitch [N/m].
CRUSH = 1000.0
#: First load of the thesis's experiment [N].
FIRST_LOAD = LOADS_N[0]
#: Fields of a setting that are gains, and those of all that a controller does not have.
_GAINS = ("proportional_n", "integral_n_per_s")
_FOREIGN: dict[str, tuple[str, ...]] = {"safety-margin": (), "margin-inversion": _GAINS}
#: Desired margin Γ.
MARGIN = DESIRED_MARGIN


@dataclass(frozen=True, kw_only=True)
class LoopSetting:
    """Setting of a run; the defaults are the thesis's validation experiment.

    Attributes
    ----------
    path, controller, rate_hz, latency_frames: as in a scene
    proportional_n, integral_n_per_s, window_s: gains, and the average of µ, of Safety Margin
    friction, stiffness_kpa, radius_mm: of the object
    step_n: by which the load rises from FIRST_LOAD
    margin_noise: white noise on Γ on the truth path, standard deviation
    """

    path: str = "truth"
    controller: str = "safety-margin"
    rate_hz: float = 1000.0
    latency_frames: int = 0
    proportional_n: float = 2.5
    integral_n_per_s: float = 100.0
    window_s: float = 0.05
    friction: float = 0.5
    stiffness_kpa: float = 200.0
    radius_mm: float = np.inf
    step_n: float = 0.4
    margin_noise: float = 0.003

    def scene(self) -> Scene:
        """The same as a scene."""
        return load_scene(
            "camera-100hz",
            {
                "description": "a point of `chromagrip stability loop`",
                "path": self.path,
                "controller": self.controller,
                "duration_s": DURATION_S,
                "camera.rate_hz": self.rate_hz,
                "fingertip.step_ms": min(1.0, 1e3 / self.rate_hz),
                "camera.latency_frames": self.latency_frames,
                "safety_margin.desired_margin": MARGIN,
                "safety_margin.proportional_n": self.proportional_n,
                "safety_margin.integral_n_per_s": self.integral_n_per_s,
                "safety_margin.friction_window_s": self.window_s,
                "object.friction": self.friction,
                "object.stiffness_kpa": self.stiffness_kpa,
                "object.radius_mm": self.radius_mm,
                "load.times_s": list(LOAD_TIMES_S),
                "load.forces_n": [FIRST_LOAD, FIRST_LOAD + self.step_n],
                "truth.margin_noise": self.margin_noise,
            },
        )

    @property
    def predicted(self) -> bool:
        """Whether the linearised loop is that of its controller."""
        return self.controller == "safety-margin"

    def through_camera(self) -> "LoopSetting":
        """The same through the camera, without stated noise."""
        return replace(self, path="camera", margin_noise=0.0)

    def on_truth_path(self) -> "LoopSetting":
        """The same on the truth path, with the default noise."""
        return replace(self, path="truth", margin_noise=LoopSetting().margin_noise)

    def linear(self) -> LinearLoop:
        """The loop linearised where its gain is largest: at the first, lighter load."""
        return LinearLoop(
            plant=plant(self.friction, self.stiffness_kpa, self.radius_mm),
            proportional=self.proportional_n,
            integral=self.integral_n_per_s,
            period=1.0 / self.rate_hz,
            latency=self.latency_frames,
        )


@dataclass(frozen=True, kw_only=True)
class LoopCell(LoopSetting):
    """A run and its outcome; NaN where there is nothing to measure.

    Attributes
    ----------
    outcome: one of OUTCOMES
    displacement_mm: largest true lateral displacement
    margin_min: lowest true Γ at a frame since the first load
    swing: largest swing of the command at the end of a load, over its mean
    pressure_n_per_m: largest true pressure, one node pitch added to the width
    root: largest root of the linearised loop, unstable from 1 on; NaN for other controllers
    note: why there is no answer
    """

    outcome: str
    displacement_mm: float = np.nan
    margin_min: float = np.nan
    swing: float = np.nan
    pressure_n_per_m: float = np.nan
    root: float
    note: str = ""

    @property
    def foreign(self) -> tuple[str, ...]:
        """Fields that its controller does not have: gains of another one, the average of µ."""
        return _FOREIGN.get(self.controller, (*_GAINS, "window_s"))

    @property
    def setting(self) -> LoopSetting:
        """Setting of the run."""
        return LoopSetting(
            **{field.name: getattr(self, field.name) for field in fields(LoopSetting)}
        )

    @property
    def swings(self) -> bool:
        """Whether the command never came to rest."""
        return self.swing > SWING


@cache
def plant(friction: float, stiffness_kpa: float, radius_mm: float) -> Plant:
    """Plant of the loop with that object under the first load at the desired margin."""
    scene = LoopSetting(friction=friction, stiffness_kpa=stiffness_kpa, radius_mm=radius_mm).scene()
    return plant_of(scene.build_fingertip(), scene.build_object(), FIRST_LOAD, MARGIN)


def cell(setting: LoopSetting) -> LoopCell:
    """Run a setting and judge it."""
    root = largest_root(setting.linear()) if setting.predicted else np.nan
    try:
        trace = _run(setting.scene())
    except UserError as stopped:
        return LoopCell(**vars(setting), outcome="no answer", root=root, note=str(stopped))
    loaded = trace["time_s"] > LOAD_TIMES_S[0]
    displacement = float(trace["lateral_displacement_mm"].max())
    margin_min = float(np.nanmin(trace["margin_true"][loaded]))
    largest_swing = max(swing(trace, end) for end in (LOAD_TIMES_S[1], DURATION_S))
    pressure = float(np.nanmax(trace["pressure_pitch_n_per_m"]))
    return LoopCell(
        **vars(setting),
        outcome=outcome(displacement, margin_min, largest_swing, pressure),
        displacement_mm=displacement,
        margin_min=margin_min,
        swing=largest_swing,
        pressure_n_per_m=pressure,
        root=root,
    )


def _run(scene: Scene) -> Trace:
    if scene.path == "camera":
        return run(scene).trace
    # Steps after the last frame are not needed.
    samples = islice(grasp(scene, _unused_camera()), scene.frames)
    return make_trace([*map(Rows(scene).line, samples)])


@cache
def _unused_camera() -> SimulatedCamera:
    """Camera for the truth path, which uses none; opening one takes longer than some runs."""
    return open_camera(LoopSetting().scene())


def outcome(
    displacement_mm: float, margin_min: float, swing: float, pressure_n_per_m: float
) -> str:
    """Worst outcome of a run."""
    happened = {
        "micro-slip": margin_min < MICRO_SLIP,
        "limit cycle": swing > SWING,
        "gross slip": displacement_mm > 1e3 * GROSS_SLIP,
        "crush": pressure_n_per_m > CRUSH,
    }
    return worst("holds", happened)


def swing(trace: Trace, end: float, held: float = HELD) -> float:
    """Peak to peak of the command, less a straight line, over its mean, before an instant [s].

    Parameters
    ----------
    end: instant [s]
    held: time before it [s]
    """
    time = trace["time_s"]
    last = (time > end - held + 1e-9) & (time < end - 1e-9)
    at, command = time[last], trace["grip_n"][last]
    if len(at) < 3:
        return np.nan
    straight = np.polyval(np.polyfit(at, command, 1), at)
    return float(np.ptp(command - straight) / command.mean())
