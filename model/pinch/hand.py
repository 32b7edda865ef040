"""Path of the hand that carries both fingertips."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ..checks import finite
from .body import rotation_by

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Shake:
    """Sine that is added to the hand's position; it grows in its first period, fades in its last.

    Attributes
    ----------
    amplitude: amplitude along each axis [m], shape (3,)
    frequency: frequency [Hz]
    start, stop: first and last time [s]
    """

    amplitude: tuple[float, float, float]
    frequency: float
    start: float
    stop: float

    def __post_init__(self) -> None:
        finite("frequency of a shake", self.frequency, "Hz", above=0.0)
        if not self.stop >= self.start + 2.0 / self.frequency:
            raise UserError("a shake must last for two periods or more")

    def at(self, time: float) -> Array:
        """Displacement of the hand at a time [m], shape (3,)."""
        if not self.start < time < self.stop:
            return np.zeros(3)
        periods = self.frequency * min(time - self.start, self.stop - time)
        grown = _smooth(min(periods, 1.0))
        phase = 2.0 * math.pi * self.frequency * (time - self.start)
        return np.array(self.amplitude) * (grown * math.sin(phase))


@dataclass(frozen=True, kw_only=True)
class HandPath:
    """Pose of the hand over time, in the world's axes; the hand is at rest at every knot.

    Between knots it moves with minimum jerk, so that its acceleration is continuous.

    Attributes
    ----------
    times: times of the knots, increasing from 0 [s]
    places: positions at the knots [m], each (3,)
    turns: rotation vectors at the knots [rad], each (3,); empty: no rotation
    shake: sine that is added to the position; None: no shake
    """

    times: tuple[float, ...] = (0.0,)
    places: tuple[tuple[float, float, float], ...] = ((0.0, 0.0, 0.0),)
    turns: tuple[tuple[float, float, float], ...] = ()
    shake: Shake | None = None

    def __post_init__(self) -> None:
        times = np.array(self.times)
        if not len(times) or times[0] != 0.0 or not (np.diff(times) > 0.0).all():
            raise UserError("times of a hand's path must increase from 0")
        for name, values in (("places", self.places), ("turns", self.turns or self.places)):
            if np.shape(values) != (len(times), 3) or not np.isfinite(values).all():
                raise UserError(f"{name} of a hand's path must be {len(times)} finite points")

    def at(self, time: float) -> tuple[Array, Array]:
        """Position [m] (3,) and rotation matrix (3, 3) of the hand at a time [s]."""
        place = self._between(self.places, time)
        if self.shake is not None:
            place = place + self.shake.at(time)
        if not self.turns:
            return place, np.eye(3)
        return place, rotation_by(self._between(self.turns, time))

    def _between(self, values: tuple[tuple[float, float, float], ...], time: float) -> Array:
        """Interpolate values at the knots with minimum jerk."""
        k = int(np.searchsorted(self.times, time, side="right")) - 1
        if k < 0 or k + 1 >= len(self.times):
            return np.array(values[max(k, 0)])
        share = (time - self.times[k]) / (self.times[k + 1] - self.times[k])
        here, there = np.array(values[k]), np.array(values[k + 1])
        return here + _smooth(share) * (there - here)


def _smooth(share: float) -> float:
    """Minimum-jerk polynomial from 0 to 1."""
    return share**3 * (10.0 - 15.0 * share + 6.0 * share * share)
