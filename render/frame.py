"""One camera image."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class Frame:
    """Image of one exposure and its time.

    Attributes
    ----------
    image: sRGB image, rows downwards, uint8, shape (H, W, 3)
    time: time of the exposure [s]
    """

    image: NDArray[np.uint8]
    time: float
