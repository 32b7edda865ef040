"""Two fingertips that face each other, an object between them, and the hand that carries both."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ..checks import finite
from ..dome.dome import SoftBody
from ..dome.placing import rotation_of, touching_place
from ..dome.solid import Solid
from .body import Filling, RigidBody
from .hand import HandPath

Array = NDArray[np.float64]

#: Axes of the second fingertip in the hand's: turned by half a turn about x.
FACING = np.array([1.0, -1.0, -1.0])
#: Damper of each fingertip's way on which the drive closes it [N·s/m]: that of the whole chain.
CLOSING_DRAG = 25.2


@dataclass(frozen=True, kw_only=True)
class Pinch:
    """Two fingertips, an object and a hand.

    The world's axes are those of the hand at the start: x is down, along gravity, and z goes from
    the first fingertip to the second. The first fingertip has the hand's axes. The second one is
    rotated by half a turn about x, so that a weight acts along +x of both.

    Attributes
    ----------
    first, second: fingertips
    solid: shape and material of the object
    body: mass properties of the object
    filling: mass that is added to it over time; None: no mass is added
    hand: path of the hand
    turned: rotation vector of the object at the start [rad]
    beside: offset of the object's origin from the axis of the pinch, along x and y [m]
    drag: damper of each fingertip against the closing drive [N·s/m]
    gravity: acceleration of gravity [m/s²]
    table: whether the object stands on a table until it is lifted. The table pushes along x through
        the centre of mass; it has no friction and holds no torque
    """

    first: SoftBody
    second: SoftBody
    solid: Solid
    body: RigidBody
    hand: HandPath = field(default_factory=HandPath)
    filling: Filling | None = None
    turned: tuple[float, float, float] = (0.0, 0.0, 0.0)
    beside: tuple[float, float] = (0.0, 0.0)
    drag: float = CLOSING_DRAG
    gravity: tuple[float, float, float] = (9.81, 0.0, 0.0)
    table: bool = True

    def __post_init__(self) -> None:
        finite("drag of the drive", self.drag, "N·s/m", above=0.0)
        if len(self.gravity) != 3 or not all(math.isfinite(part) for part in self.gravity):
            raise UserError(f"gravity must be three finite numbers, got {self.gravity}")
        if self.table and not any(self.gravity):
            raise UserError("an object without gravity stands on no table")
        if not np.isfinite(self.solid.shape.bounds).all():
            raise UserError(f"a pinch needs an object with an end: not a {self.solid.shape.name}")

    def body_at(self, time: float) -> RigidBody:
        """Mass properties of the object at a time [s], with the added mass."""
        body = self.body
        if self.filling is None:
            return body
        share = 1.0 + self.filling.at(time) / body.mass
        x, y, z = body.inertia
        return replace(body, mass=share * body.mass, inertia=(share * x, share * y, share * z))

    @property
    def down(self) -> Array:
        """Unit vector along gravity, shape (3,)."""
        gravity = np.array(self.gravity)
        return np.asarray(gravity / np.linalg.norm(gravity))

    @property
    def table_stiffness(self) -> float:
        """Stiffness of the table under the centre of mass [N/m]."""
        gives = 10e-6  # how far a body's weight presses into the table [m]
        return self.body.mass * float(np.linalg.norm(self.gravity)) / gives


def bases(pinch: Pinch) -> tuple[Array, Array]:
    """Positions of the fingertips' centres in the hand [m], (3,), where both touch the object.

    The object's origin is at that of the hand, moved by `beside`.

    Raises
    ------
    UserError: where the object cannot lie on a fingertip
    """
    rotation = rotation_of(np.array([0.0, 0.0, 0.0, *pinch.turned]))
    x, y = pinch.beside
    low = touching_place(pinch.first, pinch.solid, rotation, (x, y))[2]
    high = touching_place(pinch.second, pinch.solid, FACING[:, None] * rotation, (x, -y))[2]
    return np.array([0.0, 0.0, -low]), np.array([0.0, 0.0, high])
