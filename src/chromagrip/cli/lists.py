"""The commands that list what there is: scenes, sensors, palettes, methods, the installation."""

from collections.abc import Callable

from .options import Json, print_list
from .readouts import readouts


def scenes(*, json_only: Json = False) -> int:
    """List the shipped scenes.

    Example: chromagrip list scenes --json
    """
    from ..scene import load_scene, scene_names

    return print_list({name: load_scene(name).description for name in scene_names()}, json_only)


def sensors(*, json_only: Json = False) -> int:
    """List the shipped sensor designs.

    Example: chromagrip list sensors
    """
    from ..render import load_sensor, sensor_names

    return print_list({name: load_sensor(name).description for name in sensor_names()}, json_only)


def palettes(*, json_only: Json = False) -> int:
    """List the palettes; every sensor design is one too.

    Example: chromagrip list palettes
    """
    from ..render import load_sensor, sensor_names
    from ..tracking import load_palette, palette_names

    entries = {}
    for name in palette_names():
        palette = load_palette(name)
        layers = " over ".join(palette.names)
        entries[name] = f"{layers}, {'brighter' if palette.bright else 'darker'} than the ground"
    entries |= {name: f"sensor, {load_sensor(name).description}" for name in sensor_names()}
    return print_list(entries, json_only)


def controllers(*, json_only: Json = False) -> int:
    """List the controllers, those of installed packages included.

    Example: chromagrip list controllers
    """
    from ..scene.controllers import CONTROLLERS

    return print_list(CONTROLLERS.descriptions(), json_only)


def renderers(*, json_only: Json = False) -> int:
    """List the renderers, those of installed packages included.

    Example: chromagrip list renderers
    """
    from ..render import RENDERERS

    return print_list(RENDERERS.descriptions(), json_only)


def trackers(*, json_only: Json = False) -> int:
    """List the trackers, those of installed packages included.

    Example: chromagrip list trackers
    """
    from ..tracking import tracker_names

    return print_list(tracker_names(), json_only)


def reconstructors(*, json_only: Json = False) -> int:
    """List the reconstructors of forces, those of installed packages included.

    Example: chromagrip list reconstructors
    """
    from ..tracking import RECONSTRUCTORS

    return print_list(RECONSTRUCTORS.descriptions(), json_only)


def integrators(*, json_only: Json = False) -> int:
    """List the integrators of the node model, those of installed packages included.

    Example: chromagrip list integrators
    """
    from ..model import INTEGRATORS

    return print_list(INTEGRATORS.descriptions(), json_only)


def recipes(*, json_only: Json = False) -> int:
    """List the shipped recipes of datasets.

    Example: chromagrip list recipes
    """
    from ..dataset.recipe import SHIPPED, recipe_names
    from ..strict_toml import parse_toml

    texts = {name: (SHIPPED / f"{name}.toml").read_text("utf-8") for name in recipe_names()}
    about = {name: parse_toml(text, name).get("description", "") for name, text in texts.items()}
    return print_list(about, json_only)


#: Lists by what they are of.
LISTS: dict[str, Callable[..., int]] = {
    "scenes": scenes,
    "sensors": sensors,
    "palettes": palettes,
    "controllers": controllers,
    "trackers": trackers,
    "reconstructors": reconstructors,
    "renderers": renderers,
    "integrators": integrators,
    "recipes": recipes,
    "readouts": readouts,
}


def doctor(*, json_only: Json = False) -> int:
    """Name every missing part of the installation and the command that installs it.

    Example: chromagrip doctor
    """
    from .doctor import report

    return report(json_only=json_only)
