"""A reader: a picture in; forces, friction and margin out, or the reason for no estimate.

    reader = chromagrip.Reader("dome-2020", rest_frames)
    reading = reader.update(image, time=0.1)
    reading.wrench, reading.margin, reading.margin_interval, reading.no_estimate

It gets only the pixels, the frames at rest and the calibration of the sensor.
"""

import hashlib
import math
from collections.abc import Sequence
from copy import copy, deepcopy
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, Self, get_args

import numpy as np
from numpy.typing import NDArray

from ..by_name import Choice, blaming, name_of
from ..compiled import working_time
from ..control import GripObservation
from ..errors import UserError, located
from ..render import Frame
from ..scene.scene import HeldMargin, Scene
from ..tracking import (
    CAMERA_RULE,
    DEFAULT_RECONSTRUCTOR,
    DEFAULT_TRACKER,
    RECONSTRUCTORS,
    TRACKERS,
    FrictionRule,
    Palette,
    SensorCalibration,
    Tracker,
    Tracks,
    check_reconstructor,
    load_calibration,
    load_tracker,
    sensor_as_designed,
)
from .contact import Contact
from .given import number
from .margins import finished, held
from .observers import ForceObserver, TruthObserver

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Moving average of the friction estimate [s].
DEFAULT_WINDOW = 0.3
#: Default noise of a pixel [grey levels].
DEFAULT_NOISE = 2.0


@dataclass(frozen=True, kw_only=True)
class Reading:
    """Estimates from a frame; unknown values are None.

    Attributes
    ----------
    observation: forces, friction and margins with their intervals, with Γ as its margin; None for a
        dropped frame, and for a reader of markers alone
    held: the same observation with the margin that a controller must hold
    frame: picture with its time; None on the truth path and for a dropped frame
    tracks, rest: markers in the frame and at rest; None on the truth path
    seconds: time that the reading took, without compiling [s]
    """

    observation: GripObservation | None = None
    held: GripObservation | None = None
    frame: Frame | None = None
    tracks: Tracks | None = None
    rest: Tracks | None = None
    seconds: float = 0.0

    @property
    def no_estimate(self) -> str:
        """Reason for a missing estimate; empty if there is an estimate."""
        if self.observation is None:
            return "no forces were read of this frame"
        return self.observation.no_estimate

    @property
    def ok(self) -> bool:
        """True if there is an estimate."""
        return not self.no_estimate

    @property
    def wrench(self) -> Array:
        """Force of the object on the sensor along x, y, z [N], and torque about z [N·m], (4,).

        NaN without an estimate, and for a chain, whose forces are in a plane.
        """
        if self.observation is None:
            return np.full(4, math.nan)
        return np.append(self.observation.force, self.observation.torque)

    @property
    def wrench_covariance(self) -> Array:
        """Covariance of `wrench`, shape (4, 4); NaN if it is unknown."""
        known = None if self.observation is None else self.observation.field.wrench_covariance
        return np.full((4, 4), math.nan) if known is None or not self.ok else known

    @property
    def margin(self) -> float:
        """Safety margin Γ; NaN without contact and without an estimate."""
        return math.nan if self.observation is None else self.observation.margin

    @property
    def margin_interval(self) -> tuple[float, float]:
        """90 % interval of Γ."""
        unknown = (math.nan, math.nan)
        return unknown if self.observation is None else self.observation.margin_interval

    @property
    def friction(self) -> float:
        """Friction coefficient µ; NaN without an estimate."""
        return self.observation.friction if self.observation and self.ok else math.nan


