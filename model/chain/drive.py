"""Drive of fingertip and object: grip and load over time, as forces or as positions."""

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
    """Time series of grip and load, linear between its K points.

    Two points at the same time are a jump. Before the first and after the last point the values are
    constant.

    Attributes
    ----------
    times: times of the points, not decreasing [s], shape (K,)
    normal: grip force on the rigid part along z [N], or its position along z [m], shape (K,)
    lateral: load on the object along x [N], or its position along x [m], shape (K,)
    normal_control, lateral_control: whether `normal` and `lateral` are forces or positions
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
        """Make a drive with constant grip force and load [N]."""
        return cls(times=np.zeros(1), normal=np.array([grip]), lateral=np.array([load]))

    @property
    def held(self) -> tuple[bool, bool]:
        """Whether the position of rigid part and object is given, rather than the force."""
        return self.normal_control == "position", self.lateral_control == "position"

    @cached_property
    def _pieces(self) -> tuple[Array, Array]:
        """Values at the points (K, 2); derivatives before, between and after them (K + 1, 2)."""
        values = np.column_stack([self.normal, self.lateral])
        slopes = np.zeros((len(self.times) + 1, 2))
        step = np.diff(self.times)
        rising = step > 0.0
        slopes[1:-1][rising] = np.diff(values, axis=0)[rising] / step[rising, None]
        return values, slopes

    def at(self, time: Array) -> Array:
        """Values of `normal` and `lateral` at T times, after any jump there, shape (T, 2)."""
        values, slopes = self._pieces
        # Sums of steps have rounding errors: a time just before a point counts as that point.
        piece = np.searchsorted(self.times, np.asarray(time) + 1e-12, side="right")
        start = np.maximum(piece - 1, 0)
        since = np.asarray(time) - self.times[start]
        return np.asarray(values[start] + slopes[piece] * since[:, None])
