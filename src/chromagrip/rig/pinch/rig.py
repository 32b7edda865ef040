"""A pinch, frame by frame: `reset`, then one grip for both fingers, until the scene is over."""

import math
from dataclasses import dataclass, replace

import msgspec

from ...control import GripObservation
from ...errors import UserError, located
from ...loop.camera import CameraMemory, SimulatedCamera, open_camera
from ...loop.latency import Arrived, Delivery, arrivals, checked_force
from ...loop.methods import Methods
from ...loop.observers import known_sensor
from ...loop.steps.readers import CameraReader, Reader, Reading, TruthReader, exposed_state
from ...loop.torsion import held
from ...render import Frame
from ...scene.fingers import fingers
from ...scene.scene import Scene
from ...tracking import SensorCalibration, check_reconstructor
from .world import Pinched, PinchPlant, PinchWorld


@dataclass(frozen=True, kw_only=True)
class PinchSample:
    """One frame of a pinch, truth beside estimates.

    Attributes
    ----------
    index: of the frame
    truth: of the pinch
    grip: force commanded from now on [N]
    applied: force of the gripper's drive now [N]
    readings: of each finger: observation, frame and tracks; empty where the frame was dropped
    smaller: finger whose observation goes to the controller, 0 or 1
    """

    index: int
    truth: Pinched
    grip: float
    applied: float
    readings: tuple[Reading, Reading]
    smaller: int

    @property
    def time(self) -> float:
        """Instant of the frame [s]."""
        return self.truth.state.time


@dataclass(frozen=True, kw_only=True)
class PinchRigState:
    """Everything that the next step of a pinch's rig starts from; for rigs of the same scene.

    Attributes
    ----------
    scene: with the seed that the pinch was reset with
    index: of the frame
    world, readings, smaller: of that frame
    readers: of each finger, that go on from there
    delivery: observations on their way
    cameras: what each camera remembers; empty on the truth path
    """

    scene: Scene
    index: int
    world: PinchWorld
    readings: tuple[Reading, Reading]
    smaller: int
    readers: tuple[Reader, ...]
    delivery: Delivery
    cameras: tuple[CameraMemory, ...]


