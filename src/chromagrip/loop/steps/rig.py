"""A grasp, frame by frame: `reset`, then a grip force for each step, until the scene is over.

    with chromagrip.open("margin-60hz") as rig:
        seen = rig.reset(seed=1)
        while not rig.done:
            seen = rig.step(grip=2.0)

`grasp` is this loop with a controller in it.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import msgspec

from ...control import GripObservation
from ...errors import UserError, located
from ...model import Fingertip
from ...render import Frame
from ...scene.fingers import fingers
from ...scene.scene import Scene
from ...tracking import SensorCalibration, check_reconstructor
from ..camera import CameraMemory, SimulatedCamera, open_camera
from ..dome_world import DomePlant
from ..latency import Arrived, Delivery, arrivals, checked_force
from ..methods import Methods
from ..observers import known_sensor
from ..pinch_world import PinchPlant
from ..torsion import held
from ..world import ChainPlant
from .readers import CameraReader, Reader, Reading, TruthReader, exposed_state
from .sample import Sample


@dataclass(frozen=True, kw_only=True)
class RigState:
    """Everything that the next step of a rig starts from; for rigs of the same scene.

    Attributes
    ----------
    scene: with the seed that the grasp was reset with
    index: of the frame
    world: of that frame
    readings: of each finger in that frame
    smaller: finger whose observation goes to the controller
    readers: of each finger, that go on from there
    delivery: observations on their way
    cameras: what each camera remembers of the frames before; empty without cameras
    """

    scene: Scene
    index: int
    world: Any
    readings: tuple[Reading, ...]
    smaller: int
    readers: tuple[Reader, ...]
    delivery: Delivery
    cameras: tuple[CameraMemory, ...]


class Rig:
    """A scene that is gripped frame by frame; the same seed and grips give the same bytes.

    Each finger has its own camera, specimen and observer. A controller is given the observation
    of the finger whose margin is smaller.

    Parameters
    ----------
    scene: object, load, fingertip, camera and methods
    methods: tracker and reconstructor; None are the scene's
    camera: that takes the frames of one finger; None opens the scene's when first needed
    fingertip, known: chain that grips, and calibration of the estimator; None are the scene's

    Raises
    ------
    UserError
        For a flat sensor, and one whose pictures cannot be read.
    """

    def __init__(
        self,
        scene: Scene,
        methods: Methods | None = None,
        *,
        camera: SimulatedCamera | None = None,
        fingertip: Fingertip | None = None,
        known: SensorCalibration | None = None,
    ) -> None:
        self.scene = scene
        self.methods = methods or Methods.of_scene(scene)
        self.plant = _plant(scene, fingertip)
        self._cameras = [] if camera is None else [camera]
        self._own = camera is None
        self.known = [known or readable(each, self.methods) for each in self._fingers]
        self._index = -1
        self._world: Any = None
        self._readings: tuple[Reading, ...] = ()
        self._smaller = 0
        self._readers: tuple[Reader, ...] = ()
        self._delivery: Delivery

    @property
    def _fingers(self) -> tuple[Scene, ...]:
        """Scene as each finger has it."""
        return fingers(self.scene) if self.scene.pinch.mass_g else (self.scene,)

    @property
    def index(self) -> int:
        """Number of the frame, from 0; −1 before the first reset."""
        return self._index

    @property
    def time(self) -> float:
        """Instant of the frame [s]."""
        self._check_begun("time")
        return float(self._world.now.state.time)

    @property
    def truth(self) -> Any:
        """True contact, of two fingers both and the object; not for a controller."""
        self._check_begun("truth")
        return self._world.now

    @property
    def applied(self) -> float:
        """Force of the gripper's drive [N]."""
        self._check_begun("applied")
        return float(self._world.applied)

    @property
    def readings(self) -> tuple[Reading, ...]:
        """What was read of this frame by each finger, before the latency."""
        self._check_begun("readings")
        return self._readings

    @property
    def reading(self) -> Reading:
        """The same of the finger whose margin is smaller."""
        return self.readings[self._smaller]

    @property
    def done(self) -> bool:
        """Whether this is the scene's last frame."""
        return self._index + 1 == self.scene.frames

    @property
    def arrived(self) -> tuple[Arrived, ...]:
        """Frames that reach a controller at this one, in their order, each with its observation.

        After the latency; a late frame comes together with the next one.
        """
        self._check_begun("arrived")
        return self._delivery.arrived(self._index)

    def reset(self, seed: int | None = None) -> GripObservation:
        """Begin the grasp anew, with the object at the fingertip and nothing gripped yet.

        Parameters
        ----------
        seed: of all random numbers; None is the one that the rig has

        Returns
        -------
        Observation of the first frame, which is there at once: a grip starts from it.
        """
        if seed is not None and seed != self.scene.seed:
            self._reseed(seed)
        self._index = -1  # until everything below has gone well
        self._world = self.plant.rest()
        for camera in self._cameras:
            camera.recall(None)
        self._readers = tuple(self._reader(k, each) for k, each in enumerate(self._fingers))
        self._delivery = Delivery(arrivals(self.scene))
        seen = self._read(0)
        assert seen is not None  # the first frame is never dropped
        return seen

    def step(self, grip: float) -> GripObservation | None:
        """Grip with a force until the next frame.

        Parameters
        ----------
        grip: force that is commanded from now on [N]

        Returns
        -------
        The newest observation that arrives at the next frame, with the margin that is to be held;
        None where none arrives, because of the latency or of a dropped frame.

        Raises
        ------
        UserError
            Before `reset`; after the scene's last frame; for a force that is not finite or is
            negative; when the model cannot go on.
        """
        self._check_begun("step()")
        if self.done:
            raise UserError(
                f"the grasp ended with frame {self._index} at t = {self.time:.4g} s; "
                "call reset() before the next step()"
            )
        grip = checked_force(grip, f"step() at frame {self._index} was given")
        self._world = self.plant.next_frame(self._world, grip, self._index)
        self._read(self._index + 1)
        arrived = self.arrived
        return arrived[-1].observation if arrived else None

    def change(self, scene: Scene) -> None:
        """Go on from this frame with the load, the µ and the stiffness of another scene.

        The same scene with these values from its start would have come to another state.

        Raises
        ------
        UserError
            Before `reset`; for a scene that differs elsewhere; for a load along an axis that the
            object is held in.
        """
        self._check_begun("change()")
        ours, theirs = self.scene.object, scene.object
        alike = msgspec.structs.replace(
            ours, friction=theirs.friction, stiffness_kpa=theirs.stiffness_kpa
        )
        if msgspec.structs.replace(self.scene, load=scene.load, object=alike) != scene:
            raise UserError(
                "during a grasp only load, object.friction and object.stiffness_kpa can change; "
                "anything else needs a rig of its own"
            )
        self._world = self.plant.changed(self._world, scene)
        self.scene = scene

    def sample(self, grip: float = math.nan) -> Sample:
        """The frame, truth beside estimate.

        Parameters
        ----------
        grip: force that is commanded from now on [N]
        """
        self._check_begun("sample()")
        return Sample(
            index=self._index,
            truth=self._world.now,
            load=self.scene.load.force(self.time + 1e-9),
            grip=grip,
            applied=self._world.applied,
            pitch=self.plant.pitch,
            readings=self._readings,
            smaller=self._smaller,
        )

    def pictures(self) -> tuple[Frame, ...]:
        """Each camera's picture of this frame, also on the truth path and of a dropped frame."""
        self._check_begun("pictures()")
        return tuple(self._picture(k) for k in range(len(self._readings)))

    def picture(self) -> Frame:
        """The only camera's picture, as `pictures`."""
        self._check_begun("picture()")
        (only,) = self.pictures()
        return only

    def rest_pictures(self) -> tuple[Frame, ...]:
        """Each camera's picture of the untouched finger, with noise that is in no other frame."""
        world = self.plant.rest()
        states = [world.finger(k).now.state for k in range(len(self._fingers))]
        return tuple(self._camera(k).expose_rest(s, 1)[0] for k, s in enumerate(states))

    def save(self) -> RigState:
        """State of the grasp, from which it can go on later, as often as is wanted."""
        self._check_begun("save()")
        return RigState(
            scene=self.scene,
            index=self._index,
            world=self._world,
            readings=self._readings,
            smaller=self._smaller,
            readers=tuple(reader.copied() for reader in self._readers),
            delivery=self._delivery.copied(),
            cameras=tuple(camera.memory() for camera in self._cameras),
        )

    def restore(self, state: RigState) -> None:
        """Go on from a saved state: the next steps give the same bytes as they would have then.

        Raises
        ------
        UserError
            For a state of another scene.
        """
        if len(state.readings) != len(self._fingers):
            raise UserError("the state was saved of another number of fingers")
        if msgspec.structs.replace(state.scene, seed=self.scene.seed) != self.scene:
            raise UserError("the state was saved of another scene; restore it in a rig of that one")
        if state.scene.seed != self.scene.seed:
            self._reseed(state.scene.seed)
        self._index, self._world = state.index, state.world
        self._readings, self._smaller = state.readings, state.smaller
        self._readers = tuple(reader.copied() for reader in state.readers)
        self._delivery = state.delivery.copied()
        for camera in self._cameras:
            camera.recall(None)
        for k, memory in enumerate(state.cameras):
            self._camera(k).recall(memory)

    def close(self) -> None:
        """Release the cameras; closing them again does nothing."""
        while self._own and self._cameras:
            self._cameras.pop().close()

    def _check_begun(self, what: str) -> None:
        if self._index < 0:
            raise UserError(f"{what} is not possible before reset(); call reset() first")

    def _reseed(self, seed: int) -> None:
        """Take another seed, with other cameras, whose noise and defects it decides."""
        if not 0 <= seed < 2**32:
            raise UserError(f"seed = {seed} must be from 0 to {2**32 - 1}")
        self.close()
        self.scene = msgspec.structs.replace(self.scene, seed=int(seed))

    def _reader(self, k: int, finger: Scene) -> Reader:
        known = self.known[k]
        if known is None:
            return TruthReader(finger)
        return CameraReader(finger, self._camera(k), self._world.finger(k), known, self.methods)

    def _camera(self, k: int) -> SimulatedCamera:
        """Camera of a finger; all are opened together when one is needed first."""
        if not self._cameras:
            self._cameras = [open_camera(each, self.methods) for each in self._fingers]
        return self._cameras[k]

    def _picture(self, k: int) -> Frame:
        frame = self._readings[k].frame
        if frame is None:
            frame = self._camera(k).expose(exposed_state(self._world.finger(k)), self._index)
            readings = list(self._readings)
            readings[k] = replace(readings[k], frame=frame)
            self._readings = tuple(readings)
        return frame

    def _read(self, index: int) -> GripObservation | None:
        """Read the frames of that index, and send one observation on its way."""
        seen = index if self._delivery.due[index] >= 0 else None
        self._readings = tuple(
            reader.read(self._world.finger(k), seen, self._cameras[k] if self._cameras else None)
            for k, reader in enumerate(self._readers)
        )
        self._index = index
        came = [one.observation for one in self._readings if one.observation is not None]
        if len(came) < len(self._readings):
            return None
        each = [held(one, self.scene.held_margin) for one in came]
        self._smaller = smaller(each)
        self._delivery.send(index, each[self._smaller])
        return each[self._smaller]


def smaller(observations: list[GripObservation]) -> int:
    """Finger that a controller is told of: the one with the smallest margin.

    A finger that touches nothing comes before all others, and controllers grip anew. A finger
    without an estimate is left out while another one has one.
    """
    return min(range(len(observations)), key=lambda k: _urgency(observations[k]))


def _urgency(observation: GripObservation) -> float:
    if observation.no_estimate:
        return math.inf
    return -math.inf if math.isnan(observation.margin) else observation.margin


def _plant(scene: Scene, fingertip: Fingertip | None) -> Any:
    """Body of a scene, with a fingertip in place of the scene's chain."""
    if scene.pinch.mass_g:
        return PinchPlant(scene)
    if scene.body == "dome":
        return DomePlant(scene)
    if scene.build_sensor().shape.flat:
        raise UserError(
            f"sensor {scene.sensor} is a flat pad; the node model that grasps is a dome"
        )
    return ChainPlant(scene, scene.build_fingertip() if fingertip is None else fingertip)


def readable(scene: Scene, methods: Methods) -> SensorCalibration | None:
    """Calibration that a scene's pictures are read with; None on the truth path and of a pad.

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
