"""Pictures of a grasp through its sensor's camera, the tracks in them, and the true forces."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...model import (
    ContactObject,
    DomeState,
    Drive,
    Fingertip,
    ForceField,
    History,
    State,
    contact_forces,
    rest_state,
    simulate,
    whole_friction,
)
from ...output.processes import one_thread
from ...render import Defects, Frame, Membrane, SensorDesign
from ...sensing.camera import SimulatedCamera
from ...sensing.sensor import TactileSensor
from ...tracking import MarkerTracker, Palette, SensorCalibration, Tracks

Array = NDArray[np.float64]
#: Turns frames at rest and of a run into what the tracker is given of both.
Pictures = Callable[[list[Frame], list[Frame]], tuple[list[Frame], list[Frame]]]

#: Time between frames [s].
PERIOD = 0.01
#: Number of frames that are read together.
HELD_FRAMES = 10
#: Number of frames of the untouched sensor.
REST_FRAMES = 16
#: Noise of the camera [grey levels].
NOISE = 2.0
#: Step of the node model [s].
_STEP = 2e-3
#: What is known of markers in frames that the tracker refused.
_NO_TRACKS = Tracks(
    time=0.0,
    position=np.empty((2, 0, 2)),
    log_size=np.empty((2, 0)),
    hue=np.empty(0),
    visible=np.empty((2, 0), dtype=np.bool_),
    ambiguous=np.empty((2, 0), dtype=np.bool_),
    last_seen=np.empty((2, 0)),
    covariance=np.empty((0, 6, 6)),
)
#: Before the scored frames the tracker is given a frame after each such motion of the skin [m].
_SHOWN = 0.15e-3


@dataclass(frozen=True, kw_only=True)
class Specimen:
    """A sensor as it is made, which its calibration may state differently.

    Attributes
    ----------
    fingertip, sensor, defects: as made
    renderer: name of the renderer that draws its images
    membrane_map: see `TactileSensor`; None is the sensor's own
    """

    fingertip: Fingertip
    sensor: SensorDesign
    defects: Defects
    renderer: str
    membrane_map: Callable[[Array], Membrane] | None = None

    def camera(self, seed: int) -> SimulatedCamera:
        """Camera that takes its images; close it after use."""
        return TactileSensor(
            self.sensor,
            body=self.fingertip,
            noise=NOISE,
            seed=seed,
            defects=self.defects,
            renderer=self.renderer,
            membrane_map=self.membrane_map,
        ).camera


@dataclass(frozen=True, kw_only=True)
class Grasp:
    """An object, grip and load over time [N], and the instants that are scored [s].

    `named` has a name for each instant where scores are told apart by it.
    """

    obj: ContactObject
    drive: Drive
    ends: tuple[float, ...]
    named: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class ForceScene:
    """Tracks up to a scored instant, and the truth at that instant.

    Attributes
    ----------
    known: calibration that estimators are given
    rest: tracks of the untouched sensor
    tracks: of the last HELD_FRAMES frames, or of all frames since before the touch
    specimen, obj: sensor and object in contact
    state: of the body
    field: true contact forces
    friction: true µ of the contact as a whole
    labels: names of the parts of its set that are scored on their own too
    refused: why the tracker refused the frames, which leaves no tracks; empty where it did not
    """

    known: SensorCalibration
    rest: Tracks
    tracks: list[Tracks]
    specimen: Specimen
    obj: ContactObject
    state: State | DomeState
    field: ForceField
    friction: float
    labels: tuple[str, ...] = ()
    refused: str = ""

    @property
    def margin(self) -> float:
        """True Γ."""
        return self.field.safety_margin(self.friction)


def run_of(fingertip: Fingertip, grasped: Grasp) -> History:
    """Run of a grasp, one record a frame.

    Raises
    ------
    ModelError
        When the run cannot go on.
    """
    every = round(PERIOD / _STEP)
    duration = grasped.ends[-1]
    return simulate(fingertip, grasped.obj, grasped.drive, dt=_STEP, duration=duration, every=every)


def watch(
    known: SensorCalibration,
    specimen: Specimen,
    grasped: Grasp,
    run: History,
    seed: int,
    *,
    noise: float = NOISE,
    pictures: Pictures | None = None,
    film: bool = False,
    labels: tuple[str, ...] = (),
    may_refuse: bool = False,
    whole: bool = False,
) -> list[ForceScene]:
    """Take pictures of a run and track the markers in them, in one thread.

    Parameters
    ----------
    known: calibration that is given to estimators
    specimen: that grasps
    grasped, run: grasp, and its run
    seed: of the camera
    noise: that the tracker is told [grey levels]
    pictures: what becomes of the frames before the tracker is given them; None leaves them
    film: take every frame of the run, though the tracker is given only some
    labels: of every scene
    may_refuse: whether the tracker may refuse the frames, else its UserError is raised
    whole: whether the scenes have the tracks of all frames
    """
    tip = specimen.fingertip
    ends = [round(end / PERIOD) for end in grasped.ends]
    scored = {k for end in ends for k in range(end - HELD_FRAMES + 1, end + 1)}
    shown, refused = list(range(ends[-1] + 1)) if whole else _shown(run, scored), ""
    with one_thread():
        rest, frames = _taken(specimen, run, seed, shown, pictures, film)
        try:
            at_rest, tracks = tracked(known, noise, rest, frames)
        except UserError as error:
            if not may_refuse:
                raise
            at_rest, tracks, refused = _NO_TRACKS, dict.fromkeys(shown, _NO_TRACKS), str(error)
    first = -ends[-1] if whole else 1 - HELD_FRAMES
    fields = [contact_forces(tip, grasped.obj, run.state(end)) for end in ends]
    return [
        ForceScene(
            known=known,
            rest=at_rest,
            tracks=[tracks[k] for k in range(max(end + first, 0), end + 1)],
            specimen=specimen,
            obj=grasped.obj,
            state=run.state(end),
            field=field,
            friction=whole_friction(tip, grasped.obj, run.state(end), field),
            labels=(*labels, *name),
            refused=refused,
        )
        for end, field, name in zip(ends, fields, _names(grasped), strict=True)
    ]


def _taken(
    specimen: Specimen,
    run: History,
    seed: int,
    shown: list[int],
    pictures: Pictures | None,
    film: bool,
) -> tuple[list[Frame], dict[int, Frame]]:
    """Frames at rest, and those of the run that are shown, by their number."""
    taken = list(range(len(run))) if film else shown
    with closing(specimen.camera(seed)) as camera:
        rest = camera.expose_rest(rest_state(specimen.fingertip), REST_FRAMES)
        frames = [camera.expose(run.state(k), k) for k in taken]
    if pictures is not None:
        rest, frames = pictures(rest, frames)
    by_number = dict(zip(taken, frames, strict=True))
    return rest, {k: by_number[k] for k in shown}


def tracked(
    known: SensorCalibration, noise: float, rest: list[Frame], frames: dict[int, Frame]
) -> tuple[Tracks, dict[int, Tracks]]:
    """Tracks of the frames at rest, and of frames of the run by their number."""
    tracker = MarkerTracker(Palette.of_sensor(known.sensor), noise)
    at_rest = tracker.reset(rest)
    return at_rest, {k: tracker.update(frame) for k, frame in frames.items()}


def _names(grasped: Grasp) -> list[tuple[str, ...]]:
    """Name of each scored instant, if it has one."""
    return [(name,) for name in grasped.named] or [()] * len(grasped.ends)


def _shown(run: History, scored: set[int]) -> list[int]:
    """Frames that the tracker is given: those that are scored, and one after each motion."""
    shown: list[int] = []
    tracked = np.zeros_like(run.nodes[0])
    for k in range(len(run)):
        displacement = run.state(k).deformation.seen
        if k in scored or abs(displacement - tracked).max() > _SHOWN:
            shown.append(k)
            tracked = displacement
    return shown
