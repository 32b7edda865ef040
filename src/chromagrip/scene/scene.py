"""Scenes, which define runs; they are read strictly from TOML, and keys name their units."""

import math
import os
import re
from collections.abc import Collection, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import tomli_w
from msgspec import Meta

from ..by_name import as_in_file, with_allowed, with_arguments
from ..control import (
    ConservativeSettings,
    Controller,
    LimitSurfaceSettings,
    MarginInversionSettings,
    ReactToSlipSettings,
    SafetyMarginSettings,
)
from ..errors import UserError, located, meant
from ..model import (
    ContactObject,
    Fingertip,
    SoftBody,
    Solid,
    check_fit,
    largest_grip,
    solid_stiffness,
    stiffness_from_young,
)
from ..model.dome import per_area
from ..render import RENDERERS, Defects, SensorDesign, load_sensor, sensor_names
from ..strict_toml import Table, Values, convert, parse_toml, read_toml
from .actuator import ActuatorSettings
from .controllers import CONTROLLERS
from .dome import DomeSettings
from .pinch import PinchSettings
from .settings import (
    CameraSettings,
    FingertipSettings,
    LoadSettings,
    ObjectSettings,
    TruthSettings,
)
from .shapes import PROFILE_KEYS, SHAPE_KEYS, build_shape

#: Settings of controllers that are grip forces.
GRIP_KEYS = ("force_n", "start_n", "step_n", "feedforward_n", "floor_n", "ceiling_n")

PathName = Literal["camera", "truth"]
#: Margin that a controller holds: the smaller of Γ and the one with torsion, or Γ alone.
HeldMargin = Literal["smaller", "friction"]
#: Body of the fingertip: the thesis's chain of nodes, a slice, or silicone in three dimensions.
Body = Literal["chain", "dome"]
#: Mechanics of a grasp: one finger with such a body, or two domes.
Mechanics = Literal["chain", "dome", "pinch"]

#: Keys that a scene cannot set, with the reason: for each body those of the other body, for each
#: number of fingers those of the other number.
_CHAIN_ONLY = {"fingertip": ("model", "nodes"), "object": PROFILE_KEYS}
_DOME_ONLY = {
    "": ("held_margin",),
    "dome": DomeSettings.__struct_fields__,
    "object": SHAPE_KEYS,
    "load": ("sideways_n", "twists_nmm"),
}
_UNKNOWN_KEYS: dict[Body | int, tuple[dict[str, tuple[str, ...]], str]] = {
    "chain": (_DOME_ONLY, 'is for body = "dome"; this scene\'s body is chain'),
    "dome": (_CHAIN_ONLY, 'is for body = "chain"; this scene\'s body is dome'),
    1: ({"pinch": PinchSettings.__struct_fields__}, "is for two fingers; set fingers = 2"),
    2: (
        {"load": LoadSettings.__struct_fields__},
        "is for one finger; with two the weight and the hand pull",
    ),
}
#: Keys that a written scene leaves out.
_NOT_WRITTEN: dict[Mechanics, tuple[str, ...]] = {
    "chain": ("held_margin", "fingers", "pinch"),
    "dome": ("fingers", "pinch"),
    "pinch": (),
}


