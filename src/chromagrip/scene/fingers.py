"""The fingers of a scene, each as a scene of its own."""

import msgspec

from ..errors import UserError
from ..model.pinch import Pinch
from .pinch import PinchSettings
from .scene import Scene


def fingers(scene: Scene) -> tuple[Scene, ...]:
    """Split a scene into a one-finger scene for each finger, with its own sensor and seed."""
    return {1: lambda one: (one,), 2: _both}[scene.fingers](scene)


def _both(scene: Scene) -> tuple[Scene, Scene]:
    single = msgspec.structs.replace(scene, fingers=1, pinch=PinchSettings())
    second_seed = 7_919  # difference between the seed of the second finger's camera and the scene's
    second = msgspec.structs.replace(
        single,
        sensor=scene.pinch.second_sensor or scene.sensor,
        seed=(scene.seed + second_seed) % 2**32,
    )
    return single, second


def need_one_finger(scene: Scene, what: str) -> None:
    """Refuse a scene of two fingers; `what` begins the sentence, as in "the live page shows"."""
    if scene.fingers > 1:  # whoever knows one finger asks here
        raise UserError(f"{what} one finger; this scene is a pinch of two")


def build_pinch(scene: Scene) -> Pinch:
    """Build both fingertips of a pinch and the object that they hold.

    Raises
    ------
    UserError
        For a second sensor without silicone.
    """
    first, second = (each.build_dome() for each in fingers(scene))
    return scene.pinch.build(first, second, scene.build_solid(), scene.object)
