"""Unknowns of the fitted contact, and the object and poses that follow from them.

An object of two curvatures touches the dome at a place, along the dome's own normal there. From
there it is pressed, shifted and turned. The unknowns are

    pose: shift along x and y, press, twist | object: place (2), curvatures (3), ln k, ln µ, ln σ0

with the object's stiffness k and bristle stiffness σ0. Only the pose changes between frames.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....model import Dome, Solid
from ....model.shapes import quadric
from .settings import ContactModelSettings

Array = NDArray[np.float64]

#: Number of unknowns, and of those that change from frame to frame.
UNKNOWNS = 12
MOVING = 4
PRESS = 2
TWIST = 3
OBJECT = range(MOVING, UNKNOWNS)
#: Indices among the unknowns of the object.
PLACE = slice(0, 2)
CURVES = slice(2, 5)
STIFFNESS = 5
FRICTION = 6
BRISTLE = 7


@dataclass(frozen=True, kw_only=True)
class Prior:
    """Prior of a contact before any picture, as independent normal distributions.

    Attributes
    ----------
    mean: mean of the unknowns of the object, shape (8,)
    deviation: standard deviation of these unknowns, shape (8,)
    """

    mean: Array
    deviation: Array


def prior_of(dome: Dome) -> Prior:
    """Prior of contacts on a dome: 10 to 2000 kPa, µ 0.15 to 1.6, curvatures up to 4/R."""
    radius = dome.radius
    mean, deviation = np.zeros(len(OBJECT)), np.empty(len(OBJECT))
    mean[CURVES] = np.array([0.8, 0.8, 0.0]) / radius
    mean[STIFFNESS:] = math.log(7e8), math.log(0.5), math.log(5e9)
    deviation[PLACE] = 0.35
    deviation[CURVES] = np.array([1.6, 1.6, 0.8]) / radius
    deviation[STIFFNESS:] = 1.6, 0.6, 0.7
    return Prior(mean=mean, deviation=deviation)


def moves_of(
    dome: Dome, poses: Array, model: ContactModelSettings = ContactModelSettings()
) -> Array:
    """Prior standard deviation of the motion to each pose from the previous one, shape (…, 4).

    A light contact is assumed to shift little, as markers hardly determine its place.
    """
    thickness = dome.thickness
    out = np.empty(poses.shape)
    light = np.maximum(model.light_shift * thickness, model.shift_per_press * poses[..., PRESS])
    out[..., 0] = out[..., 1] = light
    out[..., PRESS] = 0.15 * thickness
    out[..., TWIST] = 0.05
    return out


def units_of(dome: Dome) -> Array:
    """Unit of each unknown, in which derivatives are given, shape (12,)."""
    shift, curve = 1e-3 * dome.thickness, 0.05 / dome.radius
    pose = [shift, shift, shift, 3e-3]
    return np.array([*pose, 1e-3, 1e-3, curve, curve, curve, 0.05, 0.03, 0.05])


def longest_of(dome: Dome) -> Array:
    """Largest change of each unknown in a round of the fit, shape (12,)."""
    shift, curve = 0.15 * dome.thickness, 1.0 / dome.radius
    return np.array([shift, shift, shift, 0.2, 0.15, 0.15, curve, curve, curve, 1.0, 0.7, 1.0])


def limited_object(
    dome: Dome, object_: Array, model: ContactModelSettings = ContactModelSettings()
) -> Array:
    """Clip the unknowns of an object to plausible values."""
    out = object_.copy()
    low, high = model.flattest / dome.radius, model.sharpest / dome.radius
    along_x, along_y, mixed = out[CURVES]
    values, turns = np.linalg.eigh([[along_x, mixed], [mixed, along_y]])
    curves = (turns * np.clip(values, low, high)) @ turns.T
    out[CURVES] = curves[0, 0], curves[1, 1], curves[0, 1]
    out[STIFFNESS] = np.clip(out[STIFFNESS], math.log(2e7), math.log(1e10))
    out[FRICTION] = np.clip(out[FRICTION], math.log(0.03), math.log(4.0))
    out[BRISTLE] = np.clip(out[BRISTLE], math.log(2e8), math.log(2e11))
    return out


def limited_pose(
    dome: Dome, pose: Array, model: ContactModelSettings = ContactModelSettings()
) -> Array:
    """Clip poses (…, 4) to plausible presses."""
    out = pose.copy()
    out[..., PRESS] = np.minimum(out[..., PRESS], model.farthest * dome.thickness)
    return out


def solid_of(object_: Array, model: ContactModelSettings) -> Solid:
    """Make the object of its unknowns."""
    along_x, along_y, mixed = (float(value) for value in object_[CURVES])
    stiffness, friction, bristle = (float(math.exp(value)) for value in object_[STIFFNESS:])
    return Solid(
        shape=quadric(along_x, along_y, mixed),
        stiffness=stiffness,
        friction=friction,
        dahl_stiffness=bristle,
        dahl_exponent=model.dahl_exponent,
    )


def pose_of(dome: Dome, object_: Array, pose: Array) -> tuple[Array, Array]:
    """Rotation matrix (3, 3) and position (3,) of the object."""
    rotation, place = poses_of(dome, object_[None], pose[None])
    return rotation[0], place[0]


def poses_of(dome: Dome, objects: Array, poses: Array) -> tuple[Array, Array]:
    """Rotation matrices (C, 3, 3) and positions (C, 3) of objects (C, 8) at poses (C, 4)."""
    # Rodrigues' formula for a turn about an axis across z, and a turn about z before it: SciPy's
    # rotations take five times as long for so few.
    x, y = objects[:, PLACE].T
    angle = np.hypot(x, y)
    sine, cosine = np.sinc(angle / np.pi), 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    base, twist = np.zeros((2, len(objects), 3, 3))
    base[:, 0, 0], base[:, 1, 1] = 1.0 - cosine * y**2, 1.0 - cosine * x**2
    base[:, 0, 1] = base[:, 1, 0] = cosine * x * y
    base[:, 0, 2], base[:, 1, 2] = sine * y, -sine * x
    base[:, 2, 0], base[:, 2, 1] = -sine * y, sine * x
    base[:, 2, 2] = 1.0 - cosine * angle**2
    twist[:, 0, 0] = twist[:, 1, 1] = np.cos(poses[:, TWIST])
    twist[:, 1, 0] = np.sin(poses[:, TWIST])
    twist[:, 0, 1], twist[:, 2, 2] = -twist[:, 1, 0], 1.0
    off = poses[:, :3] * [1.0, 1.0, -1.0] + [0.0, 0.0, dome.radius]
    return base @ twist, (base @ off[..., None])[..., 0]