class Scene(Table, frozen=True):
    """Settings that define a run.

    Attributes
    ----------
    description: one line for lists of scenes
    duration_s: length of the run [s]
    seed: seed of all random numbers
    controller: name in `CONTROLLERS` or of an entry point, or `module:Class`
    controller_arguments: arguments of a `module:Class`, by name; ours have a table each
    path: `camera` estimates forces from rendered frames, `truth` takes them from the body
    fingers: number of fingers: 1 presses an object under a load, 2 hold one with a weight, see
        `pinch`
    body: `chain`, the thesis's node model, or `dome`, silicone in three dimensions
    renderer: name of the renderer
    sensor: name or file of the sensor's design
    calibration: file of the sensor's calibration; empty: calibration of the design
    tracker: name of the tracker, which follows the markers
    reconstructor: name of the reconstructor, which estimates the forces
    held_margin: margin that the controller holds on a dome: the `smaller` of Γ and the one with
        torsion, or that of `friction` alone, which is Γ
    object, load, fingertip, dome, pinch, camera, actuator, truth, defects: tables of settings
    safety_margin, margin_inversion, limit_surface, react_to_slip, conservative: tables of the
        controllers' settings
    """

    description: str = ""
    duration_s: Annotated[float, Meta(gt=0.0, le=3600.0)] = 2.0
    seed: Annotated[int, Meta(ge=0, le=2**32 - 1)] = 0
    controller: str = "safety-margin"
    path: PathName = "camera"
    fingers: Annotated[int, Meta(ge=1, le=2)] = 1
    body: Body = "chain"
    renderer: str = "painter"
    sensor: str = "thesis"
    calibration: str = ""
    tracker: str = "fit"
    reconstructor: str = "auto"
    held_margin: HeldMargin = "smaller"
    controller_arguments: Values = msgspec.field(default_factory=dict)
    object: ObjectSettings = ObjectSettings()
    load: LoadSettings = LoadSettings()
    fingertip: FingertipSettings = FingertipSettings()
    dome: DomeSettings = DomeSettings()
    pinch: PinchSettings = PinchSettings()
    camera: CameraSettings = CameraSettings()
    actuator: ActuatorSettings = ActuatorSettings()
    safety_margin: SafetyMarginSettings = SafetyMarginSettings()
    margin_inversion: MarginInversionSettings = MarginInversionSettings()
    limit_surface: LimitSurfaceSettings = LimitSurfaceSettings()
    react_to_slip: ReactToSlipSettings = ReactToSlipSettings()
    conservative: ConservativeSettings = ConservativeSettings()
    truth: TruthSettings = TruthSettings()
    defects: Defects = Defects()

    def __post_init__(self) -> None:
        CONTROLLERS.check(self.controller)
        RENDERERS.check(self.renderer)
        self._check_times()
        if self.fingertip.nodes % 2 == 0:
            raise UserError(f"fingertip.nodes = {self.fingertip.nodes} must be odd")
        if self.camera.exposure_ms and self.defects.motion_blur:
            raise UserError("camera.exposure_ms and defects.motion_blur both delay; set one")
        if self.controller_arguments and self.controller in CONTROLLERS.entries:
            raise UserError(
                "controller_arguments (--arg) are for a controller of your own, module:Class; the "
                f"settings of {self.controller} are in [{self._settings_name}] (--set "
                f"{self._settings_name}.KEY=VALUE)"
            )
        target = self.target_margin
        if target is not None and not 0.0 <= target < 1.0:
            raise UserError(f"desired_margin = {target:g}: expected 0 or more and below 1")
        self._refuse_keys(*_UNKNOWN_KEYS[self.body])
        self._refuse_keys(*_UNKNOWN_KEYS[self.fingers])
        {"chain": self._check_chain, "dome": self._check_dome, "pinch": self._check_pinch}[
            self.mechanics
        ]()

    def _refuse_keys(self, tables: Mapping[str, tuple[str, ...]], why: str) -> None:
        """Refuse keys of tables that differ from the default."""
        for table, keys in tables.items():
            settings: Any = getattr(self, table) if table else self
            names, values = settings.__struct_fields__, settings.__struct_defaults__
            default = dict(zip(names, values, strict=True))
            for key in keys:
                if (value := getattr(settings, key)) != default[key]:
                    name = f"{table}.{key}" if table else key
                    raise UserError(f"{name} = {value!r} {why}")

    def _check_chain(self) -> None:
        if not self.build_sensor().shape.flat:
            check_fit(self.build_fingertip(), self.build_object())
            self._check_grip()

    def _check_dome(self) -> None:
        self.build_dome()
        if self.build_sensor().shape.flat and self.path == "camera":
            raise UserError(
                f"no estimator reads the silicone of the flat pad {self.sensor} yet; set "
                'path = "truth"'
            )
        self.build_solid()

    def _check_pinch(self) -> None:
        if not self.pinch.mass_g:
            raise UserError("pinch.mass_g = 0 must be above 0: two fingers hold a weight")
        if self.body != "dome":  # the two keys meet here alone
            raise UserError('two fingers need body = "dome"')
        self._check_dome()
        dome = self.build_dome()
        self.pinch.build(dome, dome, self.build_solid(), self.object)

    def _check_times(self) -> None:
        """Refuse frames, exposures, latencies and steps that contradict each other."""
        camera, period_ms = self.camera, 1e3 * self.period
        if self.frames < 2:
            raise UserError(
                f"camera.rate_hz = {camera.rate_hz:g} gives no second frame within duration_s = "
                f"{self.duration_s:g}; it must be at least {1.0 / self.duration_s:g}"
            )
        if camera.exposure_ms > period_ms:
            raise UserError(
                f"camera.exposure_ms = {camera.exposure_ms} must be at most {period_ms:g}, the "
                "time between frames"
            )
        if camera.latency_frames >= self.frames:
            raise UserError(
                f"camera.latency_frames = {camera.latency_frames} must be less than {self.frames}, "
                "the frames of the run"
            )
        if self.fingertip.step_ms > period_ms * (1.0 + 1e-9):
            raise UserError(
                f"fingertip.step_ms = {self.fingertip.step_ms:g} must be at most {period_ms:g}, "
                "the time between frames"
            )

    def _check_grip(self) -> None:
        """Refuse settings of the controller with more force than the node model can describe."""
        if self.controller not in CONTROLLERS.entries:
            return
        settings = getattr(self, self._settings_name)
        limit = largest_grip(self.build_fingertip(), self.build_object())
        for key in GRIP_KEYS:
            force = getattr(settings, key, 0.0)
            if force > limit:
                raise UserError(
                    f"{self._settings_name}.{key} = {force:g} must be at most {limit:.3g}, the "
                    "grip that presses the whole fingertip flat"
                )

    @property
    def mechanics(self) -> Mechanics:
        """Mechanics of the grasp: `chain`, `dome`, or `pinch` for two fingers."""
        return "pinch" if self.fingers == 2 else self.body  # the tables of rooms begin here

    @property
    def holds_torsion(self) -> bool:
        """True if the controller holds the margin with torsion while it is the smaller one."""
        return self.held_margin == "smaller" and self.body != "chain"  # a chain has no torsion

    @property
    def last_change(self) -> float:
        """Time of the last change of load or friction in the run; 0 if there is none [s]."""
        times = (*self.load.times_s, *self.object.friction_times_s)
        return max((time for time in times if time < self.duration_s), default=0.0)

    @property
    def period(self) -> float:
        """Time between frames [s]."""
        return 1.0 / self.camera.rate_hz

    @property
    def frames(self) -> int:
        """Number of frames of the run, the first at time 0."""
        return math.floor(self.duration_s * self.camera.rate_hz + 1e-9) + 1

    @property
    def target_margin(self) -> float | None:
        """Safety margin that the controller aims at; None if it has no such setting.

        That of a class of one's own is its argument `desired_margin`.
        """
        own = with_arguments(self.controller)[1] | self.controller_arguments
        target = getattr(self._settings, "desired_margin", own.get("desired_margin"))
        return float(target) if isinstance(target, float | int) else None

    @property
    def grip_ceiling(self) -> float | None:
        """Largest grip force that the controller gives [N]; None if it has no such setting."""
        ceiling = getattr(self._settings, "ceiling_n", None)
        return None if ceiling is None else float(ceiling)

    @property
    def sliding_margin(self) -> float | None:
        """Γ that the lower end of the interval must exceed to exclude sliding; None: no check."""
        first = getattr(self._settings, "grip_first", None)
        return None if first is None or self.path != "camera" else float(first.sliding_margin)

    def build_sensor(self) -> SensorDesign:
        """Load the sensor's design."""
        return load_sensor(self.sensor)

    def build_fingertip(self) -> Fingertip:
        """Build the chain's fingertip, as large as the sensor's dome."""
        return Fingertip.of_radius(
            self.build_sensor().shape.radius,
            nodes=self.fingertip.nodes,
            law=self.fingertip.model,
        )

    def build_object(self, time: float = 0.0) -> ContactObject:
        """Build the chain's object as it is at `time` [s]."""
        settings = self.object
        places = zip(settings.friction_places_mm, settings.friction_factors, strict=True)
        return ContactObject(
            stiffness=stiffness_from_young(settings.stiffness_kpa_at(time) * 1e3),
            friction=settings.friction_at(time),
            patches=tuple((1e-3 * x, factor) for x, factor in places),
            curvature=0.0 if settings.profile_mm else 1e3 / settings.radius_mm,
            profile=tuple((1e-3 * x, 1e-3 * z) for x, z in settings.profile_mm) or None,
            surface=settings.surface,
            dahl_stiffness=settings.dahl_stiffness_n_per_m,
            dahl_exponent=settings.dahl_exponent,
            drag=settings.drag_n_s_per_m,
        )

    def build_body(self) -> Fingertip | SoftBody:
        """Build the body of the fingertip: chain or silicone."""
        builds = {"chain": self.build_fingertip, "dome": self.build_dome}
        return builds[self.body]()

    def build_dome(self) -> SoftBody:
        """Build the silicone of the fingertip.

        Raises
        ------
        UserError
            For a sensor without silicone, and for changes that do not make a valid dome.
        """
        with located(f"sensor {self.sensor}"):
            dome = self.build_sensor().dome
        return self.dome.changed(dome)

    def build_solid(self, time: float = 0.0) -> Solid:
        """Build the dome's object as it is at `time` [s]."""
        settings = self.object
        return Solid(
            shape=build_shape(settings),
            stiffness=solid_stiffness(settings.stiffness_kpa_at(time) * 1e3),
            friction=settings.friction_at(time),
            dahl_stiffness=per_area(settings.dahl_stiffness_n_per_m),
            dahl_exponent=settings.dahl_exponent,
        )

    def build_controller(self) -> Controller:
        """Build the controller that the scene names.

        Raises
        ------
        UserError
            When a `module:Class` cannot be imported, or raises an error when it is called.
        """
        arguments = self.controller_arguments
        if self.controller in CONTROLLERS.entries:
            arguments = {"settings": self._settings}
        controller: Controller = CONTROLLERS.build(self.controller, arguments)
        return controller

    @property
    def _settings(self) -> Any:
        """Table of the controller's settings; None for one that is not ours."""
        return getattr(self, self._settings_name, None)

    @property
    def _settings_name(self) -> str:
        """Name of the table of the controller's settings, for one of ours."""
        return self.controller.replace("-", "_")


