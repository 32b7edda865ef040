"""What the gripper does: a grip force from a force field, F = u + Kp·e + Ki·Σe (thesis Eq. 6)."""

from .controllers import (
    ConservativeControl,
    ConservativeSettings,
    Controller,
    ReactToSlip,
    ReactToSlipSettings,
    SafetyMarginControl,
    SafetyMarginGains,
)
from .values import GripCommand, GripObservation

__all__ = [
    "ConservativeControl",
    "ConservativeSettings",
    "Controller",
    "GripCommand",
    "GripObservation",
    "ReactToSlip",
    "ReactToSlipSettings",
    "SafetyMarginControl",
    "SafetyMarginGains",
]
