"""What a controller is given and what it answers."""

from dataclasses import dataclass

from ..model import ForceField


@dataclass(frozen=True, kw_only=True)
class GripObservation:
    """What is known of the grip when a frame has been read.

    Attributes
    ----------
    time: instant of the frame [s]
    field: contact forces
    friction: friction coefficient µ in use; NaN while nothing was in contact
    friction_interval: 90 % interval of µ
    friction_observable: whether µ has shown at all so far: a pure press does not show it (E7)
    margin: safety margin Γ; NaN with nothing in contact
    margin_interval: 90 % interval of Γ
    lateral_displacement: of the object over the fingertip [m]; NaN on the camera path, where the
        object's motion is not in the image
    no_estimate: why the frame says nothing of the forces; empty when it does
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


@dataclass(frozen=True, kw_only=True)
class GripCommand:
    """Grip force to apply from now on [N]."""

    force: float
