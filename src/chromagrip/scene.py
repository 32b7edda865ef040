"""Scenes: everything that defines a run, read strictly from TOML (units in the key names)."""

import math
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import tomli_w
from msgspec import Meta

from .control import (
    ConservativeControl,
    ConservativeSettings,
    Controller,
    ReactToSlip,
    ReactToSlipSettings,
    SafetyMarginControl,
    SafetyMarginGains,
)
from .errors import SceneError
from .model import ContactObject, Fingertip, SpringLaw, stiffness_from_young
from .model.chain import contact
from .render import Defects, SensorDesign, SensorError, load_sensor
from .render.tables import Table, convert

Positive = Annotated[float, Meta(gt=0.0, le=1e9)]
NotNegative = Annotated[float, Meta(ge=0.0, le=1e9)]
Share = Annotated[float, Meta(gt=0.0, lt=1.0)]

ControllerName = Literal["safety-margin", "react-to-slip", "conservative"]
PathName = Literal["camera", "truth"]
RendererName = Literal["painter", "pyrender"]

#: Name and one line about each controller.
CONTROLLERS: dict[ControllerName, str] = {
    "safety-margin": "PI control of the safety margin around its desired value",
    "react-to-slip": "constant force, raised by a step each time slip is seen",
    "conservative": "constant force, more than is needed",
}


class ObjectSettings(Table, frozen=True):
    """The object that is gripped; `radius_mm = inf` is flat, a negative one hollow.

    `profile_mm` are points (x, z) of its surface, z into the object; empty is flat or round.
    """

    stiffness_kpa: Positive = 200.0
    friction: Annotated[float, Meta(gt=0.0, le=5.0)] = 0.5
    radius_mm: float = math.inf
    profile_mm: tuple[tuple[float, float], ...] = ()
    dahl_stiffness_n_per_m: Positive = 5000.0
    dahl_exponent: Annotated[float, Meta(ge=0.1, le=2.0)] = 0.7
    drag_n_s_per_m: Positive = 120.0

    def __post_init__(self) -> None:
        if not abs(self.radius_mm) >= 1.0:
            raise ValueError(f"radius_mm = {self.radius_mm} must be at least 1, hollow at most -1")
        if self.profile_mm and self.radius_mm != math.inf:
            raise ValueError("radius_mm must be inf beside profile_mm")


class LoadSettings(Table, frozen=True):
    """Lateral load: each force holds from its time on; before the first there is none."""

    times_s: tuple[NotNegative, ...] = (0.04, 1.0)
    forces_n: tuple[Annotated[float, Meta(ge=-100.0, le=100.0)], ...] = (0.25, 0.65)

    def __post_init__(self) -> None:
        if len(self.times_s) != len(self.forces_n):
            raise ValueError(
                f"times_s has {len(self.times_s)} entries and forces_n {len(self.forces_n)}; "
                "they must be as many"
            )
        if tuple(sorted(set(self.times_s))) != self.times_s:
            raise ValueError(f"times_s must increase, got {list(self.times_s)}")

    def force(self, time: float) -> float:
        """Load at `time` [N]."""
        past = [f for t, f in zip(self.times_s, self.forces_n, strict=True) if t <= time]
        return past[-1] if past else 0.0


class FingertipSettings(Table, frozen=True):
    """The chain of the node model; see `Fingertip.law` for its models."""

    model: SpringLaw = "split"
    nodes: Annotated[int, Meta(ge=11, le=20001)] = 251
    step_ms: Annotated[float, Meta(gt=0.0, le=100.0)] = 1.0


class CameraSettings(Table, frozen=True):
    """When frames come, and how noisy they are."""

    rate_hz: Annotated[float, Meta(gt=0.0, le=1e5)] = 100.0
    latency_frames: Annotated[int, Meta(ge=0, le=1000)] = 1
    noise_levels: Annotated[float, Meta(ge=0.0, le=50.0)] = 2.0
    rest_frames: Annotated[int, Meta(ge=1, le=1000)] = 16


class SafetyMarginSettings(Table, frozen=True):
    """Safety Margin Control and the average of its friction estimate."""

    desired_margin: Share = 0.30
    feedforward_n: Positive = 0.5
    proportional_n: NotNegative = 0.25
    integral_n_per_s: NotNegative = 30.0
    friction_window_s: Positive = 0.3
    floor_n: Positive = 0.1
    start_s: NotNegative = 0.04


class ReactToSlipTable(Table, frozen=True):
    """React To Slip."""

    start_n: Positive = 0.5
    step_n: Positive = 2.0
    displacement_mm: Positive = 1.3
    margin: Share = 0.05
    hold_s: NotNegative = 0.1


class TruthSettings(Table, frozen=True):
    """What the truth path tells wrongly: white noise on Γ, its standard deviation."""

    margin_noise: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0


class ConservativeTable(Table, frozen=True):
    """Conservative Control."""

    force_n: Positive = 5.0