class Reader:
    """Estimates forces from one specimen's pictures, frame after frame.

    Parameters
    ----------
    calibration: name of a design, file of a calibration, or a calibration
    rest: one or several pictures or frames of the untouched sensor, RGB
    tracker: see `load_tracker` (default `fit`)
    reconstructor: see `load_reconstructor` (default `auto`: the one for the calibration's body)
    noise: standard deviation of a pixel, from the camera's data sheet (default 2) [grey levels]
    window: moving average of the friction estimate (default 0.3) [s]
    friction_bias: bias added to the estimated µ (default 0)
    held_margin: margin that a controller must hold, as in a scene
    rule: rule that estimates µ from a field

    Raises
    ------
    UserError
        For a calibration, tracker or reconstructor that cannot be used, and for pictures at rest in
        which the markers are not found.
    """

    def __init__(
        self,
        calibration: SensorCalibration | str,
        rest: Sequence[Frame | Image] | Frame | Image,
        *,
        tracker: Choice = DEFAULT_TRACKER,
        reconstructor: Choice = DEFAULT_RECONSTRUCTOR,
        noise: float = DEFAULT_NOISE,
        window: float = DEFAULT_WINDOW,
        friction_bias: float = 0.0,
        held_margin: HeldMargin = "smaller",
        rule: FrictionRule = CAMERA_RULE,
    ) -> None:
        _check_settings(noise, window, friction_bias, held_margin)
        known = load_calibration(calibration) if isinstance(calibration, str) else calibration
        check_reconstructor(reconstructor, known)
        pictures: Any = rest
        if isinstance(rest, Frame) or (isinstance(rest, np.ndarray) and rest.ndim == 3):
            pictures = [rest]
        frames = [one if isinstance(one, Frame) else Frame(image=one, time=0.0) for one in pictures]
        if not frames:
            raise UserError("a reader needs at least one picture of the untouched sensor")
        with blaming(f"tracker {name_of(tracker)} failed", SystemExit):
            made = load_tracker(tracker)(Palette.of_sensor(known.sensor), noise)
            resting = made.reset(frames)
        check_tracks(resting, name_of(tracker))
        forces = ForceObserver(known, resting, reconstructor, window, rule)
        self._begin(made, name_of(tracker), resting, forces, friction_bias, held_margin)

    @classmethod
    def of_tracker(cls, tracker: Tracker, name: str, rest: Tracks) -> Self:
        """Make a reader of markers alone, from a tracker that was given the frames at rest.

        Parameters
        ----------
        tracker, name: tracker, and its name for messages
        rest: tracks of the frames at rest, from that tracker
        """
        reader = cls.__new__(cls)
        reader._begin(tracker, name, rest, None)
        return reader

    def _begin(
        self,
        tracker: Tracker,
        name: str,
        rest: Tracks,
        forces: ForceObserver | None,
        bias: float = 0.0,
        margin: HeldMargin = "smaller",
    ) -> None:
        #: Markers at rest, from which displacements are counted.
        self.rest = rest
        self._name, self._failure = name, f"tracker {name} failed"
        self._tracker, self._forces = tracker, forces
        self._bias, self._held_margin = bias, margin
        self._last = -math.inf  # time of the last frame [s]

    def update(self, image: Frame | Image, time: float | None = None) -> Reading:
        """Read the next frame.

        Parameters
        ----------
        image: picture, RGB, uint8, shape (H, W, 3), or a frame
        time: instant of the picture [s] (default: that of the frame)

        Raises
        ------
        UserError
            For a picture without a time, and one that the tracker cannot use.
        """
        if not isinstance(image, Frame):
            if not hasattr(image, "shape"):
                raise UserError(f"a picture is an array (H, W, 3), not a {type(image).__name__}")
            image = Frame(image=image, time=number(time, "time of the picture [s]"))
        elif time is not None:
            image = replace(image, time=number(time, "time of the picture [s]"))
        if image.time < self._last:
            raise UserError(
                f"the picture of {image.time:g} s came after that of {self._last:g} s; give "
                "pictures in order of time, or make a new reader"
            )
        self._last, begun = image.time, working_time()
        reading = self.read(image, self.track(image))
        return replace(reading, seconds=working_time() - begun)

    def track(self, frame: Frame) -> Tracks:
        """Track the markers in the next frame, the first half of `update`.

        Raises
        ------
        UserError
            When the tracker refuses the frame, or does not return tracks of the same markers.
        """
        with blaming(self._failure, SystemExit):
            tracks = self._tracker.update(frame)
        check_tracks(tracks, self._name, self.rest)
        return tracks

    def read(self, frame: Frame, tracks: Tracks) -> Reading:
        """Estimate forces from a frame's markers, the second half of `update`."""
        reading = Reading(frame=frame, tracks=tracks, rest=self.rest)
        if self._forces is None:
            return reading
        observation = finished(self._forces.observe(frame.time, tracks), self._bias)
        return replace(reading, observation=observation, held=held(observation, self._held_margin))

    def with_forces(self, forces: ForceObserver) -> Self:
        """Copy of this reader that also estimates forces."""
        other = copy(self)
        other._forces = forces
        return other

    def copied(self) -> Self:
        """Reader that goes on from here by itself."""
        other = copy(self)
        other._tracker = copy(self._tracker)
        other._forces = None if self._forces is None else self._forces.copied()
        other._tracker.state = deepcopy(self._tracker.state)  # a plug-in may change its own
        return other


