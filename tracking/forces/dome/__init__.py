"""Force reconstruction on the dome: a contact that is fitted by synthesis, or free tractions."""

from .contact_state import (
    BRISTLE,
    CURVES,
    FRICTION,
    MOVING,
    PLACE,
    PRESS,
    STIFFNESS,
    TWIST,
    moves_of,
    pose_of,
    prior_of,
    units_of,
)
from .contact_way import ContactWay
from .marker_response import DomeResponse
from .untouched import untouched_field

__all__ = [
    "BRISTLE",
    "CURVES",
    "FRICTION",
    "MOVING",
    "PLACE",
    "PRESS",
    "STIFFNESS",
    "TWIST",
    "ContactWay",
    "DomeResponse",
    "moves_of",
    "pose_of",
    "prior_of",
    "units_of",
    "untouched_field",
]
