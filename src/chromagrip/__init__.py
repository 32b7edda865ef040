"""chromagrip: a colour-marker tactile fingertip, simulated from mechanics to grip.

>>> import chromagrip
>>> result = chromagrip.run("camera-100hz")
>>> result.summary["final_margin_true"]
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .errors import UserError
    from .loop.run_folder import Result, run
    from .scene.scene import Scene, load_scene, scene_names

_HOMES = {
    "Result": "loop.run_folder",
    "Scene": "scene.scene",
    "UserError": "errors",
    "load_scene": "scene.scene",
    "run": "loop.run_folder",
    "scene_names": "scene.scene",
}

__all__ = ["Result", "Scene", "UserError", "load_scene", "run", "scene_names"]


def __getattr__(name: str) -> Any:
    # Imported where used: `import chromagrip.model` must not pull in OpenCV or matplotlib.
    if name in _HOMES:
        return getattr(import_module(f".{_HOMES[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
