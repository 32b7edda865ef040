"""Key frames: those of a contact's history that are kept, so that the object is fitted to all."""

import numpy as np
from numpy.typing import NDArray

from ....model import Dome
from .key_shifts import Key

Array = NDArray[np.float64]

#: Most key frames.
KEYS = 8
#: Way from one key pose to the next: shift and press in thicknesses of the silicone, twist [rad].
_APART = (0.01, 0.01, 0.015, 0.03)


def far_on(dome: Dome, keys: tuple[Key, ...], pose: Array) -> bool:
    """Whether a pose is so far from that of the last key frame that it makes another one."""
    return _way(dome, keys[-1].pose, pose) > 1.0


def thinned(dome: Dome, keys: tuple[Key, ...]) -> tuple[Key, ...]:
    """The key frames, without the one that changes the way least where they are too many."""
    if len(keys) <= KEYS:
        return keys
    detours = [
        _way(dome, a.pose, b.pose) + _way(dome, b.pose, c.pose) - _way(dome, a.pose, c.pose)
        for a, b, c in zip(keys[:-2], keys[1:-1], keys[2:], strict=True)
    ]
    out = 1 + int(np.argmin(detours))
    return keys[:out] + keys[out + 1 :]


def _way(dome: Dome, first: Array, second: Array) -> float:
    """Length of the way between two poses, in units of that from one key to the next."""
    unit = np.array([*(share * dome.thickness for share in _APART[:3]), _APART[3]])
    return float(np.linalg.norm((second - first) / unit))


class Backoff:
    """Retries an operation that often fails: the interval doubles after repeated failures.

    Parameters
    ----------
    first, most: chances from one try to the next, at first and at most
    patience: failures in a row after which the interval doubles
    """

    def __init__(self, first: int, most: int, patience: int) -> None:
        self._first, self._most, self._patience = first, most, patience
        self._wait = self._left = first
        self._vain = 0

    def due(self) -> bool:
        """Whether to try now."""
        self._left -= 1
        return self._left <= 0

    def tried(self, better: bool) -> None:
        """Report whether a try succeeded."""
        self._vain = 0 if better else self._vain + 1
        if better:
            self._wait = self._first
        elif self._vain % self._patience == 0:
            self._wait = min(2 * self._wait, self._most)
        self._left = self._wait