class TruthReader:
    """Takes the true forces in the middle of a frame's exposure, in place of its picture.

    Parameters
    ----------
    scene: scene with the window and noise of the friction estimate, and the margin to hold
    """

    rest: Tracks | None = None

    def __init__(self, scene: Scene) -> None:
        self._bias, self._held_margin = scene.camera.friction_bias, scene.held_margin
        window = scene.safety_margin.friction_window_s
        self._observer = TruthObserver(window, scene.truth.margin_noise, scene.seed)

    def observe(self, exposed: Contact, time: float) -> Reading:
        """Observe a contact, at the time of the frame [s]."""
        observation = self._observer.observe(time, exposed.field, exposed.slip.current)
        observation = finished(observation, self._bias)
        return Reading(observation=observation, held=held(observation, self._held_margin))

    def copied(self) -> Self:
        """Reader that goes on from here by itself."""
        other = copy(self)
        other._observer = self._observer.copied()
        return other


@dataclass(frozen=True)
class _RestPictures:
    """Frames of the untouched sensor, compared by their digest."""

    digest: bytes
    frames: tuple[Frame, ...] = field(compare=False)

    @classmethod
    def of(cls, frames: list[Frame]) -> "_RestPictures":
        digest = hashlib.blake2b(digest_size=16)
        for frame in frames:
            digest.update(f"{frame.time!r} {frame.image.shape}".encode())
            digest.update(np.ascontiguousarray(frame.image).data)
        return cls(digest.digest(), tuple(frames))


@dataclass(frozen=True, kw_only=True)
class _Asked:
    """Arguments of a reader, except its frames at rest; `name` is used in messages."""

    calibration: SensorCalibration
    name: str
    tracker: Choice
    reconstructor: Choice
    noise: float
    window: float
    friction_bias: float
    held_margin: HeldMargin


def scene_reader(
    scene: Scene,
    calibration: SensorCalibration,
    tracker: Choice,
    reconstructor: Choice,
    rest: list[Frame],
) -> Reader:
    """Reader of a scene's pictures; for our methods and the same rest frames it is cached."""
    asked = _Asked(
        calibration=calibration,
        name=calibration.name,
        tracker=tracker,
        reconstructor=reconstructor,
        noise=scene.camera.noise_levels,
        window=scene.safety_margin.friction_window_s,
        friction_bias=scene.camera.friction_bias,
        held_margin=scene.held_margin,
    )
    with located(f"sensor {scene.sensor}"):
        ours = tracker in TRACKERS.entries and reconstructor in RECONSTRUCTORS.entries
        if not (ours and rest):
            return _made(asked, rest)
        return _resting(asked, _RestPictures.of(rest)).copied()


@lru_cache(maxsize=2)
def _resting(asked: _Asked, rest: _RestPictures) -> Reader:
    """Reader before its first frame."""
    return _made(asked, list(rest.frames))


def _made(asked: _Asked, rest: list[Frame]) -> Reader:
    options = dict(vars(asked))
    known = options.pop("calibration")
    del options["name"]
    return Reader(known, rest, **options)


def _check_settings(noise: float, window: float, bias: float, margin: str) -> None:
    """Refuse settings of a reader that are out of range."""
    number(noise, "noise [grey levels]", 0.0)
    number(window, "window [s]", 0.0)
    number(bias, "friction_bias")
    if margin not in get_args(HeldMargin):
        allowed = ", ".join(get_args(HeldMargin))
        raise UserError(f"held_margin = {margin!r}: allowed are {allowed}")


def check_tracks(tracks: object, name: str, rest: Tracks | None = None) -> None:
    """Refuse a tracker's result that is not `Tracks`, or has other markers than at rest."""
    if not isinstance(tracks, Tracks):
        raise UserError(f"tracker {name} gave a {type(tracks).__name__}; expected: Tracks")
    if rest is not None and tracks.position.shape != rest.position.shape:
        raise UserError(
            f"tracker {name} gave positions of shape {tracks.position.shape}, at rest "
            f"{rest.position.shape}; expected: the same markers in every frame"
        )


def known_sensor(scene: Scene) -> SensorCalibration:
    """Load the calibration of a scene's sensor: from its file, or that of the design."""
    if scene.calibration:
        return load_calibration(scene.calibration)
    return sensor_as_designed(scene.sensor, scene.fingertip.model)
