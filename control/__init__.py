"""What the gripper does: a grip force from what is known of the grip."""

from .controllers import (
    ConservativeControl,
    ConservativeSettings,
    Controller,
    ReactToSlip,
    ReactToSlipSettings,
    SafetyMarginControl,
    SafetyMarginGains,
)
from .margin_inversion import MarginInversion, MarginInversionSettings
from .values import GripCommand, GripObservation

__all__ = [
    "ConservativeControl",
    "ConservativeSettings",
    "Controller",
    "GripCommand",
    "GripObservation",
    "MarginInversion",
    "MarginInversionSettings",
    "ReactToSlip",
    "ReactToSlipSettings",
    "SafetyMarginControl",
    "SafetyMarginGains",
]
