"""What is known of the markers in one frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Tracks:
    """Markers of L layers, from the skin inwards; number m of all layers sat together at rest.

    A layer that has no marker of a number at rest never shows it. What a tracker does not measure
    (sizes, hues, covariances) is NaN.

    Attributes
    ----------
    time: of the frame [s]
    position: of the middle of each marker's image [px], shape (L, M, 2); NaN where not visible
    log_size: logarithm of the marker's size over its size at rest, shape (L, M)
    hue: mean hue over the first layer's marker [°], −180…180, shape (M,)
    visible: found in this frame, shape (L, M)
    ambiguous: found, but its number is not certain, shape (L, M)
    last_seen: time of the last frame that it was found in [s], shape (L, M); NaN for never
    covariance: of (x, y, log_size) of all layers together, shape (M, 3L, 3L), first layer first
    """

    time: float
    position: Array
    log_size: Array
    hue: Array
    visible: NDArray[np.bool_]
    ambiguous: NDArray[np.bool_]
    last_seen: Array
    covariance: Array
