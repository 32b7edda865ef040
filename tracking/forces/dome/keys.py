"""Key frames: the frames of a contact's history to which the object is fitted."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ....model import Dome
from .key_shifts import Key
from .settings import KeySettings

Array = NDArray[np.float64]


def far_on(dome: Dome, keys: tuple[Key, ...], pose: Array, settings: KeySettings) -> bool:
    """Whether a pose is far enough from the last key frame to become a key frame."""
    return _way(dome, keys[-1].pose, pose, settings) > 1.0


def thinned(dome: Dome, keys: tuple[Key, ...], settings: KeySettings) -> tuple[Key, ...]:
    """Drop the key frame that changes the path least, if there are too many."""
    if len(keys) <= settings.most:
        return keys
    detours = [
        _way(dome, a.pose, b.pose, settings)
        + _way(dome, b.pose, c.pose, settings)
        - _way(dome, a.pose, c.pose, settings)
        for a, b, c in zip(keys[:-2], keys[1:-1], keys[2:], strict=True)
    ]
    out = 1 + int(np.argmin(detours))
    return keys[:out] + keys[out + 1 :]


def _way(dome: Dome, first: Array, second: Array, settings: KeySettings) -> float:
    """Distance between two poses, in units of that between key frames."""
    shift, press = settings.shift * dome.thickness, settings.press * dome.thickness
    unit = np.array([shift, shift, press, settings.twist_rad])
    return float(np.linalg.norm((second - first) / unit))


@dataclass(frozen=True, kw_only=True)
class Backoff:
    """Retries an operation that often fails: the interval doubles after repeated failures.

    Attributes
    ----------
    first, most: chances from one try to the next, at first and at most
    patience: failures in a row after which the interval doubles
    interval: chances from the last try to the next
    waited: chances since the last try
    failures: failures in a row
    """

    first: int
    most: int
    patience: int
    interval: int
    waited: int = 0
    failures: int = 0

    @classmethod
    def from_first(cls, first: int, most: int, patience: int) -> Self:
        """State before the first try."""
        return cls(first=first, most=most, patience=patience, interval=first)

    @property
    def due(self) -> bool:
        """Whether to try now."""
        return self.waited >= self.interval

    def next_chance(self) -> Self:
        """State at the next chance."""
        return replace(self, waited=self.waited + 1)

    def tried(self, better: bool) -> Self:
        """State after a try that succeeded or failed."""
        failures, interval = 0 if better else self.failures + 1, self.interval
        if better:
            interval = self.first
        elif failures % self.patience == 0:
            interval = min(2 * interval, self.most)
        return replace(self, interval=interval, waited=0, failures=failures)
