"""Pictures of a dome from before it is touched: the tracks of every frame, and the true forces."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....errors import located
from ....model import DomeState, ForceField, dome_forces
from ....model.dome import Stepper, resting
from ....output.processes import one_thread
from ....render import Frame
from ....tracking import SensorCalibration, Tracks, load_calibration, sensor_as_designed
from ..force_scenes import REST_FRAMES, tracked
from .grips import SMOOTH, UNLIKE, Grip, random_grip, turned
from .specimens import Specimen, calibrated, calibration_file, matched, mismatched

Array = NDArray[np.float64]

#: Time between frames, and steps of the silicone in it [s].
PERIOD, _STEPS = 1.0 / 60.0, 3
#: Sets whose specimens are off their design. Estimators are told a calibration of the specimen, or
#: the design as it is; the scenes are the same.
CALIBRATED, NOMINAL = "mismatched", "mismatched-nominal"
#: Set of calibrated specimens whose objects are turned, not loaded.
TURNED = "turned"
#: Sets of scenes of a design: objects, and force of the grip [N].
SETS: dict[str, tuple[tuple[str, ...], float]] = {
    "matched": (SMOOTH, 3.0),
    "light": (SMOOTH, 1.0),
    CALIBRATED: (SMOOTH, 3.0),
    "unlike": (UNLIKE, 3.0),
    "soft": (SMOOTH, 1.0),
    NOMINAL: (SMOOTH, 3.0),
    TURNED: (SMOOTH, 3.0),
}
#: How far a grip is off that force, as a share: a constant answer is to be told from an estimate.
_AROUND = 0.2
#: Seed of the random numbers.
SEED = 2727


@dataclass(frozen=True, kw_only=True)
class Watched:
    """Tracks of all frames of a scene in order, and the truth in those of them that are scored.

    Attributes
    ----------
    known: calibration that estimators are given
    rest: tracks of the untouched sensor
    tracks: of all frames, from before the touch
    scored: numbers of the I frames that are scored
    true: (ΣFn [N], ΣFf [N], µ, Γ) in these, shape (I, 4)
    side: see `side`, shape (I, 3)
    label: kind of the object
    """

    known: SensorCalibration
    rest: Tracks
    tracks: list[Tracks]
    scored: tuple[int, ...]
    true: Array
    side: Array
    label: str = ""


def scene(name: str, kind: str, index: int) -> Watched:
    """Scene of a set; the same arguments give the same bytes.

    Parameters
    ----------
    name: of the design
    kind: of SETS
    index: of the scene; kinds of objects take turns, and so do mismatched specimens
    """
    objects, normal = SETS[kind]
    known, specimen, number = sensor_as_designed(name), matched(name), index
    if kind in (CALIBRATED, NOMINAL, TURNED):
        turn, place = divmod(index, len(calibrated(name)))
        # In each turn every specimen, with another kind of object: all pairs come about.
        which = calibrated(name)[place]
        number = len(objects) * which + (place + turn) % len(objects)
        specimen = mismatched(name, which)
        if kind != NOMINAL:
            known = load_calibration(str(calibration_file(name, which)))
    seeds = list(SETS).index(CALIBRATED if kind == NOMINAL else kind)
    rng = np.random.default_rng([SEED, seeds, number, 1])
    label, pressed = objects[number % len(objects)], normal * (1.0 + rng.uniform(-_AROUND, _AROUND))
    grip = random_grip(rng, specimen.dome, label, pressed)
    if kind == TURNED:
        grip = turned(rng, grip)
    return watch(known, specimen, grip, int(rng.integers(2**32)), label)


def watch(
    known: SensorCalibration, specimen: Specimen, grip: Grip, seed: int, label: str = ""
) -> Watched:
    """Take pictures of a grip and track the markers in all of them.

    Frames in which the object has slid off the dome are not scored.

    Parameters
    ----------
    known: calibration that is given to estimators
    specimen: that is gripped
    grip: object, force and loads
    seed: of the camera and the defects
    label: kind of the object

    Raises
    ------
    UserError
        For a grip that the dome cannot bear, and when the tracker refuses the frames.
    """
    ends = tuple(round(end / PERIOD) for end in grip.ends)
    with one_thread():
        states = states_of(specimen, grip, ends[-1])
        with closing(specimen.camera(seed)) as camera:
            rest = camera.expose_rest(states[0], REST_FRAMES)
            frames: dict[int, Frame] = {k: camera.expose(s, k) for k, s in enumerate(states)}
        at_rest, tracks = tracked(known, specimen.noise, rest, frames)
    held = {end: dome_forces(specimen.dome, states[end], whole=False) for end in ends}
    held = {end: field for end, field in held.items() if field.contact.any()}
    fields = list(held.values())
    return Watched(
        known=known,
        rest=at_rest,
        tracks=list(tracks.values()),
        scored=tuple(held),
        true=np.reshape([truth(field, grip.solid.friction) for field in fields], (-1, 4)),
        side=np.reshape([side(field) for field in fields], (-1, 3)),
        label=label,
    )


def states_of(specimen: Specimen, grip: Grip, count: int) -> list[DomeState]:
    """States of a gripped dome at rest and in `count` frames.

    Raises
    ------
    UserError
        When the dome cannot bear the grip.
    """
    motion = grip.motion
    with located("the dome gave up"):
        start = resting(specimen.dome, grip.solid, motion)
        stepper = Stepper(specimen.dome, grip.solid, motion, start)
        states = [start]
        for k in range(1, count + 1):
            for part in range(1, _STEPS + 1):
                stepper.advance((k - 1 + part / _STEPS) * PERIOD)
            states.append(stepper.state())
    return states


def truth(field: ForceField, friction: float) -> Array:
    """(ΣFn, ΣFf, µ, Γ) of a field of forces, shape (4,)."""
    margin = field.safety_margin(friction)
    return np.array([field.total_normal, field.total_friction, friction, margin])


def side(field: ForceField) -> Array:
    """ΣFf along the sensor's x and y [N] and torque about its z [N·m], shape (3,).

    A chain has nothing but ΣFf along x.
    """
    whole: Sequence[float] = list(field.net_friction)
    if field.directions is None:
        return np.array([whole[0], 0.0, 0.0])
    return np.array([whole[0], whole[1], field.torque((0.0, 0.0, 1.0))])
