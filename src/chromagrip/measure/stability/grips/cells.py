"""One grip with a dome or with two fingers as a cell of a map: its setting and its outcome."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ....errors import UserError
from ....loop.record import Result
from ....loop.run import run
from ....loop.trace import Trace
from ....model import GROSS_SLIP
from ....scene.scene import Scene, load_scene
from ..cells import SWING, swing
from ..panels import Outcome, Outcomes

Array = NDArray[np.float64]
#: World of a map: `dome`, one and a load, or `pinch`, two of them and an object with a weight.
World = Literal["dome", "pinch"]
#: Outcomes, best first. Where several hold, the last counts.
OUTCOMES: Outcomes = {
    "holds": Outcome("#8fd0c5", "", "none of the others"),
    "swings": Outcome(
        "#7aa6d6", "~", "in the last second the command swings by over 30 % of its mean"
    ),
    "slips": Outcome("#f0a35e", "s", "true lateral displacement over 0.2 mm"),
    "turned": Outcome("#e9d26a", "t", "turned in the hand by over 20°, without the skins"),
    "dropped": Outcome("#d9534f", "d", "slid in the hand by over 5 mm"),
    "no answer": Outcome(
        "#d9d9d9", "–", "the silicone is pressed through, or a step has no solution"
    ),
}
#: Time at the end over which the swing is measured [s].
HELD = 1.0
#: Scene of one dome, and of two; all that a setting does not name is theirs.
SCENES: dict[str, str] = {"dome": "chromatouch-2022", "pinch": "pinch-lift"}
#: Share of the load at which the scene of one dome rests on its way to the whole.
FIRST_SHARE = 0.6
#: Gains of Safety Margin with one dome, whose scene has another controller: those of
#: `camera-100hz`. A pinch has those of its scene.
GAINS = {"proportional_n": 0.25, "integral_n_per_s": 30.0, "floor_n": 0.1}
#: Time of a scene [s]: one second after the last change, or more.
DURATION_S = 3.0


@dataclass(frozen=True, kw_only=True)
class GripSetting:
    """Setting of a grip on the truth path; the defaults are those of the scenes.

    Attributes
    ----------
    world: `dome` or `pinch`
    controller, rate_hz, latency_frames: as in a scene
    friction: µ of the object
    load_n: of a dome: load at the end [N]
    mass_g, offset_mm: of a pinch: mass of the object, and its centre of mass beside the fingers
    margin_noise: white noise on Γ, standard deviation
    """

    world: str
    controller: str = "margin-inversion"
    rate_hz: float = 60.0
    latency_frames: int = 1
    friction: float = 0.5
    load_n: float = 2.0
    mass_g: float = 200.0
    offset_mm: float = 0.0
    margin_noise: float = 0.003

    def scene(self) -> Scene:
        """The same as a scene."""
        changes: dict[str, object] = {
            "description": "a point of `chromagrip stability loop`",
            "path": "truth",
            "duration_s": DURATION_S,
            "controller": self.controller,
            "camera.rate_hz": self.rate_hz,
            "camera.latency_frames": self.latency_frames,
            "fingertip.step_ms": min(5.0, 1e3 / self.rate_hz),
            "object.friction": self.friction,
            "truth.margin_noise": self.margin_noise,
        }
        first = FIRST_SHARE * self.load_n
        own: dict[str, dict[str, object]] = {
            "dome": {
                "load.forces_n": [0.0, first, first, self.load_n],
                **{f"safety_margin.{name}": value for name, value in GAINS.items()},
            },
            "pinch": {
                "pinch.mass_g": self.mass_g,
                "pinch.centre_mm": [0.0, self.offset_mm, 0.0],
            },
        }
        return load_scene(SCENES[self.world], changes | own[self.world])


@dataclass(frozen=True, kw_only=True)
class GripCell(GripSetting):
    """A grip and its outcome; NaN where there is nothing to measure.

    Attributes
    ----------
    outcome: one of OUTCOMES
    slide_mm: largest lateral displacement of a dome; largest slide of a pinch
    turn_deg: largest turn of the object about the axis of the pinch, without the skins
    swing: peak to peak of the command in the last second, over its mean
    grip_n: mean command in that time [N]
    note: why there is no answer
    """

    outcome: str
    slide_mm: float = np.nan
    turn_deg: float = np.nan
    swing: float = np.nan
    grip_n: float = np.nan
    note: str = ""

    @property
    def foreign(self) -> tuple[str, ...]:
        """Fields that its world does not have."""
        return {"dome": ("mass_g", "offset_mm", "turn_deg"), "pinch": ("load_n",)}[self.world]

    @property
    def setting(self) -> GripSetting:
        """Setting of the grip."""
        return GripSetting(
            **{field.name: getattr(self, field.name) for field in fields(GripSetting)}
        )


def cell(setting: GripSetting) -> GripCell:
    """Run a setting and judge it."""
    try:
        scene = setting.scene()
        result = run(scene)
    except UserError as stopped:
        return GripCell(**vars(setting), outcome="no answer", note=str(stopped))
    trace = result.trace
    slide, turn, lost = _MOTIONS[setting.world](result)
    swings, grip = at_the_end(trace)
    return GripCell(
        **vars(setting),
        outcome=outcome(lost, swings),
        slide_mm=float(slide.max()),
        turn_deg=float(abs(turn).max()),
        swing=swings,
        grip_n=grip,
    )


def _motion_on_dome(result: Result) -> tuple[Array, Array, str]:
    """Slide [mm] and turn [°] of the object, and how it was lost."""
    slide = result.trace["lateral_displacement_mm"]
    return slide, np.zeros(1), "slips" if slide.max() > 1e3 * GROSS_SLIP else ""


def _motion_in_pinch(result: Result) -> tuple[Array, Array, str]:
    """The same between two fingers."""
    trace = result.trace
    return trace["slide_mm"], trace["turn_deg"], str(result.summary["outcome"])


_MOTIONS: dict[str, Callable[[Result], tuple[Array, Array, str]]] = {
    "dome": _motion_on_dome,
    "pinch": _motion_in_pinch,
}


def outcome(lost: str, swings: float) -> str:
    """Worst outcome of a grip.

    Parameters
    ----------
    lost: what happened to the object: `slips`, `turned` or `dropped`; anything else is nothing
    swings: of the command at the end, over its mean
    """
    if lost in OUTCOMES:
        return lost
    return "swings" if swings > SWING else "holds"


def at_the_end(trace: Trace) -> tuple[float, float]:
    """Swing of the command in the last second over its mean, and that mean [N]."""
    end = float(trace["time_s"][-1]) + 1e-6
    last = trace["time_s"] > end - HELD
    return swing(trace, end, HELD), float(trace["grip_n"][last].mean())
