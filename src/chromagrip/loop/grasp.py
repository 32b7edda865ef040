"""The closed loop: model → camera → tracking → control → model, one sample a frame."""

import math
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..control import Controller, GripObservation
from ..errors import UserError, located
from ..model import (
    Fingertip,
    ForceField,
    ModelError,
    SlipRecord,
    State,
    contact_forces,
    follow_slip,
    no_slip,
    pressure,
    rest_state,
    steps,
    touching,
    whole_friction,
)
from ..render import Frame, open_renderer
from ..scene.scene import Scene
from ..tracking import (
    SensorCalibration,
    Tracks,
    load_calibration,
    nominal_calibration,
    shipped_readout,
)
from .camera import SimulatedCamera
from .observers import CameraObserver, TruthObserver, with_friction_off

#: Share of itself by which a force may change within what counts as calm.
_LITTLE = 0.01
#: Stream of random numbers that lost and late frames are drawn from; those below are defects'.
_DELIVERY = 20


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One frame of a run, truth beside estimate.

    Attributes
    ----------
    index: of the frame
    state, field, slip: truth
    load: lateral load on the object [N]
    friction: true µ of the contact as a whole, see `whole_friction`
    grip: force commanded from now on [N]
    applied: force of the gripper's drive now [N]
    pressure, pressure_pitch: true pressure, without and with one node pitch added [N/m]
    observation: what the controller will be told of this frame, after the latency; None of a
        dropped one
    frame, tracks, rest: image, markers in it and at rest; None on the truth path, the first two
        also of a dropped frame
    """

    index: int
    state: State
    field: ForceField
    slip: SlipRecord
    load: float
    friction: float
    grip: float
    applied: float
    pressure: float
    pressure_pitch: float
    observation: GripObservation | None
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
    renderer = open_renderer(scene.renderer, sensor)
    return SimulatedCamera(
        sensor,
        renderer,
        scene.fingertip.nodes,
        scene.camera.noise_levels,
        scene.seed,
        scene.defects,
    )


def grasp(
    scene: Scene,
    camera: SimulatedCamera,
    fingertip: Fingertip | None = None,
    known: SensorCalibration | None = None,
) -> Iterator[Sample]:
    """Samples of a grasp, as they happen.

    With a latency of L frames the command of frame k rests on frame k − L; until then, and while
    no frame arrives, the grip holds: at first the controller's answer to the first frame.

    Parameters
    ----------
    scene: what happens
    camera: that looks on
    fingertip, known: that grasps, and what the estimator is told of it; None are the scene's

    Raises
    ------
    UserError
        When a controller raises, or answers what is no finite force of at least 0.
    """
    if scene.build_sensor().shape.flat:
        raise UserError(
            f"sensor {scene.sensor} is a flat pad; the node model that grasps is a dome"
        )
    tip = scene.build_fingertip() if fingertip is None else fingertip
    obj, controller = scene.build_object(), scene.build_controller()
    state, slip = rest_state(tip), no_slip(tip.nodes)
    field = contact_forces(tip, obj, state)
    window = scene.safety_margin.friction_window_s
    seen: CameraObserver | None = None
    truth = TruthObserver(window, scene.truth.margin_noise, scene.seed)
    if scene.path == "camera":
        rest = camera.expose_rest(state, scene.camera.rest_frames)
        noise = scene.camera.noise_levels
        with located(f"sensor {scene.sensor}"):
            told = known_sensor(scene) if known is None else known
            seen = CameraObserver(told, scene.tracker, scene.reconstructor, noise, window, rest)
    substeps = max(1, math.ceil(scene.period * 1e3 / scene.fingertip.step_ms - 1e-9))
    dt = scene.period / substeps
    # The substep after which the middle of the next frame's exposure has come.
    middle = substeps - round(0.5e-3 * scene.camera.exposure_ms / dt)
    due, waiting = arrivals(scene), deque[tuple[int, int, GripObservation]]()
    shown = state, field, slip.current
    applied, grip = 0.0, math.nan
    before = np.full(2, math.inf)
    _reset(controller, scene.controller)
    for index in range(scene.frames):
        observation, frame, tracks = None, None, None
        if due[index] >= 0:
            if seen is None:
                observation = truth.observe(state.time, *shown[1:])
            else:
                frame = camera.expose(replace(shown[0], time=state.time), index)
                observation, tracks = seen.observe(frame)
            observation = with_friction_off(observation, scene.camera.friction_bias)
            waiting.append((int(due[index]), index, observation))
            if index == 0:
                grip = _answer(controller, observation, scene.controller, index)
                _reset(controller, scene.controller)
        while waiting and waiting[0][0] <= index:
            _, number, observed = waiting.popleft()
            grip = _answer(controller, observed, scene.controller, number)
        yield Sample(
            index=index,
            state=state,
            field=field,
            slip=slip,
            load=scene.load.force(state.time + 1e-9),
            friction=whole_friction(tip, obj, state, field),
            grip=grip,
            applied=applied,
            pressure=pressure(field),
            pressure_pitch=pressure(field, tip.pitch),
            observation=observation,
            frame=frame,
            tracks=tracks,
            rest=None if seen is None else seen.rest,
        )
        start = index * scene.period
        command = scene.actuator.rounded(grip)
        halfway = start + (np.arange(substeps) + 0.5) * dt
        forces = np.empty((substeps, 2))
        for k, time in enumerate(halfway.tolist()):
            applied = scene.actuator.follow(applied, command, dt)
            forces[k] = applied, scene.load.force(time)
        parts = [(obj, dt, forces)]
        at = middle
        if scene.object.changes:  # it is another one in each step
            parts = [
                (scene.build_object(time), dt, forces[k : k + 1])
                for k, time in enumerate(halfway.tolist())
            ]
        elif middle == substeps and _calm(scene, state, before, forces):
            parts, at = [(obj, scene.period, forces[-1:])], 1
        before = forces[-1]
        for obj, length, pushed in parts:
            try:
                run = steps(tip, obj, state, length, pushed)
            except ModelError as error:
                raise UserError(f"the node model gave up: {error}") from None
            slips = follow_slip(slip, run, touching(tip, obj, run), length)
            state, slip = run.state(-1), slips[-1]
            field = contact_forces(tip, obj, state)
            if at == len(pushed):
                shown = state, field, slip.current
            elif 0 < at < len(pushed):
                then = run.state(at)
                shown = then, contact_forces(tip, obj, then), slips[at - 1].current
            at -= len(pushed)
        # Sums of steps round; frames are counted.
        state = replace(state, time=(index + 1) * scene.period)


def _calm(
    scene: Scene, state: State, before: NDArray[np.float64], forces: NDArray[np.float64]
) -> bool:
    """Whether so little moves, and grip and load change so little, that one step is enough.

    An implicit step follows what is slow whatever its length; a change within it comes at its end.
    """
    if abs(state.rate).max() >= 1e-6 * scene.fingertip.calm_um_per_s:
        return False
    changes = np.ptp(np.vstack([before, forces]), axis=0)
    return bool((changes <= _LITTLE * abs(forces[-1])).all())


def arrivals(scene: Scene) -> NDArray[np.intp]:
    """Number of the frame at whose instant each frame reaches the controller, −1 for dropped ones.

    Drawn from the scene's seed; the first frame, which starts the grip, is never dropped.
    """
    rng = np.random.default_rng([scene.seed, _DELIVERY])
    lost, late = rng.random((scene.frames, 2)).T
    due = np.arange(scene.frames) + scene.camera.latency_frames + (late < scene.camera.late)
    due[1:][lost[1:] < scene.camera.dropped] = -1
    return due


def known_sensor(scene: Scene) -> SensorCalibration:
    """What the estimator is told of the sensor: its calibration, or that it is as designed."""
    if scene.calibration:
        return load_calibration(scene.calibration)
    known = nominal_calibration(scene.build_sensor(), scene.fingertip.model)
    return replace(known, readout=shipped_readout(scene.sensor))


def _reset(controller: Controller, name: str) -> None:
    with _blaming(name, "before the first sample"):
        controller.reset()


def _answer(controller: Controller, observation: GripObservation, name: str, index: int) -> float:
    """Force that a controller commands [N] when told of that frame."""
    at = f"at t = {observation.time:.4g} s, sample {index}"
    with _blaming(name, at):
        force = float(controller.command(observation).force)
    if math.isfinite(force) and force >= 0.0:
        return force
    raise UserError(
        f"controller {name} commanded {force!r} N {at}; a grip force is finite and not negative"
    )


@contextmanager
def _blaming(name: str, at: str) -> Iterator[None]:
    """Say which controller raised what is raised in here."""
    try:
        yield
    except Exception as reason:  # whatever anybody's controller raises
        raise UserError(
            f"controller {name} failed {at}: {type(reason).__name__}: {reason}"
        ) from reason
