"""Labels of the frames of a dataset: their columns, their true values and checks of their physics.

If a recipe asks for it, a reconstructor's estimates from the pictures are stored next to them.
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
