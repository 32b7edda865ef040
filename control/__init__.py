"""Controllers of the grip force: F = u + Kp·e + Ki·Σe·T, e = Γ_des − Γ, and others."""

from .controllers import ConservativeControl, Controller, ReactToSlip, SafetyMarginControl
from .margin_inversion import MarginInversion
from .settings import (
    PRINTED_SETTINGS,
    ConservativeSettings,
    GripFirstSettings,
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
    "GripFirstSettings",
    "GripObservation",
    "MarginInversion",
    "MarginInversionSettings",
    "ReactToSlip",
    "ReactToSlipSettings",
    "SafetyMarginControl",
    "SafetyMarginSettings",
]
