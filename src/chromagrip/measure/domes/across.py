"""The same grasps on a chain, on domes, and presses by finite elements, of the design `thesis`.

Every estimator reads all of them, and each has been made for one: the chain's for the chain, the
dome's for the dome.
"""

import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...model import (
    ContactObject,
    Dome,
    DomeState,
    Drive,
    Fingertip,
    State,
    contact_forces,
    dome_forces,
)
from ...output.processes import one_thread
from ...render import Defects, load_sensor
from ...sensing.sensor import TactileSensor
from ...tracking import sensor_as_designed
from ..worlds.crossed import dome_states, solid_of
from ..worlds.force_scenes import NOISE, PERIOD, REST_FRAMES, Grasp, run_of, tracked
from ..worlds.grasps import CURVATURES, STIFFNESSES
from .elements import pressed_scene
from .grips import FRICTIONS, ends_of, random_margins, staged
from .scenes import SEED, Watched, side, truth

Array = NDArray[np.float64]

DESIGN = "thesis"
#: Worlds that draw the pictures: the chain, the dome with stiffening and without, finite elements.
WORLDS = ("chain", "dome", "linear-dome", "elements")
#: Grip, and its least force, with which it begins [N].
_NORMALS, _TOUCH = (1.0, 3.0), 0.02
#: Of the frames of a run, at 100 Hz, every other one is taken.
_EVERY = 2


def across_scene(world: str, index: int) -> Watched:
    """Scene in a world; one index is the same grasp on chain and domes, and the next press.

    Parameters
    ----------
    world: of WORLDS
    index: of the grasp
    """
    if world == "elements":
        return pressed_scene(DESIGN, index)
    grasped = random_grasp(index)
    known = sensor_as_designed(DESIGN)
    count = round(grasped.ends[-1] / PERIOD)
    ends = [round(end / PERIOD) for end in grasped.ends]
    taken = sorted({*range(0, count + 1, _EVERY), *ends})
    dome = load_sensor(DESIGN).round_dome("this bench")
    states: Sequence[State | DomeState]
    body: Fingertip | Dome
    with one_thread():
        if world == "chain":
            tip, run = known.fingertip, run_of(known.fingertip, grasped)
            states, body = [run.state(k) for k in range(count + 1)], tip
            fields = [contact_forces(tip, grasped.obj, run.state(end)) for end in ends]
        else:
            body = dome = replace(dome, stiffening=world == "dome")
            states = moved = dome_states(dome, solid_of(grasped.obj), grasped, count)
            fields = [dome_forces(dome, moved[end], whole=False) for end in ends]
        camera = TactileSensor(
            known.sensor, body=body, noise=NOISE, seed=SEED + index, defects=Defects()
        ).camera
        with closing(camera):
            rest = camera.expose_rest(states[0], REST_FRAMES)
            frames = {k: camera.expose(states[k], k) for k in taken}
        at_rest, tracks = tracked(known, NOISE, rest, frames)
    return Watched(
        known=known,
        rest=at_rest,
        tracks=[tracks[k] for k in taken],
        scored=tuple(taken.index(end) for end in ends),
        true=np.array([truth(field, grasped.obj.friction) for field in fields]),
        side=np.array([side(field) for field in fields]),
        label="ball" if grasped.obj.curvature else "plane",
    )


def random_grasp(index: int) -> Grasp:
    """A grasp of a flat object or a ball in turns, in the ranges of the chain's library."""
    rng = np.random.default_rng([SEED, index, 2])
    obj = ContactObject(
        stiffness=math.exp(rng.uniform(*np.log(STIFFNESSES))),
        friction=rng.uniform(*FRICTIONS),
        curvature=rng.uniform(*CURVATURES) if index % 2 else 0.0,
    )
    times, forces = staged(rng.uniform(*_NORMALS), obj.friction, random_margins(rng))
    sign = rng.choice([-1.0, 1.0])
    return Grasp(
        obj=obj,
        drive=Drive(
            times=times, normal=np.maximum(forces[:, 0], _TOUCH), lateral=sign * forces[:, 1]
        ),
        ends=ends_of(times),
    )
