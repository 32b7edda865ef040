"""Scenes on the other body: what one body's estimators are given, on pictures of the other's map.

The chain's pictures come from revolving a slice, those of a dome from silicone in three dimensions.
An estimator that was made for one of them has never seen the other's map.
"""

import math
from contextlib import closing

import msgspec
import numpy as np
from numpy.typing import NDArray

from ...errors import UserError, located
from ...loop.dome_world import PRESS_DRAG
from ...model import ContactObject, DomeState, Motion, SoftBody, Solid, dome_forces
from ...model.dome import Stepper, per_area, resting
from ...model.shapes import ball, plane
from ...output.processes import one_thread
from ...render import Frame
from ...scene.scene import Scene, parse_scene
from ...scene.shapes import PROFILE_KEYS, SHAPE_KEYS
from ...sensing.sensor import TactileSensor
from ...tracking import SensorCalibration
from .force_scenes import (
    HELD_FRAMES,
    NOISE,
    PERIOD,
    REST_FRAMES,
    ForceScene,
    Grasp,
    Specimen,
    tracked,
)

Array = NDArray[np.float64]

#: Longest step of the silicone [s].
_STEP = 5e-3


def crossed(scene: Scene) -> Scene:
    """The same object, grip and load on the other body, with what that body's sensor is made of.

    Raises
    ------
    UserError
        For what only the scene's own body can hold.
    """
    chain = scene.body == "chain"
    values = msgspec.to_builtins(scene)
    other = "dome" if chain else "chain"
    alone: dict[str, tuple[str, ...]] = {
        "object": PROFILE_KEYS if chain else SHAPE_KEYS,
        "load": () if chain else ("sideways_n", "twists_nmm"),
    }
    for table, keys in alone.items():
        usual = msgspec.to_builtins(type(getattr(scene, table))())
        for key in keys:
            if values[table][key] != usual[key]:
                raise UserError(f'{table}.{key} cannot be drawn with body = "{other}"')
    del values["fingertip" if chain else "dome"]
    if not scene.controller_arguments:
        del values["controller_arguments"]
    return parse_scene(values | {"body": other, "path": "truth"}, f"on a {other}")


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


def watch_dome(
    known: SensorCalibration, specimen: Specimen, dome: SoftBody, grasped: Grasp, seed: int
) -> list[ForceScene]:
    """A chain's grasp on a dome: its pictures, the tracks in them, and the dome's own forces.

    Parameters
    ----------
    known: calibration that is given to estimators
    specimen: its sensor, renderer and defects take the pictures; its chain is not used
    dome: that grasps
    grasped: object, grip and load
    seed: of the camera

    Raises
    ------
    UserError
        For a grip and a load that the dome cannot bear, and when the tracker refuses the frames.
    """
    solid = solid_of(grasped.obj)
    ends = [round(end / PERIOD) for end in grasped.ends]
    shown = sorted({k for end in ends for k in range(end - HELD_FRAMES + 1, end + 1)})
    with one_thread():
        states = dome_states(dome, solid, grasped, ends[-1])
        camera = TactileSensor(
            specimen.sensor,
            body=dome,
            noise=NOISE,
            seed=seed,
            defects=specimen.defects,
            renderer=specimen.renderer,
        ).camera
        with closing(camera):
            rest = camera.expose_rest(states[0], REST_FRAMES)
            frames: dict[int, Frame] = {}
            # The tracker follows the markers from the untouched sensor on.
            for k in range(ends[-1] + 1):
                frame = camera.expose(states[k], k)
                if k in shown or k % 3 == 0:
                    frames[k] = frame
        at_rest, tracks = tracked(known, NOISE, rest, frames)
    return [
        ForceScene(
            known=known,
            rest=at_rest,
            tracks=[tracks[k] for k in range(end - HELD_FRAMES + 1, end + 1)],
            specimen=specimen,
            obj=grasped.obj,
            state=states[end],
            field=dome_forces(dome, states[end]),
            friction=solid.friction,
        )
        for end in ends
    ]


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
