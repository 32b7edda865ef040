"""The object that is gripped: its surface, its friction and how it moves."""

from dataclasses import dataclass

from .checks import finite, within


@dataclass(frozen=True, kw_only=True)
class ContactObject:
    """A flat or convex object that touches the apex at rest, slides along x and carries the load.

    Per-node values hold at 251 nodes and are scaled with the node spacing.

    Attributes
    ----------
    stiffness: normal penalty stiffness k_c per node (thesis Eq. 4 with erratum E4) [N/m]
    friction: friction coefficient µ
    curvature: 1/radius of a round object, 0 for a flat one [1/m]
    dahl_stiffness: bristle stiffness σ0 per node (E8) [N/m]
    dahl_exponent: exponent n of the Dahl law (E8)
    drag: lateral damper from the object to ground (E9) [N·s/m]
    """

    stiffness: float = 1000.0
    friction: float = 0.5
    curvature: float = 0.0
    dahl_stiffness: float = 5000.0
    dahl_exponent: float = 0.7
    drag: float = 120.0

    def __post_init__(self) -> None:
        finite("object stiffness", self.stiffness, "N/m", above=0.0)
        finite("friction coefficient", self.friction, "", above=0.0)
        finite("Dahl stiffness", self.dahl_stiffness, "N/m", above=0.0)
        finite("object drag", self.drag, "N·s/m", above=0.0)
        within("object curvature", self.curvature, "1/m", 0.0, 1000.0)
        within("Dahl exponent", self.dahl_exponent, "", 0.1, 2.0)


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
