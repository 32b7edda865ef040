"""What the gripper does: a grip force from what is known of the grip."""

from .controllers import ConservativeControl, Controller, ReactToSlip, SafetyMarginControl
from .margin_inversion import MarginInversion
from .settings import (
    PRINTED_SETTINGS,
    ConservativeSettings,
    MarginInversionSettings,
    ReactToSlipSettings,
    SafetyMarginSettings,
)
from .values import GripCommand, GripObservation

__all__ = [
    "PRINTED_SETTINGS",
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
    "SafetyMarginSettings",
]
