"""Gymnasium environments around the grip loop, and tactile observations for other environments.

`import chromagrip` registers the environments as soon as Gymnasium is imported, before or after:

    import chromagrip
    import gymnasium

    env = gymnasium.make("chromagrip/Pinch-v0", observation="forces")

`TactileObservation` and `VectorTactileObservation` add a sensor to an environment that knows
nothing of it.
"""

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType
from typing import Any

#: Keyword arguments of each environment, by its name.
ENVIRONMENTS: dict[str, dict[str, object]] = {
    "chromagrip/Grasp-v0": {},
    "chromagrip/Pinch-v0": {"scene": "pinch-lift", "most_n": 10.0},
}
_HOMES = {"TactileObservation": "tactile", "VectorTactileObservation": "tactile"}


def register() -> None:
    """Register the environments now, which imports Gymnasium."""
    from gymnasium.envs.registration import register, registry

    for name, arguments in ENVIRONMENTS.items():
        if name not in registry:
            register(name, entry_point=f"{__name__}.environment:GripEnv", kwargs=arguments)


class _WhenImported:
    """Finder that registers the environments once Gymnasium is imported, and finds nothing."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find Gymnasium as others do, and let its loader register the environments after it."""
        if name != "gymnasium":
            return None
        sys.meta_path.remove(self)
        spec = find_spec(name)
        if spec is not None and spec.loader is not None:
            loaded = spec.loader.exec_module

            def load(module: ModuleType) -> None:
                loaded(module)
                register()

            spec.loader.exec_module = load  # type: ignore[method-assign]
        return spec


def register_when_imported() -> None:
    """Register the environments now if Gymnasium is imported, else when it is."""
    if hasattr(sys.modules.get("gymnasium"), "make"):
        register()
    elif "gymnasium" not in sys.modules and not any(
        isinstance(finder, _WhenImported) for finder in sys.meta_path
    ):
        sys.meta_path.insert(0, _WhenImported())


def __getattr__(name: str) -> Any:
    # They import Gymnasium, an extra.
    if name in _HOMES:
        from importlib import import_module

        return getattr(import_module(f".{_HOMES[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