#: Scene of a built sensor that is read by physics.
DEFAULT_SCENE = "chromatouch-2022"


def scene_names() -> list[str]:
    """Names of the shipped scenes."""
    folder = files(__package__) / "library"
    return sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name[-5:] == ".toml")


def load_scene(
    name: str = DEFAULT_SCENE,
    changes: Mapping[str, Any] | None = None,
    *,
    allow: Collection[str] = (),
) -> Scene:
    """Load a scene by name or from a TOML file, with some values changed.

    Parameters
    ----------
    name: name of a shipped scene, or path of a file that ends in `.toml`
    changes: dotted key → new value, such as `{"object.friction": 0.3}`
    allow: modules from which a `module:Class` in the file may be imported; any other is shown, but
        refused when it would be imported

    Raises
    ------
    UserError
        For a value that is not allowed, with the key, the value and what is allowed.
    """
    if name in scene_names():
        path = Path(str(files(__package__) / "library" / f"{name}.toml"))
    elif name.endswith(".toml"):
        path = Path(name)
    else:
        question = meant(name, scene_names()) or _other_kind(name)
        raise UserError(
            f"no scene {name!r}{question}; there is {', '.join(scene_names())}, "
            "or give a .toml file"
        )
    values = with_allowed(read_toml(path, f"scene file {name}"), allow)
    if not values:
        raise UserError(f"scene file {name} has no keys: give at least one, such as duration_s = 2")
    # Files in a scene file are relative to it, those on the command line to the working folder.
    _locate_files(values, Path(name).parent)
    pinch = values.get("pinch")
    if "fingers" not in values and isinstance(pinch, dict) and pinch.get("mass_g"):
        values["fingers"] = 2  # older files have no such key
    for key, value in (changes or {}).items():
        _put(values, key, value)
    _locate_files(values, Path())
    return parse_scene(values, name)


