"""State from which a step of a pinch starts."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..dome.placing import rotation_of
from ..dome.state import DomeState, untouched
from .body import Moving, at_rest
from .pinch import FACING, Pinch, bases

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class PinchState:
    """Everything that a step of a pinch starts from.

    Attributes
    ----------
    time: time of the state [s]
    first, second: states of the fingertips, each in its own frame; `velocity` is not used
    moving: state of motion of the object in the world
    closing: distance by which each fingertip has closed [m]
    drift: velocity [m/s] and angular velocity [rad/s] of the object in the hand in the last step,
        shape (6,)
    support: force of the table, against gravity [N]
    level: coordinate of the centre of mass along gravity at which the table starts to push [m]
    came: distance that object and skins have moved since the active nodes were chosen [m];
        infinite: choose them in the next step
    """

    time: float
    first: DomeState
    second: DomeState
    moving: Moving
    closing: float
    drift: Array
    support: float
    level: float
    came: float


def pinch_rest(pinch: Pinch) -> PinchState:
    """State at the start: both fingertips just touch the object, nothing moves.

    Raises
    ------
    UserError: where the object cannot lie on a fingertip
    """
    base, place = bases(pinch), np.array([*pinch.beside, 0.0])
    rotation = rotation_of(np.array([0.0, 0.0, 0.0, *pinch.turned]))
    origin, turn = pinch.hand.at(0.0)
    centre = origin + turn @ (place + rotation @ np.array(pinch.body.centre))
    weight = pinch.body.mass * float(np.linalg.norm(pinch.gravity)) if pinch.table else 0.0
    gives = weight / pinch.table_stiffness if pinch.table else 0.0
    level = float(pinch.down @ centre) - gives if pinch.table else 0.0
    return PinchState(
        time=0.0,
        first=untouched(pinch.first, place - base[0], rotation),
        second=untouched(pinch.second, FACING * (place - base[1]), FACING[:, None] * rotation),
        moving=at_rest(centre, turn @ rotation),
        closing=0.0,
        drift=np.zeros(6),
        support=weight,
        level=level,
        came=math.inf,
    )
