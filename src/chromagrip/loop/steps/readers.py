"""What is read of a frame: true forces, or those that are estimated from the camera's picture."""

from dataclasses import dataclass, replace
from typing import Any, Protocol, Self

from ...control import GripObservation
from ...errors import located
from ...render import Frame
from ...scene.scene import Scene
from ...tracking import SensorCalibration, Tracks
from ..camera import SimulatedCamera
from ..methods import Methods
from ..observers import TruthObserver, camera_observer, with_friction_bias
from ..torsion import with_limit_margin
from ..world import World


@dataclass(frozen=True, kw_only=True)
class Reading:
    """Observation of a frame, with its image and tracks; attributes as in `Sample`."""

    observation: GripObservation | None = None
    frame: Frame | None = None
    tracks: Tracks | None = None
    rest: Tracks | None = None


class Reader(Protocol):
    """Reads frames, one after another."""

    def read(self, world: World, index: int | None, camera: SimulatedCamera | None) -> Reading:
        """Reading of the frame of that index; None is a dropped one."""
        ...

    def copied(self) -> Self:
        """Reader that goes on from here by itself."""
        ...


class TruthReader:
    """Reads the true forces in the middle of a frame's exposure."""

    def __init__(self, scene: Scene) -> None:
        self._bias = scene.camera.friction_bias
        window = scene.safety_margin.friction_window_s
        self._observer = TruthObserver(window, scene.truth.margin_noise, scene.seed)

    def read(self, world: World, index: int | None, camera: SimulatedCamera | None) -> Reading:
        """Reading of a frame, as `Reader` says."""
        if index is None:
            return Reading()
        time, exposed = world.now.state.time, world.exposed
        observation = self._observer.observe(time, exposed.field, exposed.slip.current)
        observation = with_friction_bias(observation, self._bias)
        return Reading(observation=with_limit_margin(observation))

    def copied(self) -> "TruthReader":
        """Reader that goes on from here by itself."""
        copy = object.__new__(TruthReader)
        copy._bias, copy._observer = self._bias, self._observer.copied()
        return copy


class CameraReader:
    """Reads a camera's frames, by an observer that was given frames at rest."""

    def __init__(
        self,
        scene: Scene,
        camera: SimulatedCamera,
        world: World,
        known: SensorCalibration,
        methods: Methods,
    ) -> None:
        self._bias = scene.camera.friction_bias
        rest = camera.expose_rest(world.now.state, scene.camera.rest_frames)
        with located(f"sensor {scene.sensor}"):
            self._observer = camera_observer(
                known,
                methods.tracker,
                methods.reconstructor,
                scene.camera.noise_levels,
                scene.safety_margin.friction_window_s,
                rest,
            )

    def read(self, world: World, index: int | None, camera: SimulatedCamera | None) -> Reading:
        """Reading of a frame, as `Reader` says."""
        rest = self._observer.rest
        if index is None:
            return Reading(rest=rest)
        assert camera is not None
        frame = camera.expose(exposed_state(world), index)
        observation, tracks = self._observer.observe(frame)
        observation = with_friction_bias(observation, self._bias)
        observation = with_limit_margin(observation)
        return Reading(observation=observation, frame=frame, tracks=tracks, rest=rest)

    def copied(self) -> "CameraReader":
        """Reader that goes on from here by itself."""
        copy = object.__new__(CameraReader)
        copy._bias, copy._observer = self._bias, self._observer.copied()
        return copy


def exposed_state(world: World) -> Any:
    """State that the picture of a frame shows: the exposure's middle, with the frame's time."""
    return replace(world.exposed.state, time=world.now.state.time)
