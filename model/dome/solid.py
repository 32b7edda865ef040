"""Object that touches a dome: its shape, and its stiffness and friction per area."""

import math
from dataclasses import dataclass

from ..checks import finite, within
from ..kernels.dome.touch_kernels import Touched
from ..shapes import Shape

#: Distance between nodes of the chain at 251 nodes, π·8 mm/252, and depth of its strip [m].
_CHAIN_PITCH = math.pi * 8e-3 / 252
_STRIP = 10e-3
#: Penalty stiffness above which an object is rigid to the last digit of a node's place [N/m³].
STIFFEST = 1e14


@dataclass(frozen=True, kw_only=True)
class Solid:
    """Object in three dimensions.

    Attributes
    ----------
    shape: shape, with its signed distance
    stiffness: penalty stiffness k per area [N/m³]; see `solid_stiffness`
    friction: coefficient µ
    dahl_stiffness: bristle stiffness σ0 per area [N/m³]
    dahl_exponent: exponent n of the Dahl law; 0 is Coulomb friction with elastic stick
    """

    shape: Shape
    stiffness: float = 1e9
    friction: float = 0.5
    dahl_stiffness: float = 5e9
    dahl_exponent: float = 0.7

    def __post_init__(self) -> None:
        finite("object stiffness", self.stiffness, "N/m³", above=0.0, below=STIFFEST)
        finite("friction coefficient", self.friction, "", above=0.0, below=10.0)
        finite("Dahl stiffness", self.dahl_stiffness, "N/m³", above=0.0, below=STIFFEST)
        within("Dahl exponent", self.dahl_exponent, "", 0.0, 2.0)


def solid_stiffness(young_modulus: float) -> float:
    """Stiffness per area of an object [N/m³], E/(2·pitch) with the chain's pitch.

    A node of the chain represents a strip of 10 mm, and the contact stiffness of an object of
    Young's modulus E on it is E·10 mm/2 (erratum E4). Over the node's area, 10 mm times the pitch
    of 251 nodes, that is E/(2·pitch): 200 kPa give 1e9 N/m³. This does not depend on the dome's own
    pitch.

    Parameters
    ----------
    young_modulus: Young's modulus of the object [Pa]
    """
    finite("stiffness of an object", young_modulus, "Pa", above=0.0)
    return per_area(young_modulus * _STRIP / 2.0)


def per_area(stiffness: float) -> float:
    """Convert a stiffness per node at 251 nodes [N/m] to a stiffness per area [N/m³]."""
    return stiffness / (_STRIP * _CHAIN_PITCH)


def touched(solid: Solid) -> Touched:
    """Convert an object to the form that the kernels take."""
    shape = solid.shape
    return Touched(
        shape.kind, shape.numbers, shape.grid, shape.origin, shape.cells,
        float(solid.stiffness), float(solid.friction), float(solid.dahl_stiffness),
        float(solid.dahl_exponent),
    )  # fmt: skip
