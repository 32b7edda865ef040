"""Gymnasium environments around the grip loop, and tactile observations for other environments.

Importing this module registers the environments, as does `import chromagrip` after
`import gymnasium`:

    import chromagrip.gym
    import gymnasium

    env = gymnasium.make("chromagrip/Pinch-v0", observation="forces")

`TactileObservation` and `VectorTactileObservation` add a sensor to an environment that knows
nothing of it.
"""

from importlib import import_module
from typing import Any

from ..extras import need

_register = need("gymnasium", "rl").register
_MADE_BY = f"{__name__}.environment:GripEnv"
_register("chromagrip/Grasp-v0", entry_point=_MADE_BY)
_register(
    "chromagrip/Pinch-v0", entry_point=_MADE_BY, kwargs={"scene": "pinch-lift", "most_n": 10.0}
)


def __getattr__(name: str) -> Any:
    # Their sensors are imported where they are used: a registration alone needs none.
    if name in ("TactileObservation", "VectorTactileObservation"):
        return getattr(import_module(".tactile", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
