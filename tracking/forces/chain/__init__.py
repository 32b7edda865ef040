"""Force reconstruction on the chain: from marker shifts to nodal forces, f = K(u)·u.

The contact is unknown: forces come from a regression trained on the model's histories (`learned`).
"""

from .codes import odd_statistic
from .fields import at_places, circle_places, fields_on_circles
from .learned import Learned
from .noise_level import believed
from .readout import (
    BEND,
    Layers,
    ReadOut,
    forward,
    limited,
    linear_sums,
    load_readout,
    network_inputs,
    save_readout,
)
from .residual import Smooth, smooth_functions
from .sensitivity import MarkerResponse
from .settings import LearnedSettings
from .specimen import SIZES, with_focus, with_focus_variances
from .used import Used, UsedReadOut, histories_of, readout_digest, readout_origin, used

__all__ = [
    "BEND",
    "SIZES",
    "Layers",
    "Learned",
    "LearnedSettings",
    "MarkerResponse",
    "ReadOut",
    "Smooth",
    "Used",
    "UsedReadOut",
    "at_places",
    "believed",
    "circle_places",
    "fields_on_circles",
    "forward",
    "histories_of",
    "limited",
    "linear_sums",
    "load_readout",
    "network_inputs",
    "odd_statistic",
    "readout_digest",
    "readout_origin",
    "save_readout",
    "smooth_functions",
    "used",
    "with_focus",
    "with_focus_variances",
]
