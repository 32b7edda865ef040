"""A grasp, frame by frame: `reset`, then a grip force for each step, until the scene is over.

    with chromagrip.open("margin-60hz") as rig:
        seen = rig.reset(seed=1)
        while not rig.done:
            seen = rig.step(grip=2.0)

`grasp` is this loop with a controller in it. Two fingers have a rig of their own, `rig.pinch.rig`.
"""

from dataclasses import dataclass, replace

import msgspec

from ...control import GripObservation
from ...errors import UserError, located
from ...model import Fingertip, pressure
from ...render import Frame
from ...scene.scene import Scene
from ...tracking import SensorCalibration, check_reconstructor
from ..camera import CameraMemory, SimulatedCamera, open_camera
from ..dome_world import DomePlant
from ..latency import Arrived, Delivery, arrivals, checked_force
from ..methods import Methods
from ..observers import known_sensor
from ..torsion import held
from ..world import ChainPlant, Contact, Plant, World
from .readers import CameraReader, Reader, Reading, TruthReader, exposed_state
from .sample import Sample


@dataclass(frozen=True, kw_only=True)
class RigState:
    """Everything that the next step of a rig starts from; for rigs of the same scene.

    Attributes
    ----------
    scene: with the seed that the grasp was reset with
    index: of the frame
    world, reading: of that frame
    reader: that goes on from there
    delivery: observations on their way
    camera: what the camera remembers of the frames before; None without a camera
    """

    scene: Scene
    index: int
    world: World
    reading: Reading
    reader: Reader
    delivery: Delivery
    camera: CameraMemory | None


class Rig:
    """A scene that is gripped frame by frame; the same seed and grips give the same bytes.

    Parameters
    ----------
    scene: object, load, fingertip, camera and methods
    methods: tracker and reconstructor; None are the scene's
    camera: that takes the frames; None opens the scene's when a picture is needed first
    fingertip, known: chain that grips, and calibration of the estimator; None are the scene's

    Raises
    ------
    UserError
        For a flat sensor.
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
        self._plant = _plant(scene, fingertip)
        self._known = known
        self._camera, self._own = camera, camera is None
        self._index = -1
        self._world: World
        self._reading: Reading
        self._reader: Reader
        self._delivery: Delivery

    @property
    def index(self) -> int:
        """Number of the frame, from 0; −1 before the first reset."""
        return self._index

    @property
    def time(self) -> float:
        """Instant of the frame [s]."""
        self._check_begun("time")
        return self._world.now.state.time

    @property
    def truth(self) -> Contact:
        """True contact; not for a controller."""
        self._check_begun("truth")
        return self._world.now

    @property
    def applied(self) -> float:
        """Force of the gripper's drive [N]."""
        self._check_begun("applied")
        return self._world.applied

    @property
    def reading(self) -> Reading:
        """What was read of this frame, before the latency."""
        self._check_begun("reading")
        return self._reading

    @property
    def readings(self) -> tuple[Reading, ...]:
        """What was read of this frame by each finger: here by one."""
        return (self.reading,)

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
        self._world = self._plant.rest()
        if self._camera is not None:
            self._camera.recall(None)
        self._reader = self._new_reader()
        self._delivery = Delivery(arrivals(self.scene))
        self._read(0)
        assert self._reading.observation is not None  # the first frame is never dropped
        return held(self._reading.observation, self.scene.held_margin)

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
        self._world = self._plant.next_frame(self._world, grip, self._index)
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
        self._world = self._plant.changed(self._world, scene)
        self.scene = scene

    def sample(self, grip: float = float("nan")) -> Sample:
        """The frame, truth beside estimate.

        Parameters
        ----------
        grip: force that is commanded from now on [N]
        """
        self._check_begun("sample()")
        now = self._world.now
        return Sample(
            index=self._index,
            truth=now,
            load=self.scene.load.force(now.state.time + 1e-9),
            grip=grip,
            applied=self._world.applied,
            pressure=pressure(now.field),
            pressure_pitch=pressure(now.field, self._plant.pitch),
            observation=self._reading.observation,
            frame=self._reading.frame,
            tracks=self._reading.tracks,
            rest=self._reading.rest,
        )

    def picture(self) -> Frame:
        """Camera's picture of this frame, also on the truth path and of a dropped frame."""
        self._check_begun("picture()")
        if self._reading.frame is None:
            frame = self._opened().expose(exposed_state(self._world), self._index)
            self._reading = replace(self._reading, frame=frame)
        return self._reading.frame or frame

    def pictures(self) -> tuple[Frame, ...]:
        """Picture of each finger's camera, as `picture`: here one."""
        return (self.picture(),)

    def save(self) -> RigState:
        """State of the grasp, from which it can go on later, as often as is wanted."""
        self._check_begun("save()")
        return RigState(
            scene=self.scene,
            index=self._index,
            world=self._world,
            reading=self._reading,
            reader=self._reader.copied(),
            delivery=self._delivery.copied(),
            camera=None if self._camera is None else self._camera.memory(),
        )

    def restore(self, state: RigState) -> None:
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
        self._index, self._world, self._reading = state.index, state.world, state.reading
        self._reader, self._delivery = state.reader.copied(), state.delivery.copied()
        if state.camera is not None:
            self._opened().recall(state.camera)
        elif self._camera is not None:
            self._camera.recall(None)

    def close(self) -> None:
        """Release the camera; closing it again does nothing."""
        if self._own and self._camera is not None:
            self._camera.close()
            self._camera = None

    def _check_begun(self, what: str) -> None:
        if self._index < 0:
            raise UserError(f"{what} is not possible before reset(); call reset() first")

    def _reseed(self, seed: int) -> None:
        """Take another seed, with another camera, whose noise and defects it decides."""
        if not 0 <= seed < 2**32:
            raise UserError(f"seed = {seed} must be from 0 to {2**32 - 1}")
        self.close()
        self.scene = msgspec.structs.replace(self.scene, seed=int(seed))

    def _opened(self) -> SimulatedCamera:
        if self._camera is None:
            self._camera = open_camera(self.scene, self.methods)
        return self._camera

    def _new_reader(self) -> Reader:
        if self.scene.path == "truth":
            return TruthReader(self.scene)
        with located(f"sensor {self.scene.sensor}"):
            if self._known is None:
                self._known = known_sensor(self.scene)
        camera = self._opened()
        return CameraReader(self.scene, camera, self._world, self._known, self.methods)

    def _read(self, index: int) -> None:
        """Read the frame of that index, and send its observation on its way."""
        seen = index if self._delivery.due[index] >= 0 else None
        self._reading = self._reader.read(self._world, seen, self._camera)
        self._index = index
        observation = self._reading.observation
        if observation is not None:
            self._delivery.send(index, held(observation, self.scene.held_margin))


def _plant(scene: Scene, fingertip: Fingertip | None) -> Plant:
    """Body of a scene, with a fingertip in place of the scene's chain."""
    if scene.pinch.mass_g:
        raise UserError(
            "the scene is a pinch of two fingers; run it with `chromagrip grasp` or "
            "chromagrip.run, or step through it with chromagrip.open"
        )
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
