"""Force reconstruction on the dome: a contact that is fitted by synthesis."""

from ..silicone_values import ON_CORE
from .contact_state import (
    BRISTLE,
    CURVES,
    FRICTION,
    MOVING,
    PLACE,
    PRESS,
    STIFFNESS,
    TWIST,
    limited_object,
    limited_pose,
    moves_of,
    pose_of,
    prior_of,
    units_of,
)
from .contact_way import Changes, ContactWay
from .marker_response import DomeResponse
from .settings import INDEPENDENT, PLACE_ERROR, SIZE_ERROR, ContactSettings
from .untouched import untouched_field

__all__ = [
    "BRISTLE",
    "CURVES",
    "FRICTION",
    "INDEPENDENT",
    "MOVING",
    "ON_CORE",
    "PLACE",
    "PLACE_ERROR",
    "PRESS",
    "SIZE_ERROR",
    "STIFFNESS",
    "TWIST",
    "Changes",
    "ContactSettings",
    "ContactWay",
    "DomeResponse",
    "limited_object",
    "limited_pose",
    "moves_of",
    "pose_of",
    "prior_of",
    "units_of",
    "untouched_field",
]