def _other_kind(name: str) -> str:
    """How to give a controller or a sensor that stands in a scene's place; "" for other names."""
    if name in CONTROLLERS.descriptions() or ":" in name:
        kind = "controller"
    elif name in sensor_names():
        kind = "sensor"
    else:
        return ""
    return f" (as a {kind} it is --{kind} {name}, or --set {kind}={name})"


def _locate_files(values: Values, folder: Path) -> None:
    """Make the paths of files absolute."""
    for key in ("sensor", "calibration"):
        name = values.get(key)
        if isinstance(name, str) and name.endswith(".toml"):
            values[key] = str((folder / name).absolute())
    obj = values.get("object")
    if isinstance(obj, dict) and isinstance(obj.get("mesh"), str) and obj["mesh"]:
        obj["mesh"] = str((folder / obj["mesh"]).absolute())


def parse_scene(values: Values, name: str) -> Scene:
    """Build a scene from plain values; `name` is used in messages.

    Defects that are not in the values are those of the sensor's design.
    """
    scene = convert(values, Scene, f"scene {name}")
    built = scene.build_sensor().defects
    if built == Defects():
        return scene
    defects = msgspec.to_builtins(built) | values.get("defects", {})
    return convert({**values, "defects": defects}, Scene, f"scene {name}")


