"""Labels of the frames of a dataset: what they mean, how they are made, and the physics in them.

Beside them stands what a reconstructor reads from the pictures, where a recipe asks for it.
"""

from .columns import (
    COMMON,
    DOME_TRUTH,
    INTERVALS,
    MARKERS,
    READ,
    READING,
    STATES,
    Column,
    Columns,
    columns_of,
)
from .shot import SLIPPING, Shot

__all__ = [
    "COMMON",
    "DOME_TRUTH",
    "INTERVALS",
    "MARKERS",
    "READ",
    "READING",
    "SLIPPING",
    "STATES",
    "Column",
    "Columns",
    "Shot",
    "columns_of",
]
