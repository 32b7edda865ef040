"""Labels of the frames of a dataset: their columns and their true values.

If a recipe asks for it, a reconstructor's estimates from the pictures are stored next to them.
"""

from .columns import DOME_TRUTH, INTERVALS, READ, READING, STATES, Column, Columns, columns_of
from .shot import Shot

__all__ = [
    "DOME_TRUTH",
    "INTERVALS",
    "READ",
    "READING",
    "STATES",
    "Column",
    "Columns",
    "Shot",
    "columns_of",
]
