"""What is known of the markers in one frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Tracks:
    """Markers of both layers, layer 0 magenta, layer 1 yellow; number m is the same marker pair.

    Attributes
    ----------
    time: of the frame [s]
    position: [px], shape (2, M, 2); NaN where not visible
    log_size: logarithm of the marker's size over its nominal size at rest, shape (2, M)
    hue: mean hue over the magenta marker [°], −180…180, shape (M,)
    visible: found in this frame, shape (2, M)
    covariance: of (x, y, log_size) of both layers together, shape (M, 6, 6), magenta first
    """

    time: float
    position: Array
    log_size: Array
    hue: Array
    visible: NDArray[np.bool_]
    covariance: Array
