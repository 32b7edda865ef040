"""The closed loop: model → camera → tracking → control → model, one sample a frame."""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace

from .camera import SimulatedCamera
from .control import Controller, GripCommand, GripObservation
from .errors import UserError
from .model import (
    ForceField,
    ModelError,
    SlipRecord,
    State,
    contact_forces,
    follow_slip,
    no_slip,
    pressure,
    rest_state,
    step,
)
from .observers import CameraObserver, TruthObserver
from .render import Frame, GLMissingError, open_renderer
from .scene import Scene
from .tracking import (
    CalibrationFileError,
    DetectionError,
    ReadOutError,
    ReconstructorError,
    SensorCalibration,
    Tracks,
    UnsupportedSensorError,
    load_calibration,
    nominal_calibration,
    shipped_readout,
)


class ControllerError(UserError):
    """A controller that answered something no gripper can do."""


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One frame of a run, truth beside estimate.

    Attributes
    ----------
    index: of the frame
    state, field, slip: truth
    load: lateral load on the object [N]
    grip: force applied from now on [N]
    pressure, pressure_pitch: true pressure, without and with one node pitch added [N/m]
    observation: what the controller will be told of this frame, after the latency
    frame, tracks, rest: image, markers in it and at rest; None on the truth path
    """

    index: int
    state: State
    field: ForceField
    slip: SlipRecord
    load: float
    grip: float
    pressure: float
    pressure_pitch: float
    observation: GripObservation
    frame: Frame | None
    tracks: Tracks | None
    rest: Tracks | None


def open_camera(scene: Scene) -> SimulatedCamera:
    """Camera of a scene; close it after the run.

    Raises
    ------
    UserError
        When the renderer cannot run on this machine.
    """
    sensor = scene.build_sensor()
    try:
        renderer = open_renderer(scene.renderer, sensor)
    except GLMissingError as error:
        raise UserError(str(error)) from None
    return SimulatedCamera(
        sensor,
        renderer,
        scene.fingertip.nodes,
        scene.camera.noise_levels,
        scene.seed,
        scene.defects,
    )


def grasp(scene: Scene, camera: SimulatedCamera) -> Iterator[Sample]:
    """Samples of a grasp, as they happen.

    With a latency of L frames the command of frame k rests on frame k − L; until then the grip
    holds the controller's answer to the first frame.

    Raises
    ------
    ControllerError
        When a controller answers NaN or a negative force.
    """
    if scene.build_sensor().shape.flat:
        raise UserError(
            f"sensor {scene.sensor} is a flat pad; the node model that grasps is a dome"
        )
    tip, obj, controller = scene.build_fingertip(), scene.build_object(), scene.build_controller()
    state, slip = rest_state(tip), no_slip(tip.nodes)
    field = contact_forces(tip, obj, state)
    window = scene.safety_margin.friction_window_s
    seen: CameraObserver | None = None
    truth = TruthObserver(window, scene.truth.margin_noise, scene.seed)
    if scene.path == "camera":
        rest = camera.expose_rest(state, scene.camera.rest_frames)
        noise = scene.camera.noise_levels
        try:
            known = _known(scene)
            seen = CameraObserver(known, scene.reconstructor, noise, window, rest)
        except (
            CalibrationFileError,
            DetectionError,
            ReadOutError,
            ReconstructorError,
            UnsupportedSensorError,
        ) as error:
            raise UserError(f"sensor {scene.sensor}: {error}") from None
    substeps = max(1, math.ceil(scene.period * 1e3 / scene.fingertip.step_ms - 1e-9))
    dt = scene.period / substeps
    waiting: deque[GripObservation] = deque()
    grip = math.nan
    controller.reset()
    for index in range(scene.frames):
        frame, tracks = None, None
        if seen is None:
            observation = truth.observe(state.time, field, slip.current)
        else:
            frame = camera.expose(state, index)
            observation, tracks = seen.observe(frame)
        if index == 0:
            grip = _checked(controller, observation, scene.controller)
            controller.reset()
        waiting.append(observation)
        if index >= scene.camera.latency_frames:
            grip = _checked(controller, waiting.popleft(), scene.controller)
        yield Sample(
            index=index,
            state=state,
            field=field,
            slip=slip,
            load=scene.load.force(state.time + 1e-9),
            grip=grip,
            pressure=pressure(field),
            pressure_pitch=pressure(field, tip.pitch),
            observation=observation,
            frame=frame,
            tracks=tracks,
            rest=None if seen is None else seen.rest,
        )
        start = index * scene.period
        for k in range(substeps):
            load = scene.load.force(start + (k + 0.5) * dt)
            try:
                state = step(tip, obj, state, dt, grip, load)
            except ModelError as error:
                raise UserError(f"the node model gave up: {error}") from None
            field = contact_forces(tip, obj, state)
            slip = follow_slip(slip, state, field, dt)
        # Sums of steps round; frames are counted.
        state = replace(state, time=(index + 1) * scene.period)


def _known(scene: Scene) -> SensorCalibration:
    """What the estimator is told of the sensor: its calibration, or that it is as designed."""
    if scene.calibration:
        return load_calibration(scene.calibration)
    known = nominal_calibration(scene.build_sensor(), scene.fingertip.model)
    return replace(known, readout=shipped_readout(scene.sensor))


def _checked(controller: Controller, observation: GripObservation, name: str) -> float:
    command: GripCommand = controller.command(observation)
    if math.isfinite(command.force) and command.force >= 0.0:
        return command.force
    raise ControllerError(
        f"controller {name} commanded {command.force!r} N at t = {observation.time:.4g} s; "
        "a grip force is finite and not negative"
    )
