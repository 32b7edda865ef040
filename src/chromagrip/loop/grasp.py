"""The closed loop: model → camera → tracking → control → model, one sample a frame."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from ..control import GripObservation
from ..errors import UserError, located
from ..model import Fingertip, ForceField, SlipRecord, State, pressure
from ..model.dome import DomeSlip
from ..render import Frame, open_renderer
from ..scene.scene import Scene
from ..tracking import (
    SensorCalibration,
    Tracks,
    load_calibration,
    sensor_as_designed,
)
from .camera import SimulatedCamera
from .dome_world import DomePlant
from .latency import DelayedController, arrivals
from .methods import Methods
from .observers import CameraObserver, TruthObserver, with_friction_bias
from .torsion import held, with_limit_margin
from .world import ChainPlant, Contact, Plant, World


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One frame of a run, truth beside estimate.

    Attributes
    ----------
    index: of the frame
    truth: of the contact
    load: lateral load on the object [N]
    grip: force commanded from now on [N]
    applied: force of the gripper's drive now [N]
    pressure, pressure_pitch: true pressure, without and with one node pitch added [N/m]
    observation: of this frame, with Γ as its margin; the controller is given it after the latency,
        with the margin that it is to hold; None of a dropped frame
    frame, tracks, rest: image, markers in it and at rest; None on the truth path, the first two
        also of a dropped frame
    """

    index: int
    truth: Contact
    load: float
    grip: float
    applied: float
    pressure: float
    pressure_pitch: float
    observation: GripObservation | None
    frame: Frame | None
    tracks: Tracks | None
    rest: Tracks | None

    @property
    def state(self) -> State:
        """State of the chain.

        Raises
        ------
        UserError
            For a dome.
        """
        if not isinstance(self.truth.state, State):
            raise UserError('the scene has body = "dome"; this needs body = "chain"')
        return self.truth.state

    @property
    def time(self) -> float:
        """Instant of the frame [s]."""
        return self.truth.state.time

    @property
    def field(self) -> ForceField:
        """True forces."""
        return self.truth.field

    @property
    def slip(self) -> SlipRecord | DomeSlip:
        """True slip of the object so far."""
        return self.truth.slip

    @property
    def friction(self) -> float:
        """True µ of the contact as a whole, see `whole_friction`."""
        return self.truth.friction


def open_camera(scene: Scene, methods: Methods | None = None) -> SimulatedCamera:
    """Camera of a scene; close it after the run.

    Raises
    ------
    UserError
        When the renderer cannot run on this machine.
    """
    sensor = scene.build_sensor()
    renderer = open_renderer(methods.renderer if methods else scene.renderer, sensor)
    return SimulatedCamera(
        sensor,
        renderer,
        scene.build_dome() if scene.body == "dome" else scene.fingertip.nodes,
        scene.camera.noise_levels,
        scene.seed,
        scene.defects,
    )


def grasp(
    scene: Scene,
    camera: SimulatedCamera | None,
    fingertip: Fingertip | None = None,
    known: SensorCalibration | None = None,
    methods: Methods | None = None,
) -> Iterator[Sample]:
    """Samples of a grasp, as they happen.

    Parameters
    ----------
    scene: object, load, fingertip, camera and methods
    camera: that takes the frames; the truth path needs none
    fingertip, known: chain that grips, and calibration of the estimator; None are the scene's
    methods: controller, tracker and reconstructor; None are the scene's

    Raises
    ------
    UserError
        For a flat sensor; when the node model cannot go on; when a controller raises, or its
        answer is not a finite force of at least 0.
    """
    methods = methods or Methods.of_scene(scene)
    plant = _plant(scene, fingertip)
    world, due = plant.rest(), arrivals(scene)
    controller = DelayedController(methods.build_controller(scene), scene.controller, due)
    if scene.path == "camera":
        with located(f"sensor {scene.sensor}"):
            known = known_sensor(scene) if known is None else known
        assert camera is not None
        read = _camera_readings(scene, camera, world, known, methods)
    else:
        read = _truth_readings(scene)
    for index in range(scene.frames):
        reading = read(world, index if due[index] >= 0 else None)
        seen = reading.observation
        grip = controller.command(index, seen and held(seen, scene.held_margin))
        yield _sample(plant, world, index, grip, reading)
        if index + 1 < scene.frames:
            world = plant.next_frame(world, grip, index)


def _plant(scene: Scene, fingertip: Fingertip | None) -> Plant:
    """Body of a scene, with a fingertip in place of the scene's chain."""
    if scene.body == "dome":
        return DomePlant(scene)
    if scene.build_sensor().shape.flat:
        raise UserError(
            f"sensor {scene.sensor} is a flat pad; the node model that grasps is a dome"
        )
    return ChainPlant(scene, scene.build_fingertip() if fingertip is None else fingertip)


@dataclass(frozen=True, kw_only=True)
class Reading:
    """Observation of a frame, with its image and tracks; attributes as in `Sample`."""

    observation: GripObservation | None = None
    frame: Frame | None = None
    tracks: Tracks | None = None
    rest: Tracks | None = None


#: Reads a frame of that index; None is a dropped one.
Read = Callable[[World, int | None], Reading]


def _truth_readings(scene: Scene) -> Read:
    """Readings of the true forces in the middle of a frame's exposure."""
    window = scene.safety_margin.friction_window_s
    observer = TruthObserver(window, scene.truth.margin_noise, scene.seed)

    def read(world: World, index: int | None) -> Reading:
        if index is None:
            return Reading()
        time, exposed = world.now.state.time, world.exposed
        observation = observer.observe(time, exposed.field, exposed.slip.current)
        observation = with_friction_bias(observation, scene.camera.friction_bias)
        return Reading(observation=with_limit_margin(observation))

    return read


def _camera_readings(
    scene: Scene,
    camera: SimulatedCamera,
    world: World,
    known: SensorCalibration,
    methods: Methods,
) -> Read:
    """Readings of the camera's frames, by an observer that was given frames at rest."""
    rest = camera.expose_rest(world.now.state, scene.camera.rest_frames)
    with located(f"sensor {scene.sensor}"):
        observer = CameraObserver(
            known,
            methods.tracker,
            methods.reconstructor,
            scene.camera.noise_levels,
            scene.safety_margin.friction_window_s,
            rest,
        )

    def read(world: World, index: int | None) -> Reading:
        if index is None:
            return Reading(rest=observer.rest)
        # The picture is of the exposure's middle; its time is the frame's.
        state = replace(world.exposed.state, time=world.now.state.time)
        frame = camera.expose(state, index)
        observation, tracks = observer.observe(frame)
        observation = with_friction_bias(observation, scene.camera.friction_bias)
        observation = with_limit_margin(observation)
        return Reading(observation=observation, frame=frame, tracks=tracks, rest=observer.rest)

    return read


def _sample(plant: Plant, world: World, index: int, grip: float, reading: Reading) -> Sample:
    now = world.now
    return Sample(
        index=index,
        truth=now,
        load=plant.scene.load.force(now.state.time + 1e-9),
        grip=grip,
        applied=world.applied,
        pressure=pressure(now.field),
        pressure_pitch=pressure(now.field, plant.pitch),
        observation=reading.observation,
        frame=reading.frame,
        tracks=reading.tracks,
        rest=reading.rest,
    )


def known_sensor(scene: Scene) -> SensorCalibration:
    """Calibration of a scene's sensor: from its file, or that of a sensor as designed."""
    if scene.calibration:
        return load_calibration(scene.calibration)
    return sensor_as_designed(scene.sensor, scene.fingertip.model)