class PinchRig:
    """A scene of two fingers that is gripped frame by frame; same seed and grips, same bytes.

    Each finger has its own camera, specimen and observer. A controller is given the observation
    of the finger whose margin is smaller.

    Parameters
    ----------
    scene: with a pinch
    methods: tracker and reconstructor; None are the scene's

    Raises
    ------
    UserError
        For a scene of one finger, and a sensor whose pictures cannot be read.
    """

    def __init__(self, scene: Scene, methods: Methods | None = None) -> None:
        if not scene.pinch.mass_g:
            raise UserError("the scene is of one finger; two need pinch.mass_g")
        self.scene = scene
        self.methods = methods or Methods.of_scene(scene)
        self.plant = PinchPlant(scene)
        self._cameras: list[SimulatedCamera] = []
        self._known = [self._calibration(each) for each in fingers(scene)]
        self._index = -1
        self._world: PinchWorld
        self._readings: tuple[Reading, Reading]
        self._smaller = 0
        self._readers: list[Reader] = []
        self._delivery: Delivery

    @property
    def index(self) -> int:
        """Number of the frame, from 0; −1 before the first reset."""
        return self._index

    @property
    def time(self) -> float:
        """Instant of the frame [s]."""
        return self.truth.state.time

    @property
    def truth(self) -> Pinched:
        """Both fingertips and the object as they are; not for a controller."""
        self._check_begun("truth")
        return self._world.now

    @property
    def applied(self) -> float:
        """Force of the gripper's drive [N]."""
        self._check_begun("applied")
        return self._world.applied

    @property
    def readings(self) -> tuple[Reading, ...]:
        """What was read of this frame by each finger, before the latency."""
        self._check_begun("readings")
        return self._readings

    @property
    def done(self) -> bool:
        """Whether this is the scene's last frame."""
        return self._index + 1 == self.scene.frames

    @property
    def arrived(self) -> tuple[Arrived, ...]:
        """Frames that reach a controller at this one, each with the observation it is given."""
        self._check_begun("arrived")
        return self._delivery.arrived(self._index)

    def reset(self, seed: int | None = None) -> GripObservation:
        """Begin anew, with both fingertips at the object and nothing gripped yet.

        Parameters
        ----------
        seed: of all random numbers; None is the one that the rig has

        Returns
        -------
        Observation of the first frame, which is there at once.
        """
        if seed is not None and seed != self.scene.seed:
            self._reseed(seed)
        self._index = -1  # until everything below has gone well
        self._world = self.plant.rest()
        for camera in self._cameras:
            camera.recall(None)
        self._readers = [self._reader(k, each) for k, each in enumerate(fingers(self.scene))]
        self._delivery = Delivery(arrivals(self.scene))
        seen = self._read(0)
        assert seen is not None  # the first frame is never dropped
        return seen

    def step(self, grip: float) -> GripObservation | None:
        """Grip with both fingers until the next frame.

        Parameters
        ----------
        grip: force that is commanded from now on [N]

        Returns
        -------
        The newest observation that arrives at the next frame, of the finger whose margin is
        smaller; None where none arrives.

        Raises
        ------
        UserError
            Before `reset`; after the last frame; for a force that is not finite or is negative;
            when the model cannot go on.
        """
        self._check_begun("step()")
        if self.done:
            raise UserError(
                f"the pinch ended with frame {self._index}; call reset() before the next step()"
            )
        grip = checked_force(grip, f"step() at frame {self._index} was given")
        self._world = self.plant.next_frame(self._world, grip, self._index)
        self._read(self._index + 1)
        arrived = self.arrived
        return arrived[-1].observation if arrived else None

    def sample(self, grip: float = math.nan) -> PinchSample:
        """The frame, truth beside estimates.

        Parameters
        ----------
        grip: force that is commanded from now on [N]
        """
        self._check_begun("sample()")
        return PinchSample(
            index=self._index,
            truth=self._world.now,
            grip=grip,
            applied=self._world.applied,
            readings=self._readings,
            smaller=self._smaller,
        )

    def save(self) -> PinchRigState:
        """State of the pinch, from which it can go on later, as often as is wanted."""
        self._check_begun("save()")
        return PinchRigState(
            scene=self.scene,
            index=self._index,
            world=self._world,
            readings=self._readings,
            smaller=self._smaller,
            readers=tuple(reader.copied() for reader in self._readers),
            delivery=self._delivery.copied(),
            cameras=tuple(camera.memory() for camera in self._cameras),
        )

    def restore(self, state: PinchRigState) -> None:
        """Go on from a saved state: the next steps give the same bytes as they would have then.

        Raises
        ------
        UserError
            For a state of another scene.
        """
        if msgspec.structs.replace(state.scene, seed=self.scene.seed) != self.scene:
            raise UserError("the state was saved of another scene; restore it in a rig of that one")
        if state.scene.seed != self.scene.seed:
            self._reseed(state.scene.seed)
        self._index, self._world = state.index, state.world
        self._readings, self._smaller = state.readings, state.smaller
        self._readers = [reader.copied() for reader in state.readers]
        self._delivery = state.delivery.copied()
        for camera in self._cameras:
            camera.recall(None)
        for k, memory in enumerate(state.cameras):
            self._camera(k).recall(memory)

    def pictures(self) -> tuple[Frame, Frame]:
        """Both cameras' pictures of this frame, also on the truth path and of a dropped frame."""
        self._check_begun("pictures()")
        return self._picture(0), self._picture(1)

    def rest_pictures(self) -> tuple[Frame, Frame]:
        """Both cameras' pictures of the untouched fingers, with noise that is in no other frame."""
        world = self.plant.rest()
        first, second = (
            self._camera(k).expose_rest(world.finger(k).now.state, 1)[0] for k in range(2)
        )
        return first, second

    def close(self) -> None:
        """Release the cameras; closing them again does nothing."""
        while self._cameras:
            self._cameras.pop().close()

    def _reseed(self, seed: int) -> None:
        """Take another seed, with other cameras, whose noise and defects it decides."""
        if not 0 <= seed < 2**32:
            raise UserError(f"seed = {seed} must be from 0 to {2**32 - 1}")
        self.close()
        self.scene = msgspec.structs.replace(self.scene, seed=int(seed))

    def _check_begun(self, what: str) -> None:
        if self._index < 0:
            raise UserError(f"{what} is not possible before reset(); call reset() first")

    def _calibration(self, finger: Scene) -> SensorCalibration | None:
        """Calibration that a finger's pictures are read with; None on the truth path."""
        if finger.path == "truth":
            return None
        with located(f"sensor {finger.sensor}"):
            known = known_sensor(finger)
            check_reconstructor(self.methods.reconstructor, known)
        return known

    def _reader(self, k: int, finger: Scene) -> Reader:
        known = self._known[k]
        if known is None:
            return TruthReader(finger)
        return CameraReader(finger, self._camera(k), self._world.finger(k), known, self.methods)

    def _camera(self, k: int) -> SimulatedCamera:
        """Camera of a finger; both are opened together when one is needed first."""
        if not self._cameras:
            self._cameras = [open_camera(each, self.methods) for each in fingers(self.scene)]
        return self._cameras[k]

    def _picture(self, k: int) -> Frame:
        frame = self._readings[k].frame
        if frame is None:
            frame = self._camera(k).expose(exposed_state(self._world.finger(k)), self._index)
            readings = list(self._readings)
            readings[k] = replace(readings[k], frame=frame)
            self._readings = (readings[0], readings[1])
        return frame

    def _read(self, index: int) -> GripObservation | None:
        """Read both fingers' frames of that index, and send one observation on its way."""
        seen = index if self._delivery.due[index] >= 0 else None
        first, second = (
            reader.read(self._world.finger(k), seen, self._cameras[k] if self._cameras else None)
            for k, reader in enumerate(self._readers)
        )
        self._readings, self._index = (first, second), index
        if first.observation is None or second.observation is None:
            return None
        both = [
            held(each, self.scene.held_margin) for each in (first.observation, second.observation)
        ]
        self._smaller = smaller(both[0], both[1])
        self._delivery.send(index, both[self._smaller])
        return both[self._smaller]


def smaller(first: GripObservation, second: GripObservation) -> int:
    """Finger that a controller is told of, 0 or 1: the one with the smaller margin.

    A finger that touches nothing comes before all others, and controllers grip anew. A finger
    without an estimate is left out while the other one has one.
    """
    return int(_urgency(second) < _urgency(first))


def _urgency(observation: GripObservation) -> float:
    if observation.no_estimate:
        return math.inf
    return -math.inf if math.isnan(observation.margin) else observation.margin
