"""The closed loop: model → camera → tracking → control → model, one sample a frame."""

import math
from collections.abc import Iterator

from ..model import Fingertip
from ..scene.controllers import CONTROLLERS
from ..scene.scene import Scene
from ..sensing.camera import SimulatedCamera
from ..tracking import SensorCalibration
from .latency import HoldingController
from .methods import Methods
from .rig import Rig
from .sample import Sample


def grasp(
    scene: Scene,
    camera: SimulatedCamera | None,
    fingertip: Fingertip | None = None,
    known: SensorCalibration | None = None,
    methods: Methods | None = None,
    answer_within: float = math.inf,
) -> Iterator[Sample]:
    """Run a grasp; yields a sample after each frame.

    Parameters
    ----------
    scene: scene with object, load, fingertip, camera and methods
    camera: camera that takes the frames; None on the truth path
    fingertip: chain that grips (default: the scene's)
    known: calibration of the estimator (default: the scene's)
    methods: controller, tracker and reconstructor (default: the scene's)
    answer_within: time in which a controller that is not ours must answer (default: no limit) [s]

    Raises
    ------
    UserError
        For a flat sensor; when the node model fails; when a controller raises, does not answer in
        time, or its answer is not a finite force of at least 0.
    """
    methods = methods or Methods.of_scene(scene)
    yield from gripped(
        Rig(scene, methods, camera=camera, fingertip=fingertip, known=known), answer_within
    )


def gripped(rig: Rig, answer_within: float = math.inf) -> Iterator[Sample]:
    """Run a rig's grasp with its controller, with one finger or two; see `grasp`."""
    scene, methods = rig.scene, rig.methods
    limit = math.inf if scene.controller in CONTROLLERS.entries else answer_within
    controller = HoldingController(methods.build_controller(scene), scene.controller, limit)
    controller.start(rig.reset())
    while True:
        grip = controller.command(rig.arrived)
        yield rig.sample(grip)
        if rig.done:
            return
        rig.step(grip)
