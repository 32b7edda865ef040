"""Gymnasium environments around the grip loop, with one finger and with two.

Importing this package registers its environments if Gymnasium is installed:

    import chromagrip.gym
    import gymnasium

    env = gymnasium.make("chromagrip/Pinch-v0", observation="forces")
"""

from importlib.util import find_spec

#: Keyword arguments of each environment, by its name.
ENVIRONMENTS: dict[str, dict[str, object]] = {
    "chromagrip/Grasp-v0": {},
    "chromagrip/Pinch-v0": {"scene": "pinch-lift", "most_n": 10.0},
}


def _register() -> None:
    from gymnasium.envs.registration import register, registry

    for name, arguments in ENVIRONMENTS.items():
        if name not in registry:
            register(name, entry_point=f"{__name__}.environment:GripEnv", kwargs=arguments)


if find_spec("gymnasium") is not None:
    _register()
