"""Values of the page's sliders, and the scene made from them."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgspec

from ..errors import UserError
from ..scene.fingers import need_one_finger
from ..scene.scene import Body, Scene
from ..scene.settings import LoadSettings
from ..strict_toml import Kind, Values, convert

#: Objects by their name on the page: what their settings change of a plane.
OBJECTS: dict[str, dict[str, object]] = {
    "ball of 15 mm": {"radius_mm": 15.0},
    "ball of 6 mm": {"radius_mm": 6.0},
    "plane": {},
    "box": {"shape": "box", "size_mm": (12.0, 12.0, 12.0), "rounding_mm": 1.5},
    "cylinder": {"shape": "cylinder", "size_mm": (6.0, 30.0), "rounding_mm": 1.0},
    "torus": {"shape": "torus", "size_mm": (8.0, 4.0)},
}


@dataclass(frozen=True, kw_only=True)
class SliderValues:
    """Values of the sliders.

    Attributes
    ----------
    automatic: whether the controller grips
    grip: grip force while it does not [N]
    load: size of the lateral load [N]
    azimuth: azimuth of the load about the fingertip's axis [°]
    twist: torque about that axis [N·mm]
    friction: µ of the object
    stiffness: Young's modulus of the object [kPa]
    controller: name of the controller
    sensor: name of the design
    object: name in `OBJECTS`, or file of a mesh in mm; empty: the scene's object
    tilt: turn of the object about y [°]
    noise: noise of the camera [grey levels]
    latency: number of frames between an image and the command from it
    """

    automatic: bool
    grip: float
    load: float
    azimuth: float
    twist: float
    friction: float
    stiffness: float
    controller: str
    sensor: str
    object: str
    tilt: float
    noise: float
    latency: int

    @property
    def restarts(self) -> tuple[str | float, ...]:
        """Values that cannot change during a grasp: a change begins another one."""
        return (
            self.controller, self.sensor, self.object, self.tilt, self.noise, self.latency
        )  # fmt: skip


def slider_values(scene: Scene) -> SliderValues:
    """First values of the sliders: those of the scene, with its last load."""
    load, end = scene.load, scene.duration_s
    x, y = load.force(end), load.sideways(end)
    return SliderValues(
        automatic=True,
        grip=1.0,
        load=math.hypot(x, y),
        azimuth=math.degrees(math.atan2(y, x)) if x or y else 0.0,
        twist=1e3 * load.twist(end),
        friction=scene.object.friction_at(end),
        stiffness=scene.object.stiffness_kpa,
        controller=scene.controller,
        sensor=scene.sensor,
        object="",
        tilt=scene.object.turned_deg[1],
        noise=scene.camera.noise_levels,
        latency=scene.camera.latency_frames,
    )


def scene_for(base: Scene, sliders: SliderValues) -> Scene:
    """Make the scene of a grasp with these values; values without a slider are those of `base`.

    Raises
    ------
    UserError
        For values that do not make a valid scene.
    """
    need_one_finger(base, "the live page shows")
    if not math.isfinite(sliders.azimuth):
        raise UserError(f"azimuth = {sliders.azimuth} must be a finite number")
    load, fixed = _OF_BODY[base.body](base, sliders)
    load |= {"times_s": (0.0,)}
    fixed |= {"friction_times_s": (), "frictions": (), "creeps": 0.0}
    fixed |= {"friction": sliders.friction, "stiffness_kpa": sliders.stiffness}
    camera = {"noise_levels": sliders.noise, "latency_frames": sliders.latency}
    longest = 3600.0  # length of a live grasp [s]
    return msgspec.structs.replace(
        base,
        duration_s=longest,
        controller=sliders.controller,
        sensor=sliders.sensor,
        load=convert(load, LoadSettings, "load"),
        object=_changed(base.object, fixed, "object"),
        camera=_changed(base.camera, camera, "camera"),
    )


def _of_chain(base: Scene, sliders: SliderValues) -> tuple[Values, Values]:
    """Load and object of a chain: in its plane."""
    return {"forces_n": (sliders.load,), "sideways_n": (), "twists_nmm": ()}, {}


def _of_dome(base: Scene, sliders: SliderValues) -> tuple[Values, Values]:
    """Load and object of a dome: in any direction, twisted, and of any shape."""
    azimuth = math.radians(sliders.azimuth)
    negligible = 1e-9  # a load that is negligible, but keeps an axis of the object free
    load: Values = {
        "forces_n": (sliders.load * math.cos(azimuth),),
        "sideways_n": (sliders.load * math.sin(azimuth) + negligible,),
        "twists_nmm": (sliders.twist + negligible,),
    }
    turned = (base.object.turned_deg[0], sliders.tilt, base.object.turned_deg[2])
    return load, {**_shape_of(sliders.object), "turned_deg": turned}


#: Changes of load and object by the sliders of a body.
_OF_BODY: dict[Body, Callable[[Scene, SliderValues], tuple[Values, Values]]] = {
    "chain": _of_chain,
    "dome": _of_dome,
}


def _changed(table: Kind, values: Values, name: str) -> Kind:
    """Change values of a table; they are checked like those of a file."""
    return convert(msgspec.to_builtins(table) | values, type(table), name)


def _shape_of(name: str) -> dict[str, Any]:
    """Changes to the scene's object for a name in `OBJECTS` or a file; empty for its own."""
    if not name:
        return {}
    bare: dict[str, Any] = {"shape": "ball", "radius_mm": math.inf, "size_mm": ()}
    bare |= {"rounding_mm": 0.0, "mesh": ""}
    if name in OBJECTS:
        return bare | OBJECTS[name]
    return bare | {"mesh": name, "mesh_unit_mm": 1.0}
