"""Controllers of the grip force: F = u + Kp·e + Ki·Σe·T, e = Γ_des − Γ, and others."""

from .controllers import ConservativeControl, Controller, ReactToSlip, SafetyMarginControl
from .grip_first import DoubtSettings
from .limit_surface import LimitSurfaceControl
from .margin_inversion import InversionSettings, MarginInversion
from .settings import (
    PRINTED_SETTINGS,
    ConservativeSettings,
    GripFirstSettings,
    LimitSurfaceSettings,
    MarginInversionSettings,
    ReactToSlipSettings,
    SafetyMarginSettings,
)
from .sliding import SlidingSettings
from .values import GripCommand, GripObservation

__all__ = [
    "PRINTED_SETTINGS",
    "ConservativeControl",
    "ConservativeSettings",
    "Controller",
    "DoubtSettings",
    "GripCommand",
    "GripFirstSettings",
    "GripObservation",
    "InversionSettings",
    "LimitSurfaceControl",
    "LimitSurfaceSettings",
    "MarginInversion",
    "MarginInversionSettings",
    "ReactToSlip",
    "ReactToSlipSettings",
    "SafetyMarginControl",
    "SafetyMarginSettings",
    "SlidingSettings",
]
