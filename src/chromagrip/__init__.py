"""chromagrip: a colour-marker tactile fingertip, simulated from mechanics to grip.

>>> import chromagrip
>>> result = chromagrip.run("camera-100hz")
>>> result.summary["final_margin_true"]
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .links import guard as _guard

if TYPE_CHECKING:
    from .errors import UserError
    from .loop.run_folder import Result, run
    from .scene.scene import Scene, load_scene, scene_names

    __version__: str

_HOMES = {
    "Result": "loop.run_folder",
    "Scene": "scene.scene",
    "UserError": "errors",
    "load_scene": "scene.scene",
    "run": "loop.run_folder",
    "scene_names": "scene.scene",
}

__all__ = ["Result", "Scene", "UserError", "__version__", "load_scene", "run", "scene_names"]

_guard()


def __getattr__(name: str) -> Any:
    # Imported where used: `import chromagrip.model` must not pull in OpenCV or matplotlib.
    if name in _HOMES:
        return getattr(import_module(f".{_HOMES[name]}", __name__), name)
    if name == "__version__":
        from importlib.metadata import version

        return version(__name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
