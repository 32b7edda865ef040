"""Observations, which a controller is given, and commands, which it returns."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..model import ForceField

Array = NDArray[np.float64]

#: An interval that is not known.
UNKNOWN = (math.nan, math.nan)


@dataclass(frozen=True, kw_only=True)
class GripObservation:
    """Forces, friction and margin estimated from a frame.

    Attributes
    ----------
    time: instant of the frame [s]
    field: contact forces
    friction: friction coefficient µ; NaN before the first contact
    friction_interval: 90 % interval of µ
    friction_observable: whether µ was observable in a frame so far; in a pure press it is not (E7)
    margin: safety margin Γ; NaN without contact. For a controller it is the margin to hold: the
        smaller of Γ and `limit_margin`, unless the scene has `held_margin = "friction"`
    margin_interval: 90 % interval of `margin`
    lateral_displacement: displacement of the object over the fingertip [m]; NaN on the camera path,
        where the image does not show the object's motion
    no_estimate: reason for missing forces; empty if they were estimated
    direction: azimuth of the friction on the sensor, from its x axis towards its y axis [rad]; NaN
        if unknown
    out_of_plane: share of the lateral motion of the skin that is across that direction; NaN if
        unknown
    twist: turn of the contact about the grip axis [rad]; NaN if unknown
    limit_margin: margin of friction and torsion together against the largest that the contact can
        carry, which is at most Γ; NaN if the torque is unknown, such as for a chain
    limit_margin_interval: 90 % interval of `limit_margin`
    torsion: torque of the friction about the contact's normal, through its middle [N·m]; NaN as
        `limit_margin`
    torsion_borne: largest torsion that friction carries without a pull [N·m]; NaN as `torsion`
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
    limit_margin: float = math.nan
    limit_margin_interval: tuple[float, float] = UNKNOWN
    torsion: float = math.nan
    torsion_borne: float = math.nan

    @property
    def force(self) -> Array:
        """Force of the object on the sensor along x, y, z [N], shape (3,); NaN for a chain.

        A press has a negative z.
        """
        return self._wrench[:3]

    @property
    def force_deviation(self) -> Array:
        """Standard deviations of `force` [N], shape (3,); 0 for the truth, NaN if unknown."""
        return self._wrench_deviation[:3]

    @property
    def torque(self) -> float:
        """Torque of the object on the sensor about the grip axis z [N·m]; NaN for a chain."""
        return float(self._wrench[3])

    @property
    def torque_deviation(self) -> float:
        """Standard deviation of `torque` [N·m]; 0 for the truth, NaN if unknown."""
        return float(self._wrench_deviation[3])

    @property
    def torsion_counts(self) -> bool:
        """True if `margin` is that of friction and torsion together."""
        return self.margin == self.limit_margin

    @property
    def _wrench(self) -> Array:
        known = self.field.directions is not None and not self.no_estimate
        return self.field.wrench if known else np.full(4, math.nan)

    @property
    def _wrench_deviation(self) -> Array:
        covariance = self.field.wrench_covariance
        if covariance is None or self.no_estimate:
            return np.full(4, math.nan)
        return np.sqrt(np.maximum(np.diag(covariance), 0.0))


@dataclass(frozen=True, kw_only=True)
class GripCommand:
    """Grip force to apply from now on [N]."""

    force: float
