"""The commands that list scenes, sensors, palettes, methods, and the installation."""

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

    entries = {name: load_sensor(name).description for name in sensor_names()}
    for name in sensor_names(1):
        entries[name] = f"{load_sensor(name, fewest=1).description}; for tracking alone"
    return print_list(entries, json_only)


def palettes(*, json_only: Json = False) -> int:
    """List the palettes; every sensor design is also a palette.

    Example: chromagrip list palettes
    """
    from ..render import load_sensor, sensor_names
    from ..tracking import load_palette, palette_names

    entries = {}
    for name in palette_names():
        palette = load_palette(name)
        layers = " over ".join(palette.names)
        entries[name] = f"{layers}, {'brighter' if palette.bright else 'darker'} than the ground"
    for name in sensor_names() + sensor_names(1):
        entries[name] = f"sensor, {load_sensor(name, fewest=1).description}"
    return print_list(entries, json_only)


def controllers(*, json_only: Json = False) -> int:
    """List the controllers, including those of installed packages.

    Example: chromagrip list controllers
    """
    from ..scene.controllers import CONTROLLERS

    return print_list(CONTROLLERS.descriptions(), json_only)


def renderers(*, json_only: Json = False) -> int:
    """List the renderers, including those of installed packages.

    Example: chromagrip list renderers
    """
    from ..render import RENDERERS

    return print_list(RENDERERS.descriptions(), json_only)


def trackers(*, json_only: Json = False) -> int:
    """List the trackers, including those of installed packages.

    Example: chromagrip list trackers
    """
    from ..tracking import tracker_names

    return print_list(tracker_names(), json_only)


def reconstructors(*, json_only: Json = False) -> int:
    """List the reconstructors of forces, including those of installed packages.

    Example: chromagrip list reconstructors
    """
    from ..tracking import RECONSTRUCTORS

    return print_list(RECONSTRUCTORS.descriptions(), json_only)


def sources(*, json_only: Json = False) -> int:
    """List the sources of frames, including those of installed packages.

    Example: chromagrip list sources
    """
    from ..sources.source import SHIPPED, SOURCES

    return print_list(SHIPPED | SOURCES.descriptions(), json_only)


def grippers(*, json_only: Json = False) -> int:
    """List the grippers of `grasp --source`, including those of installed packages.

    Example: chromagrip list grippers
    """
    from ..outside.gripper import GRIPPERS

    return print_list(GRIPPERS.descriptions(), json_only)


def recipes(*, json_only: Json = False) -> int:
    """List the shipped recipes of datasets.

    Example: chromagrip list recipes
    """
    from ..dataset.recipe import SHIPPED, recipe_names
    from ..strict_toml import parse_toml

    texts = {name: (SHIPPED / f"{name}.toml").read_text("utf-8") for name in recipe_names()}
    about = {name: parse_toml(text, name).get("description", "") for name, text in texts.items()}
    return print_list(about, json_only)


#: Lists by their second word.
LISTS: dict[str, Callable[..., int]] = {
    "scenes": scenes,
    "sensors": sensors,
    "palettes": palettes,
    "controllers": controllers,
    "trackers": trackers,
    "reconstructors": reconstructors,
    "renderers": renderers,
    "grippers": grippers,
    "sources": sources,
    "recipes": recipes,
    "readouts": readouts,
}


def doctor(*, json_only: Json = False) -> int:
    """List missing parts of the installation with the commands that install them, and caches.

    Example: chromagrip doctor
    """
    from .doctor import report

    return report(json_only=json_only)
