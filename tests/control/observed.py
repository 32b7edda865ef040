"""Observations of one node, which tests give to controllers."""

import math
from typing import Any

import numpy as np

from chromagrip.control import GripObservation
from chromagrip.model import ForceField

PERIOD = 1.0 / 60.0


def field(normal: float, friction: float, deviation: float = 0.0) -> ForceField:
    """Forces of one node [N], and the standard deviation of its friction."""
    return ForceField(
        position=np.zeros((1, 2)),
        normal=np.array([normal]),
        friction=np.array([friction]),
        contact=np.array([normal > 0.0]),
        totals_covariance=np.diag([1e-6 if deviation else 0.0, deviation**2]),
    )


def seen(
    time: float,
    margin: float,
    half: float = 0.0,
    *,
    normal: float = 1.0,
    mu: float = 0.5,
    **more: Any,
) -> GripObservation:
    """Observation of Γ ± `half` under a grip; all else is exact unless it is given."""
    friction = 0.0 if math.isnan(margin) or not normal > 0.0 else mu * normal * (1.0 - margin)
    told = {
        "time": time,
        "field": field(normal, friction),
        "friction": mu,
        "friction_interval": (mu, mu),
        "friction_observable": True,
        "margin": margin,
        "margin_interval": (margin - half, margin + half),
        "lateral_displacement": math.nan,
    }
    return GripObservation(**(told | more))
