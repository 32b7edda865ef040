"""Controllers of the grip force: F = u + Kp·e + Ki·Σe·T, e = Γ_des − Γ, and others."""

from .controllers import ConservativeControl, Controller, ReactToSlip, SafetyMarginControl
from .limit_surface import LimitSurfaceControl
from .margin_inversion import MarginInversion
from .settings import (
    PRINTED_SETTINGS,
    ConservativeSettings,
    GripFirstSettings,
    LimitSurfaceSettings,
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
    "LimitSurfaceControl",
    "LimitSurfaceSettings",
    "MarginInversion",
    "MarginInversionSettings",
    "ReactToSlip",
    "ReactToSlipSettings",
    "SafetyMarginControl",
    "SafetyMarginSettings",
]
