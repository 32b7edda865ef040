"""Drives of the plant: grip and load over time, by force or by position."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError

Array = NDArray[np.float64]
Control = Literal["force", "position"]


@dataclass(frozen=True, kw_only=True)
class Drive:
    """Time series, straight between its points; a time that is given twice is a jump.

    Before the first and after the last point the value stays.

    Attributes
    ----------
    times: of the points, not decreasing [s], shape (K,)
    normal: grip force on the rigid part along z [N], or its position along z [m], shape (K,)
    lateral: load on the object along x [N], or its position along x [m], shape (K,)
    normal_control, lateral_control: which of the two it is
    """

    times: Array
    normal: Array
    lateral: Array
    normal_control: Control = "force"
    lateral_control: Control = "force"

    def __post_init__(self) -> None:
        for name in ("times", "normal", "lateral"):
            values = np.atleast_1d(np.asarray(getattr(self, name), dtype=float))
            object.__setattr__(self, name, values)
            if values.ndim != 1 or values.shape != self.times.shape or not values.size:
                raise UserError(
                    f"drive {name} must be as many values as times, at least one, "
                    f"got shape {values.shape} beside {self.times.shape}"
                )
            if not np.isfinite(values).all():
                raise UserError(f"drive {name} must be finite, got {values}")
        if (np.diff(self.times) < 0.0).any():
            raise UserError(f"drive times must not decrease, got {self.times}")
        for name in ("normal_control", "lateral_control"):
            if getattr(self, name) not in get_args(Control):
                raise UserError(
                    f"drive {name} must be force or position, got {getattr(self, name)!r}"
                )

    @classmethod
    def constant(cls, grip: float, load: float = 0.0) -> Self:
        """Grip force and load [N] that stay as they are."""
        return cls(times=np.zeros(1), normal=np.array([grip]), lateral=np.array([load]))

    @property
    def held(self) -> tuple[bool, bool]:
        """Whether the position of rigid part and object is given, rather than the force."""
        return self.normal_control == "position", self.lateral_control == "position"

    def at(self, time: Array) -> Array:
        """Both values at some times, after a jump that falls on one; shape (T, 2)."""
        return self._evaluate(time)[0]

    def rate(self, time: Array) -> Array:
        """Slope of both values at some times, after a jump that falls on one; shape (T, 2)."""
        return self._evaluate(time)[1]

    @cached_property
    def _pieces(self) -> tuple[Array, Array]:
        """Values (K, 2), and slopes before, between and after the points (K + 1, 2)."""
        values = np.column_stack([self.normal, self.lateral])
        slopes = np.zeros((len(self.times) + 1, 2))
        step = np.diff(self.times)
        rising = step > 0.0
        slopes[1:-1][rising] = np.diff(values, axis=0)[rising] / step[rising, None]
        return values, slopes

    def _evaluate(self, time: Array) -> tuple[Array, Array]:
        values, slopes = self._pieces
        # Sums of steps round: an instant just before a point is that point.
        piece = np.searchsorted(self.times, np.asarray(time) + 1e-12, side="right")
        start = np.maximum(piece - 1, 0)
        since = np.asarray(time) - self.times[start]
        return values[start] + slopes[piece] * since[:, None], slopes[piece]
