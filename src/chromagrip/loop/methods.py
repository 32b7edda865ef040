"""Methods of a run: those that a scene names, or objects and classes from Python."""

import inspect
from dataclasses import dataclass
from typing import Any, Self

import msgspec

from ..by_name import Choice, name_of
from ..control import Controller
from ..errors import UserError, located
from ..scene.controllers import CONTROLLERS
from ..scene.scene import Body, Scene
from ..sensing.reader import known_sensor
from ..strict_toml import Values
from ..tracking import (
    AUTOMATIC,
    DEFAULT_RECONSTRUCTOR,
    METHODS,
    SensorCalibration,
    check_reconstructor,
)
from ..tracking.forces import DOME_METHODS


@dataclass(frozen=True, kw_only=True)
class Methods:
    """Methods of a run; each is a name, or a class or other factory.

    Attributes
    ----------
    controller: controller; also an object with the methods `reset` and `command`
    tracker: tracker, made with a palette and the camera's noise [grey levels]
    reconstructor: reconstructor, made with a calibration and the tracks at rest
    renderer: renderer, made with the design of a sensor
    """

    controller: Choice | Controller
    tracker: Choice
    reconstructor: Choice
    renderer: Choice

    @classmethod
    def of_scene(cls, scene: Scene) -> Self:
        """Methods that a scene names; `auto` becomes the reconstructor of the scene's body."""
        camera = scene.path == "camera"
        name = scene.reconstructor
        return cls(
            controller=scene.controller,
            tracker=scene.tracker,
            reconstructor=reconstructor_for(scene.body, name) if camera else name,
            renderer=scene.renderer,
        )

    def build_controller(self, scene: Scene) -> Controller:
        """Build the controller; a named one gets the scene's settings or arguments."""
        if isinstance(self.controller, str):
            return scene.build_controller()
        controller: Controller = CONTROLLERS.build(self.controller)
        return controller


def reconstructor_for(body: Body, name: str) -> str:
    """Name of the reconstructor for a body; `auto` becomes the name of the one that it selects.

    Raises
    ------
    UserError
        For one of ours that is for another body.
    """
    if name == DEFAULT_RECONSTRUCTOR:
        return AUTOMATIC[body]
    allowed = {
        "chain": [other for other in METHODS if other not in DOME_METHODS],
        "dome": DOME_METHODS,
    }[body]
    if name in METHODS and name not in allowed:
        raise UserError(
            f'reconstructor {name} does not read body = "{body}"; allowed are auto, '
            f"{', '.join(allowed)}"
        )
    return name


def choose(scene: Scene, **choices: Any) -> tuple[Scene, Methods]:
    """Replace a scene's methods; returns the scene with their names, and the methods themselves.

    On the camera path the reconstructor `auto` is replaced with the name of the one it selects.

    Parameters
    ----------
    scene: scene whose methods are used if not chosen
    choices: choice of each method of `Methods`, by name; None: the scene's. A controller is loaded
        for its target where it is among them: the scene's code is not run where no controller is

    Raises
    ------
    UserError
        For an unknown name, and for a reconstructor for another body.
    """
    chosen = {kind: choice for kind, choice in choices.items() if choice is not None}
    names: dict[str, Any] = {kind: name_of(choice) for kind, choice in chosen.items()}
    reconstructor = names.get("reconstructor", scene.reconstructor)
    if scene.path == "camera":
        names["reconstructor"] = reconstructor_for(scene.body, reconstructor)
    if "controller" in choices:
        own = {} if "controller" in chosen else scene.controller_arguments
        controller = chosen.get("controller", scene.controller)
        names["controller_arguments"] = _own_target(controller) | own
    scene = msgspec.structs.replace(scene, **names)
    return scene, Methods(**{**vars(Methods.of_scene(scene)), **chosen})


def _own_target(controller: Any) -> Values:
    """Target of a controller of one's own by default: that of its argument `desired_margin`."""
    if isinstance(controller, str):
        if controller in CONTROLLERS.entries:
            return {}
        controller = CONTROLLERS.load(controller)
    try:
        argument = inspect.signature(controller).parameters.get("desired_margin")
    except (TypeError, ValueError):  # an object that is no factory, or one without a signature
        target = getattr(controller, "desired_margin", None)
    else:
        target = argument and argument.default
    return {"desired_margin": target} if isinstance(target, float | int) else {}


def readable(scene: Scene, methods: Methods) -> SensorCalibration | None:
    """Calibration for reading a scene's pictures; None on the truth path and for a pad.

    Raises
    ------
    UserError
        For a reconstructor that cannot read them.
    """
    if scene.path == "truth" or scene.build_sensor().shape.flat:
        return None
    with located(f"sensor {scene.sensor}"):
        known = known_sensor(scene)
        check_reconstructor(methods.reconstructor, known)
    return known
