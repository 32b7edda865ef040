"""Grasps of the chain on a dome of silicone, whose map the chain's estimators have never seen."""

import math

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError, located
from ...loop.dome_world import PRESS_DRAG
from ...model import ContactObject, DomeState, Motion, SoftBody, Solid
from ...model.dome import Stepper, per_area, resting
from ...model.shapes import ball, plane
from .force_scenes import PERIOD, Grasp

Array = NDArray[np.float64]

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
