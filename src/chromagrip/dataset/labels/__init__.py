"""Labels of the frames of a dataset: what they mean, how they are made, and the physics in them."""

from .columns import COMMON, DOME_TRUTH, MARKERS, STATES, Columns, columns_of
from .shot import SLIPPING, Shot

__all__ = [
    "COMMON",
    "DOME_TRUTH",
    "MARKERS",
    "SLIPPING",
    "STATES",
    "Columns",
    "Shot",
    "columns_of",
]
