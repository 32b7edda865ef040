"""A grasp, frame by frame: `reset`, then a grip force for each step, until the scene is over.

    with chromagrip.open("margin-60hz") as rig:
        observation = rig.reset(seed=1)
        while not rig.done:
            observation = rig.step(grip=2.0)

`grasp` is this loop with a controller in it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgspec

from ..control import GripObservation
from ..errors import UserError
from ..model import Fingertip
from ..render import Frame
from ..scene.fingers import fingers
from ..scene.scene import Mechanics, Scene
from ..sensing.camera import SimulatedCamera
from ..sensing.margins import smaller
from ..sensing.reader import Reader, Reading, TruthReader, scene_reader
from ..sensing.sensor import SensorState, TactileSensor
from ..tracking import SensorCalibration
from .dome_world import DomePlant
from .latency import Arrived, Delivery, arrivals, checked_force
from .methods import Methods, readable
from .pinch.world import PinchPlant
from .sample import Sample, Truth
from .world import ChainPlant, Plant, World


@dataclass(frozen=True, kw_only=True)
class RigState:
    """State from which the next step of a rig starts; for rigs of the same scene.

    Attributes
    ----------
    scene: scene with the seed of the last reset
    index: number of the frame
    world: true contact at that frame
    readings: reading of each finger in that frame
    smaller: number of the finger whose observation goes to the controller
    sensors: state of each finger's sensor
    readers: reader of each finger
    delivery: observations on their way to the controller
    """

    scene: Scene
    index: int
    world: World[Any]
    readings: tuple[Reading, ...]
    smaller: int
    sensors: tuple[SensorState, ...]
    readers: tuple[Reader | TruthReader, ...]
    delivery: Delivery


class Rig:
    """A scene that is gripped frame by frame; the same seed and grips give the same bytes.

    That holds for one family of processors and the same versions of the libraries.

    Each finger has a sensor and a reader of its own. A controller is given the observation
    of the finger whose margin is smaller.

    Parameters
    ----------
    scene: scene with object, load, fingertip, camera and methods
    methods: tracker and reconstructor (default: the scene's)
    camera: camera that takes the frames of one finger (default: the scene's, opened when needed)
    fingertip: chain that grips (default: the scene's)
    known: calibration of the estimator (default: the scene's)

    Raises
    ------
    UserError
        For a flat sensor, and for a sensor whose pictures cannot be read.
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
        self._camera, self._fingertip = camera, fingertip
        self.known = [known or readable(each, self.methods) for each in fingers(scene)]
        self.sensors = self._new_sensors()
        self._index = -1
        self._world: World[Any]
        self._readings: tuple[Reading, ...] = ()
        self._smaller = 0
        self._readers: tuple[Reader | TruthReader, ...] = ()
        self._delivery: Delivery

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
        """True contact; for two fingers both contacts and the object. Not for a controller."""
        self._check_begun("truth")
        return self._world.now

    @property
    def applied(self) -> float:
        """Force of the gripper's drive [N]."""
        self._check_begun("applied")
        return float(self._world.applied)

    @property
    def readings(self) -> tuple[Reading, ...]:
        """Reading of this frame by each finger, before the latency."""
        self._check_begun("readings")
        return self._readings

    @property
    def reading(self) -> Reading:
        """Reading of the finger whose margin is smaller."""
        return self.readings[self._smaller]

    @property
    def done(self) -> bool:
        """True at the scene's last frame, and at the one in which two fingers drop their object."""
        over = self._index >= 0 and self._world.over
        return over or self._index + 1 == self.scene.frames

    @property
    def arrived(self) -> tuple[Arrived, ...]:
        """Observations that reach a controller at this frame, in order, after the latency.

        A late one comes together with the next one.
        """
        self._check_begun("arrived")
        return self._delivery.arrived(self._index)

    def reset(self, seed: int | None = None) -> GripObservation:
        """Begin the grasp again, with the object at the fingertip and no grip.

        Parameters
        ----------
        seed: seed of all random numbers (default: the rig's)

        Returns
        -------
        observation of the first frame, without latency: a grip starts from it
        """
        if seed is not None and seed != self.scene.seed:
            self._reseed(seed)
        self._index = -1  # until everything below has gone well
        self._world = self.plant.rest()
        self._show(0)
        self._readers = tuple(
            self._reader(each, sensor, known)
            for each, sensor, known in zip(
                fingers(self.scene), self.sensors, self.known, strict=True
            )
        )
        self._delivery = Delivery(arrivals(self.scene))
        observation = self._read(0)
        assert observation is not None  # the first frame is never dropped
        return observation

    def step(self, grip: float) -> GripObservation | None:
        """Grip with a force until the next frame.

        Parameters
        ----------
        grip: force commanded from now on [N]

        Returns
        -------
        newest observation that arrives at the next frame, with the margin to hold; None if no
        observation arrives, because of the latency or a dropped frame

        Raises
        ------
        UserError
            Before `reset`; when the grasp is done; for a force that is not finite or is negative;
            when the model fails.
        """
        self._check_begun("step()")
        if self.done:
            raise UserError(
                f"the grasp ended with frame {self._index} at t = {self.time:.4g} s; "
                "call reset() before the next step()"
            )
        grip = checked_force(grip, f"step() at frame {self._index} was given")
        self._world = self.plant.next_frame(self._world, grip, self._index)
        self._show(self._index + 1)
        self._read(self._index + 1)
        arrived = self.arrived
        return arrived[-1].observation if arrived else None

    def change(self, scene: Scene) -> None:
        """Go on from this frame with the load, the µ and the stiffness of another scene.

        The state differs from that of a grasp with these values from its start.

        Raises
        ------
        UserError
            Before `reset`; for a scene that differs elsewhere; for a load along an axis on which
            the object is fixed.
        """
        self._check_begun("change()")
        ours, theirs = self.scene.object, scene.object
        alike = msgspec.structs.replace(
            ours, friction=theirs.friction, stiffness_kpa=theirs.stiffness_kpa
        )
        if msgspec.structs.replace(self.scene, load=scene.load, object=alike) != scene:
            raise UserError(
                "during a grasp only load, object.friction and object.stiffness_kpa can change; "
                "other changes need a new rig"
            )
        self._world = self.plant.changed(self._world, scene)
        self.scene = scene

    def sample(self, grip: float = math.nan) -> Sample:
        """Sample of this frame, with truth and estimates.

        Parameters
        ----------
        grip: force commanded from now on (default: unknown, NaN) [N]
        """
        self._check_begun("sample()")
        return Sample(
            index=self._index,
            time=self.time,
            readings=self._readings,
            grip=grip,
            truth=Truth(
                now=self._world.now,
                applied=self._world.applied,
                load=self.scene.load.force(self.time + 1e-9),
            ),
            smaller=self._smaller,
        )

    def pictures(self) -> tuple[Frame, ...]:
        """Take each camera's picture of this frame, also on the truth path and if it is dropped."""
        self._check_begun("pictures()")
        return tuple(sensor.data.frame for sensor in self.sensors)

    def picture(self) -> Frame:
        """Take the picture of the only camera, as `pictures`.

        Raises
        ------
        UserError
            Before `reset`, and for two fingers.
        """
        self._check_begun("picture()")
        if len(self.sensors) > 1:
            raise UserError("picture() is for one finger and this scene has two; use pictures()")
        return self.pictures()[0]

    def rest_pictures(self) -> tuple[Frame, ...]:
        """Take each camera's picture of the untouched finger, with noise of its own."""
        return tuple(sensor.rest_frames(1)[0] for sensor in self.sensors)

    def save(self) -> RigState:
        """State of the grasp, from which it can go on later, any number of times."""
        self._check_begun("save()")
        return RigState(
            scene=self.scene,
            index=self._index,
            world=self._world,
            readings=self._readings,
            smaller=self._smaller,
            sensors=tuple(sensor.state() for sensor in self.sensors),
            readers=tuple(reader.copied() for reader in self._readers),
            delivery=self._delivery.copied(),
        )

    def restore(self, state: RigState) -> None:
        """Go on from a saved state: the next steps give the same bytes as they would have then.

        Raises
        ------
        UserError
            For a state of another scene.
        """
        if len(state.sensors) != len(self.sensors):
            raise UserError("the state belongs to a scene with another number of fingers")
        if msgspec.structs.replace(state.scene, seed=self.scene.seed) != self.scene:
            raise UserError("the state belongs to another scene; restore it in a rig of that scene")
        if state.scene.seed != self.scene.seed:
            self._reseed(state.scene.seed)
        self._index, self._world = state.index, state.world
        self._readings, self._smaller = state.readings, state.smaller
        self._readers = tuple(reader.copied() for reader in state.readers)
        self._delivery = state.delivery.copied()
        for sensor, shown in zip(self.sensors, state.sensors, strict=True):
            sensor.restore(shown)

    def open(self) -> None:
        """Open the cameras now instead of at their first picture.

        Raises
        ------
        UserError
            When a renderer cannot run on this machine.
        """
        for sensor in self.sensors:
            sensor.camera  # noqa: B018 (opens it)

    def close(self) -> None:
        """Release the cameras; closing them again does nothing."""
        for sensor in self.sensors:
            sensor.close()

    def _check_begun(self, what: str) -> None:
        if self._index < 0:
            raise UserError(f"{what} is not possible before reset(); call reset() first")

    def _reseed(self, seed: int) -> None:
        """Change the seed, and make new sensors with its noise and defects."""
        if not 0 <= seed < 2**32:
            raise UserError(f"seed = {seed} must be from 0 to {2**32 - 1}")
        self.close()
        self.scene = msgspec.structs.replace(self.scene, seed=int(seed))
        self.sensors = self._new_sensors()

    def _new_sensors(self) -> tuple[TactileSensor, ...]:
        """Make the sensor of each finger."""
        return tuple(
            TactileSensor.of_scene(each, self.methods.renderer, self._camera, body=self._fingertip)
            for each in fingers(self.scene)
        )

    def _reader(
        self, finger: Scene, sensor: TactileSensor, known: SensorCalibration | None
    ) -> Reader | TruthReader:
        """Make the reader of a finger from its frames at rest."""
        if known is None:
            return TruthReader(finger)
        rest = sensor.rest_frames(finger.camera.rest_frames)
        return scene_reader(finger, known, self.methods.tracker, self.methods.reconstructor, rest)

    def _show(self, index: int) -> None:
        """Give the sensors the world at a frame."""
        now, exposed = self._world.now.fingers, self._world.exposed.fingers
        for sensor, contact, shown in zip(self.sensors, now, exposed, strict=True):
            sensor.show(contact, shown, index)

    def _read(self, index: int) -> GripObservation | None:
        """Read each finger's frame, and send the controller's observation on its way."""
        self._index = index
        if self._delivery.due[index] < 0:
            self._readings = tuple(Reading(rest=reader.rest) for reader in self._readers)
            return None
        self._readings = tuple(
            reader.update(sensor.data.frame)
            if isinstance(reader, Reader)
            else reader.observe(self._world.exposed.fingers[k], self.time)
            for k, (sensor, reader) in enumerate(zip(self.sensors, self._readers, strict=True))
        )
        each = [one.held for one in self._readings if one.held is not None]
        self._smaller = smaller(each)
        self._delivery.send(index, each[self._smaller])
        return each[self._smaller]


def _plant(scene: Scene, fingertip: Fingertip | None) -> Plant[Any]:
    """Make the plant of a scene; a given fingertip replaces the scene's chain."""
    return _PLANTS[scene.mechanics](scene, fingertip)


def _chain_plant(scene: Scene, fingertip: Fingertip | None) -> ChainPlant:
    """Make the plant of the scene's chain, or of another one."""
    if scene.build_sensor().shape.flat:
        raise UserError(
            f"sensor {scene.sensor} is a flat pad; the node model that grasps is a dome"
        )
    return ChainPlant(scene, scene.build_fingertip() if fingertip is None else fingertip)


_PLANTS: dict[Mechanics, Callable[[Scene, Fingertip | None], Plant[Any]]] = {
    "chain": _chain_plant,
    "dome": lambda scene, _: DomePlant(scene),
    "pinch": lambda scene, _: PinchPlant(scene),
}
