"""Cost that a fit of a contact minimises, and its normal equations."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ....model import Dome
from .contact_state import CURVES, MOVING, OBJECT, moves_of, prior_of, units_of
from .key_shifts import Explained
from .settings import ContactFitSettings

Array = NDArray[np.float64]


class ContactCost:
    """Cost of an object, (8,), and of its poses in K key frames, (K, 4).

    Parameters
    ----------
    dome: body
    settings: tuned parameters
    """

    def __init__(self, dome: Dome, settings: ContactFitSettings) -> None:
        self.dome, self._settings = dome, settings
        self.units = units_of(dome)
        self._prior = prior_of(dome)
        self._hollow = settings.model.hollow / dome.radius

    def _share(self, keys: int) -> float:
        """Weight of each key frame: errors of the model are common to all."""
        return min(1.0, self._settings.independent_keys / keys)

    def of(self, losses: Sequence[float], object_: Array, poses: Array) -> float:
        """Cost: residuals and distances from the prior [squared standard deviations].

        Parameters
        ----------
        losses: loss of each key frame, see `Shifts.loss`
        """
        off = (object_ - self._prior.mean) / self._prior.deviation
        hollow = np.minimum(object_[CURVES], 0.0)[:2] / self._hollow
        moves = np.diff(poses, axis=0, prepend=0.0) / moves_of(
            self.dome, poses, self._settings.model
        )
        known = float(off @ off + hollow @ hollow)
        return self._share(len(losses)) * sum(losses) + known + float((moves**2).sum())

    def normal(
        self, explained: Sequence[Explained], object_: Array, poses: Array
    ) -> tuple[Array, Array]:
        """Information matrix and gradient of the object, then of each pose, in their units."""
        first = len(OBJECT)
        size = first + MOVING * len(poses)
        information, gradient = np.zeros((size, size)), np.zeros(size)
        share = self._share(len(explained))
        for k, each in enumerate(explained):
            own = np.r_[first + MOVING * k : first + MOVING * (k + 1), 0:first]
            information[own[:, None], own] += share * each.normal[0]
            gradient[own] += share * each.normal[1]
        known = (self.units[MOVING:] / self._prior.deviation) ** 2
        information[:first, :first] += np.diag(known)
        gradient[:first] += known * (self._prior.mean - object_) / self.units[MOVING:]
        hollow = np.flatnonzero(object_[CURVES][:2] < 0.0) + CURVES.start
        units = self.units[MOVING:][hollow]
        information[hollow, hollow] += (units / self._hollow) ** 2
        gradient[hollow] -= units * object_[hollow] / self._hollow**2
        # Each pose is near the one before, the first one near rest.
        near = (self.units[:MOVING] / moves_of(self.dome, poses, self._settings.model)) ** 2
        moves = np.diff(poses, axis=0, prepend=0.0) / self.units[:MOVING]
        for k, (move, known) in enumerate(zip(moves, near, strict=True)):
            own = np.arange(first + MOVING * k, first + MOVING * (k + 1))
            information[own, own] += known
            gradient[own] -= known * move
            if k:
                information[own - MOVING, own - MOVING] += known
                information[own, own - MOVING] -= known
                information[own - MOVING, own] -= known
                gradient[own - MOVING] += known * move
        return information, gradient
