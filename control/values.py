"""Observations, which a controller is given, and commands, which it returns."""

import math
from dataclasses import dataclass

from ..model import ForceField


@dataclass(frozen=True, kw_only=True)
class GripObservation:
    """Forces, friction and margin that were estimated from a frame.

    Attributes
    ----------
    time: instant of the frame [s]
    field: contact forces
    friction: friction coefficient µ; NaN before the first contact
    friction_interval: 90 % interval of µ
    friction_observable: whether µ was observable in a frame so far; in a pure press it is not (E7)
    margin: safety margin Γ; NaN without contact
    margin_interval: 90 % interval of Γ
    lateral_displacement: of the object over the fingertip [m]; NaN on the camera path, where the
        object's motion is not in the image
    no_estimate: reason for which no forces could be estimated; empty when they were
    direction: azimuth of the friction on the sensor, from its x axis towards its y axis [rad]; NaN
        where it was not estimated
    out_of_plane: share of the lateral motion of the skin that is across that direction; NaN where
        it was not estimated
    twist: turn of the contact about the grip axis [rad]; NaN where it was not estimated
    """

    time: float
    field: ForceField
    friction: float
    friction_interval: tuple[float, float]
    friction_observable: bool
    margin: float
    margin_interval: tuple[float, float]
    lateral_displacement: float
    no_estimate: str = ""
    direction: float = math.nan
    out_of_plane: float = math.nan
    twist: float = math.nan


@dataclass(frozen=True, kw_only=True)
class GripCommand:
    """Grip force to apply from now on [N]."""

    force: float
