"""Measurements of the markers in one frame."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class _WhenRead:
    """Descriptor of a field that may be given as a function, which is called on first reading."""

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
    """M numbered markers in each of L layers, from the skin inwards.

    Markers of one number in different layers lie on each other at rest. A layer may lack a number;
    that marker is never visible. What a tracker does not measure (sizes, hues, covariances) is NaN.

    Attributes
    ----------
    time: time of the frame [s]
    position: middle of each marker's image [px], shape (L, M, 2); NaN where not visible
    log_size: logarithm of the marker's size over its size at rest, shape (L, M)
    hue: mean hue over the first layer's marker [°], −180…180, shape (M,). A tracker may give a
        function instead, which is called when the hue is first read; until then the frame's image
        must not be changed
    visible: whether the marker is found in this frame, shape (L, M)
    ambiguous: whether it is found but its number is not certain, shape (L, M)
    last_seen: time of the last frame in which it was found [s], shape (L, M); NaN for never
    covariance: covariance of (x, y, log_size) of all layers, first layer first, (M, 3L, 3L)
    compression: factor by which lossy compression of the picture increased the standard deviations
        of moved markers, estimated from its pixels; `covariance` includes it. 1: no compression
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
        """Make the tracks of a tracker that measures positions only.

        Parameters
        ----------
        time: time of the frame [s]
        position: position of each marker [px], shape (L, M, 2); NaN where it is not visible
        before: tracks of the previous frame, for `last_seen`
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
        """Values to copy or pickle; the hue is measured first, as the image is not copied."""
        return {**vars(self), "hue": self.hue}
