"""What is known of the markers in one frame."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class _WhenRead:
    """Field that may be given as a function, which is called when the field is first read."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, instance: object, owner: type | None = None) -> Array:
        if instance is None:
            raise AttributeError(self._name)  # the field has no default
        values = vars(instance)
        if callable(values[self._name]):
            values[self._name] = values[self._name]()
        value: Array = values[self._name]
        return value

    def __set__(self, instance: object, value: Array | Callable[[], Array]) -> None:
        vars(instance)[self._name] = value


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
    hue: mean hue over the first layer's marker [°], −180…180, shape (M,); a tracker may give a
        function that measures it, which is called when it is first read: until then the frame's
        image must not be changed
    visible: found in this frame, shape (L, M)
    ambiguous: found, but its number is not certain, shape (L, M)
    last_seen: time of the last frame in which it was found [s], shape (L, M); NaN for never
    covariance: of (x, y, log_size) of all layers together, shape (M, 3L, 3L), first layer first
    compression: factor by which lossy compression of the picture, as far as its pixels show it,
        enlarged the deviations of places that moved, which the covariance contains; 1 for none
    """

    time: float
    position: Array
    log_size: Array
    hue: _WhenRead = _WhenRead()
    visible: NDArray[np.bool_]
    ambiguous: NDArray[np.bool_]
    last_seen: Array
    covariance: Array
    compression: float = 1.0

    @classmethod
    def of_positions(cls, time: float, position: Array, before: "Tracks | None" = None) -> "Tracks":
        """Tracks of a tracker that measures places alone.

        Parameters
        ----------
        time: of the frame [s]
        position: of each marker [px], shape (L, M, 2); NaN where it is not visible
        before: of the frame before, which knows when markers were seen last
        """
        position = np.asarray(position, dtype=float)
        layers, count, _ = position.shape
        visible = np.asarray(np.isfinite(position).all(axis=2))
        never = np.full((layers, count), np.nan) if before is None else before.last_seen
        return cls(
            time=time,
            position=np.where(visible[..., None], position, np.nan),
            log_size=np.full((layers, count), np.nan),
            hue=np.full(count, np.nan),
            visible=visible,
            ambiguous=np.zeros_like(visible),
            last_seen=np.where(visible, time, never),
            covariance=np.full((count, 3 * layers, 3 * layers), np.nan),
        )

    def __getstate__(self) -> dict[str, Any]:
        """Values to copy or pickle: the hue is measured, the image stays behind."""
        return {**vars(self), "hue": self.hue}
