"""One camera image."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class Frame:
    """Image and instant of one exposure.

    Attributes
    ----------
    image: sRGB, rows downwards, uint8, shape (H, W, 3)
    time: [s]
    """

    image: NDArray[np.uint8]
    time: float
