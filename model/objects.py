"""The object that is gripped: its surface, its friction and how it moves."""

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from ..errors import UserError
from .checks import finite, within

#: Above this a penalty stiffness loses the contact force in the rounding of a position [N/m].
STIFFEST = 1e9

#: What the surface does when its object slides.
Surface = Literal["travels", "stays"]


@dataclass(frozen=True, kw_only=True)
class ContactObject:
    """An object that just touches the fingertip at rest, slides along x and carries the load.

    Per-node values hold at 251 nodes and are scaled with the node spacing.

    Attributes
    ----------
    stiffness: normal penalty stiffness k_c per node (thesis Eq. 4 with erratum E4) [N/m]
    friction: friction coefficient µ
    patches: points (x, factor): at a place x of the surface [m], in the object's own frame, µ is
        `friction` times the factor, straight between the points and constant beyond; x increasing.
        Empty is one µ everywhere
    curvature: 1/radius of a round object, 0 for a flat one, negative for a hollow [1/m]
    profile: surface as points (x, z), x increasing, z from the fingertip into the object [m]; a
        smooth curve goes through them and on straight beyond the ends. Only its shape counts: it is
        moved along z until it touches. None is flat or round
    surface: `travels` moves it with the object, as a rigid body is; `stays` leaves it where it was
        and only friction follows the object, so that no normal force changes because the object
        slides (thesis Eq. 4 read with x the depth at a place). The same for a flat object
    dahl_stiffness: bristle stiffness σ0 per node (E8) [N/m]
    dahl_exponent: exponent n of the Dahl law (E8)
    drag: lateral damper from the object to ground (E9) [N·s/m]
    """

    stiffness: float = 1000.0
    friction: float = 0.5
    patches: tuple[tuple[float, float], ...] = ()
    curvature: float = 0.0
    profile: tuple[tuple[float, float], ...] | None = None
    surface: Surface = "travels"
    dahl_stiffness: float = 5000.0
    dahl_exponent: float = 0.7
    drag: float = 120.0

    def __post_init__(self) -> None:
        finite("object stiffness", self.stiffness, "N/m", above=0.0, below=STIFFEST)
        finite("friction coefficient", self.friction, "", above=0.0)
        finite("Dahl stiffness", self.dahl_stiffness, "N/m", above=0.0, below=STIFFEST)
        finite("object drag", self.drag, "N·s/m", above=0.0)
        within("object curvature", self.curvature, "1/m", -1000.0, 1000.0)
        within("Dahl exponent", self.dahl_exponent, "", 0.1, 2.0)
        if self.surface not in get_args(Surface):
            allowed = ", ".join(get_args(Surface))
            raise UserError(f"object surface must be one of {allowed}, got {self.surface!r}")
        if self.profile is not None:
            _check_profile(self.profile, self.curvature)
        if self.patches:
            _check_patches(self.patches)


def _check_profile(profile: tuple[tuple[float, float], ...], curvature: float) -> None:
    if curvature != 0.0:
        raise UserError(f"object curvature must be 0 beside a profile, got {curvature!r}")
    if len(profile) < 3 or any(len(point) != 2 for point in profile):
        raise UserError(f"object profile must be at least 3 points (x, z), got {profile!r}")
    if not all(math.isfinite(value) for point in profile for value in point):
        raise UserError("object profile must be finite")
    if not (np.diff([x for x, _ in profile]) > 0.0).all():
        raise UserError("object profile must have increasing x")


def _check_patches(patches: tuple[tuple[float, float], ...]) -> None:
    if any(len(point) != 2 for point in patches):
        raise UserError(f"object patches must be points (x, factor), got {patches!r}")
    for place, factor in patches:
        within("place of an object patch", place, "m", -1.0, 1.0)
        within("factor of an object patch", factor, "", 1e-3, 1e3)
    if not (np.diff([x for x, _ in patches]) > 0.0).all():
        raise UserError("object patches must have increasing x")


def stiffness_from_young(young_modulus: float) -> float:
    """Node stiffness k_c = E·d/2 with d = 10 mm, the conversion behind Table 2 (E4).

    Parameters
    ----------
    young_modulus: stiffness of the object's material [Pa]

    Returns
    -------
    Penalty stiffness per node at 251 nodes [N/m].
    """
    return young_modulus * 10e-3 / 2
