"""The commands that list what there is: scenes, sensors, palettes, methods, the installation."""

from .options import Json, print_list


def scenes(*, json_only: Json = False) -> int:
    """List the shipped scenes.

    Example: chromagrip scenes --json
    """
    from ..scene import load_scene, scene_names

    return print_list({name: load_scene(name).description for name in scene_names()}, json_only)


def sensors(*, json_only: Json = False) -> int:
    """List the shipped sensor designs.

    Example: chromagrip sensors
    """
    from ..render import load_sensor, sensor_names

    return print_list({name: load_sensor(name).description for name in sensor_names()}, json_only)


def palettes(*, json_only: Json = False) -> int:
    """List the palettes; every sensor design is one too.

    Example: chromagrip palettes
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

    Example: chromagrip controllers
    """
    from ..scene.controllers import CONTROLLERS

    return print_list(CONTROLLERS.descriptions(), json_only)


def renderers(*, json_only: Json = False) -> int:
    """List the renderers, those of installed packages included.

    Example: chromagrip renderers
    """
    from ..render import RENDERERS

    return print_list(RENDERERS.descriptions(), json_only)


def trackers(*, json_only: Json = False) -> int:
    """List the trackers, those of installed packages included.

    Example: chromagrip trackers
    """
    from ..tracking import tracker_names

    return print_list(tracker_names(), json_only)


def reconstructors(*, json_only: Json = False) -> int:
    """List the reconstructors of forces, those of installed packages included.

    Example: chromagrip reconstructors
    """
    from ..tracking import RECONSTRUCTORS

    return print_list(RECONSTRUCTORS.descriptions(), json_only)


def integrators(*, json_only: Json = False) -> int:
    """List the integrators of the node model, those of installed packages included.

    Example: chromagrip integrators
    """
    from ..model import INTEGRATORS

    return print_list(INTEGRATORS.descriptions(), json_only)


def doctor(*, json_only: Json = False) -> int:
    """Name every missing part of the installation and the command that installs it.

    Example: chromagrip doctor
    """
    from .doctor import report

    return report(json_only=json_only)
