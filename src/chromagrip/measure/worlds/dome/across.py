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

from ....errors import UserError, located
from ....loop.dome_world import PRESS_DRAG
from ....model import (
    ContactObject,
    Dome,
    DomeState,
    Drive,
    Fingertip,
    Motion,
    SoftBody,
    Solid,
    State,
    contact_forces,
    dome_forces,
)
from ....model.dome import Stepper, per_area, resting
from ....model.shapes import ball, plane
from ....output.processes import one_thread
from ....render import Defects, load_sensor
from ....sensing.sensor import TactileSensor
from ....tracking import sensor_as_designed
from ..force_scenes import NOISE, PERIOD, REST_FRAMES, Grasp, run_of, tracked
from ..grasps import CURVATURES, STIFFNESSES
from .elements import pressed_scene
from .grips import FRICTIONS, ends_of, random_margins, staged
from .scenes import SEED, Watched, side, truth

Array = NDArray[np.float64]

DESIGN = "thesis"
#: Worlds that draw the pictures: the chain, the dome with stiffening and without, finite elements.
WORLDS = ("chain", "dome", "linear-dome", "elements")
_LINEAR = ("linear-dome",)
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
        if world == "chain":  # which moves by another model
            tip, run = known.fingertip, run_of(known.fingertip, grasped)
            states, body = [run.state(k) for k in range(count + 1)], tip
            fields = [contact_forces(tip, grasped.obj, run.state(end)) for end in ends]
        else:
            body = dome = replace(dome, stiffening=world not in _LINEAR)
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


#: Longest step of the silicone [s].
_STEP = 5e-3


def solid_of(obj: ContactObject) -> Solid:
    """A chain's object in three dimensions: flat, or a ball.

    Raises
    ------
    UserError
        For a hollow, a profile, and friction that differs along the surface.
    """
    if obj.profile is not None or obj.patches or obj.curvature < 0.0:
        raise UserError("a dome takes a flat object or a ball with one µ, no profile and no hollow")
    return Solid(
        shape=ball(1.0 / obj.curvature) if obj.curvature else plane(),
        stiffness=per_area(obj.stiffness),
        friction=obj.friction,
        dahl_stiffness=per_area(obj.dahl_stiffness),
        dahl_exponent=obj.dahl_exponent,
    )


def dome_states(dome: SoftBody, solid: Solid, grasped: Grasp, count: int) -> list[DomeState]:
    """States of a dome at every frame, under grip and load."""
    drive, drag = grasped.drive, grasped.obj.drag
    if drive.normal_control != "force" or drive.lateral_control != "force":
        raise UserError("a grasp on a dome is driven by forces")
    motion = Motion(
        times=np.array([0.0, count * PERIOD]),
        poses=np.zeros((2, 6)),
        free=("x", "z"),
        drag=(drag, drag, PRESS_DRAG, 0.0, 0.0, 0.0),
    )
    start = resting(dome, solid, motion)
    stepper = Stepper(dome, solid, motion, start)
    states, parts = [start], math.ceil(PERIOD / _STEP)
    for k in range(count):
        for part in range(parts):
            time = (k + (part + 1) / parts) * PERIOD
            grip, load = (
                float(np.interp(time, drive.times, v)) for v in (drive.normal, drive.lateral)
            )
            with located("the dome gave up"):
                stepper.advance(time, np.array([load, 0.0, -grip, 0.0, 0.0, 0.0]))
        states.append(stepper.state())
    return states