def dump_scene(scene: Scene, folder: Path | None = None) -> str:
    """Write a scene as TOML with all defaults; paths of files are relative to `folder`."""
    values = msgspec.to_builtins(scene)
    if not scene.controller_arguments:
        del values["controller_arguments"]
    for key in _NOT_WRITTEN[scene.mechanics]:
        del values[key]
    if folder is not None:
        values["sensor"] = seen_from(folder, scene.sensor)
        if scene.object.mesh:
            values["object"]["mesh"] = relative(scene.object.mesh, folder)
    return tomli_w.dumps(as_in_file(values))


def seen_from(folder: Path, sensor: str) -> str:
    """Name of a sensor; path relative to a folder if it is a file."""
    if not sensor.endswith(".toml"):
        return sensor
    return relative(sensor, folder)


def relative(file: str, folder: Path) -> str:
    """Path of a file relative to a folder."""
    return Path(os.path.relpath(file, folder)).as_posix()


def grasp_command(scene: str, changes: Mapping[str, Any]) -> str:
    """Command line that runs a scene with changes, each by its dotted key."""
    options = [f" --set {key}={value}" for key, value in changes.items()]
    return f"chromagrip grasp --scene {scene}{''.join(options)}"


def parse_change(text: str) -> tuple[str, Any]:
    """Parse `key=value`; the value is TOML, or text without quotes."""
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise UserError(f"--set {text}: expected key=value, such as object.friction=0.3")
    try:
        if re.fullmatch(r"[\s\d+\-.,eE\[\]]+", value):
            # A number may begin with its point, which TOML does not allow.
            value = re.sub(r"(?<![\d.])\.(?=\d)", "0.", value)
        return key.strip(), parse_toml(f"value = {value}", "--set")["value"]
    except UserError:
        return key.strip(), value.strip()


def _put(values: Values, key: str, value: Any) -> None:
    *tables, last = key.split(".")
    for table in tables:
        values = values.setdefault(table, {})
        if not isinstance(values, dict):
            raise UserError(f"{key}: {table} is a value, not a table")
    values[last] = value