class Scene(Table, frozen=True):
    """A whole experiment.

    `calibration` is the file that the estimator is told of the sensor, empty for one that is as
    designed; `reconstructor` is how it reads forces.
    """

    description: str = ""
    duration_s: Annotated[float, Meta(gt=0.0, le=3600.0)] = 2.0
    seed: Annotated[int, Meta(ge=0, le=2**32 - 1)] = 0
    controller: ControllerName = "safety-margin"
    path: PathName = "camera"
    renderer: RendererName = "painter"
    sensor: str = "thesis"
    calibration: str = ""
    reconstructor: str = "auto"
    object: ObjectSettings = ObjectSettings()
    load: LoadSettings = LoadSettings()
    fingertip: FingertipSettings = FingertipSettings()
    camera: CameraSettings = CameraSettings()
    safety_margin: SafetyMarginSettings = SafetyMarginSettings()
    react_to_slip: ReactToSlipTable = ReactToSlipTable()
    conservative: ConservativeTable = ConservativeTable()
    truth: TruthSettings = TruthSettings()
    defects: Defects = Defects()

    def __post_init__(self) -> None:
        if self.fingertip.nodes % 2 == 0:
            raise ValueError(f"fingertip.nodes = {self.fingertip.nodes} must be odd")
        try:
            sensor = self.build_sensor()
        except SensorError as error:
            raise ValueError(str(error)) from None
        if not sensor.shape.flat:  # the node model is a dome
            contact(self.build_fingertip(), self.build_object())  # refuses what cannot touch

    @property
    def period(self) -> float:
        """Time between frames [s]."""
        return 1.0 / self.camera.rate_hz

    @property
    def frames(self) -> int:
        """Frames of the run, the first at time 0."""
        return math.floor(self.duration_s * self.camera.rate_hz + 1e-9) + 1

    def build_sensor(self) -> SensorDesign:
        """The sensor's design."""
        return load_sensor(self.sensor)

    def build_fingertip(self) -> Fingertip:
        """The model's fingertip, as large as the sensor's dome."""
        return Fingertip.of_radius(
            self.build_sensor().shape.radius,
            nodes=self.fingertip.nodes,
            law=self.fingertip.model,
        )

    def build_object(self) -> ContactObject:
        """The model's object."""
        return ContactObject(
            stiffness=stiffness_from_young(self.object.stiffness_kpa * 1e3),
            friction=self.object.friction,
            curvature=0.0 if self.object.profile_mm else 1e3 / self.object.radius_mm,
            profile=tuple((1e-3 * x, 1e-3 * z) for x, z in self.object.profile_mm) or None,
            dahl_stiffness=self.object.dahl_stiffness_n_per_m,
            dahl_exponent=self.object.dahl_exponent,
            drag=self.object.drag_n_s_per_m,
        )

    def build_controller(self) -> Controller:
        """The controller the scene names."""
        if self.controller == "safety-margin":
            margin = self.safety_margin
            return SafetyMarginControl(
                SafetyMarginGains(
                    desired_margin=margin.desired_margin,
                    feedforward=margin.feedforward_n,
                    proportional=margin.proportional_n,
                    integral=margin.integral_n_per_s,
                    floor=margin.floor_n,
                    start=margin.start_s,
                )
            )
        if self.controller == "react-to-slip":
            slip = self.react_to_slip
            return ReactToSlip(
                ReactToSlipSettings(
                    start_force=slip.start_n,
                    step_force=slip.step_n,
                    displacement=slip.displacement_mm * 1e-3,
                    margin=slip.margin,
                    hold=slip.hold_s,
                )
            )
        return ConservativeControl(ConservativeSettings(force=self.conservative.force_n))


DEFAULT_SCENE = "camera-100hz"


def scene_names() -> list[str]:
    """Names of the shipped scenes."""
    folder = files(__package__) / "scenes"
    return sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name[-5:] == ".toml")


def load_scene(name: str = DEFAULT_SCENE, changes: dict[str, Any] | None = None) -> Scene:
    """Scene of that name, or from a TOML file, with some values changed.

    Parameters
    ----------
    name: a shipped scene, or the path of a file that ends in `.toml`
    changes: dotted key → new value, `{"object.friction": 0.3}`

    Raises
    ------
    SceneError
        With the key, the value and what is allowed.
    """
    if name in scene_names():
        text = (files(__package__) / "scenes" / f"{name}.toml").read_text(encoding="utf-8")
    elif name.endswith(".toml"):
        try:
            text = Path(name).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or "not UTF-8 text"
            raise SceneError(f"scene file {name} cannot be read: {reason}") from None
    else:
        raise SceneError(
            f"no scene {name!r}; there is {', '.join(scene_names())}, or give a .toml file"
        )
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"scene {name} is not valid TOML: {error}") from None
    # A file that a scene names lies beside the scene, one from the command line where that runs.
    _locate_files(values, Path(name).parent)
    for key, value in (changes or {}).items():
        _put(values, key, value)
    _locate_files(values, Path())
    return parse_scene(values, name)


def _locate_files(values: dict[str, Any], folder: Path) -> None:
    for key in ("sensor", "calibration"):
        name = values.get(key)
        if isinstance(name, str) and name.endswith(".toml"):
            values[key] = str((folder / name).absolute())


def parse_scene(values: dict[str, Any], name: str) -> Scene:
    """Scene from plain values; `name` is used in messages."""
    try:
        return convert(values, Scene, f"scene {name}")
    except ValueError as error:
        raise SceneError(str(error)) from None


def dump_scene(scene: Scene) -> str:
    """TOML text of a scene, every default written out."""
    return tomli_w.dumps(msgspec.to_builtins(scene))


def parse_change(text: str) -> tuple[str, Any]:
    """Key and value of `key=value`, the value in TOML, bare words taken as strings."""
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise SceneError(f"--set {text}: expected key=value, such as object.friction=0.3")
    try:
        return key.strip(), tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return key.strip(), value.strip()


def _put(values: dict[str, Any], key: str, value: Any) -> None:
    *tables, last = key.split(".")
    for table in tables:
        values = values.setdefault(table, {})
        if not isinstance(values, dict):
            raise SceneError(f"{key}: {table} is a value, not a table")
    values[last] = value
