"""Whitened shifts of the markers in a frame, and their comparison with a contact."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .settings import ShiftSettings

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Shifts:
    """Shifts of the V used pairs of a frame, with the matrices that whiten them.

    Attributes
    ----------
    values: shifts (x, y, log size) of both layers, shape (V, 6)
    whiten: matrices from a pair's shifts to W independent values of unit variance, (V, W, 6)
    used: mask of these pairs among all P pairs, shape (P,)
    settings: tuned parameters
    """

    values: Array
    whiten: Array
    used: NDArray[np.bool_]
    settings: ShiftSettings = ShiftSettings()

    def apply(self, shifts: Array) -> Array:
        """Whitened shifts (…, V, 6) as one vector, shape (…, V·W)."""
        # One small matrix product for each pair is ten times as fast as a single `einsum`.
        several = shifts.reshape(-1, *shifts.shape[-2:]).swapaxes(0, 1)
        whole = several @ self.whiten.swapaxes(1, 2)
        return whole.swapaxes(0, 1).reshape(*shifts.shape[:-2], -1)

    def residual(self, predicted: Array) -> Array:
        """Whitened residual against predicted shifts (…, P, 6), shape (…, V·W)."""
        return self.apply(self.values - predicted[..., self.used, :])

    def weights(self, residual: Array) -> Array:
        """Weight of every value; pairs with large residuals have less weight (Cauchy)."""
        return 1.0 / (1.0 + self._each(residual) / self.settings.odd**2)

    def loss(self, predicted: Array) -> float:
        """Loss that a fit minimises, with little influence of outliers (Cauchy)."""
        settings = self.settings
        each = self._each(self.residual(predicted))
        return float(settings.odd**2 * np.log1p(each / settings.odd**2).sum())

    def cost(self, predicted: Array) -> float:
        """Sum of squared residuals, linear for outliers (Huber)."""
        settings = self.settings
        size = np.sqrt(self._each(self.residual(predicted)))
        share = np.minimum(1.0, settings.off / np.maximum(size, settings.off))
        return float((share * (2.0 - share) * size**2).sum())

    def typical(self, predicted: Array) -> float:
        """Median squared residual of the pairs that have moved [variances]; 0 if they are few."""
        settings = self.settings
        pairs = len(self.whiten)
        moved = (self.apply(self.values).reshape(pairs, -1) ** 2).mean(axis=1) > settings.moved
        left = (self.residual(predicted).reshape(pairs, -1) ** 2).mean(axis=1)
        return float(np.median(left[moved])) if moved.sum() >= settings.several else 0.0

    def _each(self, residual: Array) -> Array:
        """For every value the mean squared residual of its pair, shape (V·W,)."""
        each = residual.reshape(len(self.whiten), -1)
        return np.repeat((each**2).mean(axis=1), each.shape[1])

    @property
    def count(self) -> int:
        """Number of independent values."""
        return max(self.whiten.shape[0] * self.whiten.shape[1], 1)


@dataclass(frozen=True, kw_only=True)
class Key:
    """A key frame: its shifts, and the pose in it, shape (4,)."""

    shifts: Shifts
    pose: Array


@dataclass(frozen=True, kw_only=True)
class Explained:
    """A key frame and the prediction of a contact for it; derived values are cached.

    Attributes
    ----------
    shifts: observed shifts
    predicted: predicted shifts of all pairs, shape (P, 6)
    whole: derivatives of the whitened shifts by each unknown, per unit of it, shape (12, V·W)
    """

    shifts: Shifts
    predicted: Array
    whole: Array

    @cached_property
    def loss(self) -> float:
        """See `Shifts.loss`."""
        return self.shifts.loss(self.predicted)

    @cached_property
    def cost(self) -> float:
        """See `Shifts.cost`."""
        return self.shifts.cost(self.predicted)

    @cached_property
    def typical(self) -> float:
        """See `Shifts.typical`."""
        return self.shifts.typical(self.predicted)

    @cached_property
    def normal(self) -> tuple[Array, Array]:
        """Information matrix (12, 12) and gradient (12,) of the unknowns."""
        residual = self.shifts.residual(self.predicted)
        weighted = self.whole * self.shifts.weights(residual)
        return weighted @ self.whole.T, weighted @ residual
