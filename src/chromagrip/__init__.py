"""chromagrip: a colour-marker tactile fingertip, simulated from mechanics to grip.

>>> import chromagrip
>>> result = chromagrip.run("camera-100hz")
>>> result.summary["final_margin_true"]
"""

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

from .links import guard as _guard

if TYPE_CHECKING:
    from .errors import UserError
    from .loop.record import Result
    from .loop.rig import Rig
    from .loop.run import open_rig as open
    from .loop.run import run
    from .model import shapes
    from .scene.scene import Scene, load_scene, scene_names
    from .sensing.bodies import Pose
    from .sensing.many import TactileSensor, TactileSensors, relative_poses
    from .sensing.reader import Reader, Reading

    __version__: str

_HOMES = {
    "Pose": "sensing.bodies:Pose",
    "Reader": "sensing.reader:Reader",
    "Reading": "sensing.reader:Reading",
    "Result": "loop.record:Result",
    "Rig": "loop.rig:Rig",
    "Scene": "scene.scene:Scene",
    "TactileSensor": "sensing.many:TactileSensor",
    "TactileSensors": "sensing.many:TactileSensors",
    "UserError": "errors:UserError",
    "load_scene": "scene.scene:load_scene",
    "open": "loop.run:open_rig",
    "relative_poses": "sensing.many:relative_poses",
    "run": "loop.run:run",
    "scene_names": "scene.scene:scene_names",
    "shapes": "model:shapes",
}

__all__ = [
    "Pose",
    "Reader",
    "Reading",
    "Result",
    "Rig",
    "Scene",
    "TactileSensor",
    "TactileSensors",
    "UserError",
    "__version__",
    "load_scene",
    "open",
    "relative_poses",
    "run",
    "scene_names",
    "shapes",
]

_guard()
if sys.modules.get("gymnasium") is not None:
    import_module(".gym", __name__)  # which registers its environments


def __getattr__(name: str) -> Any:
    # Imported where used: `import chromagrip.model` must not pull in OpenCV or matplotlib.
    if name in _HOMES:
        module, _, inside = _HOMES[name].partition(":")
        return getattr(import_module(f".{module}", __name__), inside)
    if name == "__version__":
        from importlib.metadata import version

        return version(__name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
