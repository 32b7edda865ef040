"""Whitened shifts of the markers in a frame, and their comparison with a contact."""

import math
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

    @cached_property
    def seen(self) -> Array:
        """Whitened shifts that were observed, shape (V·W,)."""
        return self.apply(self.values)

    @cached_property
    def moved(self) -> NDArray[np.bool_]:
        """Pairs that have moved, shape (V,)."""
        return self._each(self.seen) > self.settings.moved

    def residual(self, predicted: Array) -> Array:
        """Whitened residual against predicted shifts (…, P, 6), shape (…, V·W)."""
        return self.seen - self.apply(predicted[..., self.used, :])

    def weights(self, residual: Array) -> Array:
        """Weight of every value; pairs with large residuals have less weight (Cauchy)."""
        weights = 1.0 / (1.0 + self._each(residual) / self.settings.odd**2)
        return np.repeat(weights, self.whiten.shape[1])

    def loss(self, residual: Array) -> float:
        """Loss that a fit minimises, with little influence of outliers (Cauchy)."""
        odd, width = self.settings.odd, self.whiten.shape[1]
        return float(width * odd**2 * np.log1p(self._each(residual) / odd**2).sum())

    def cost(self, residual: Array) -> float:
        """Sum of squared residuals, linear for outliers (Huber)."""
        off, size = self.settings.off, np.sqrt(self._each(residual))
        share = np.minimum(1.0, off / np.maximum(size, off))
        return float(self.whiten.shape[1] * (share * (2.0 - share) * size**2).sum())

    def odd_misfit(self, residual: Array) -> float:
        """Squared residual that most pairs that have moved stay below, above that of noise.

        Noise is what the half of the pairs that moves less has; in variances. NaN: too few moved.
        """
        settings, moved = self.settings, self.moved
        if moved.sum() < settings.several:
            return math.nan
        each, motion = self._each(residual), self._each(self.seen)
        noise = settings.over_median * np.median(each[motion <= np.median(motion)])
        return float(np.percentile(each[moved], settings.odd_percent) - noise)

    def _each(self, residual: Array) -> Array:
        """Mean squared residual of each pair, shape (V,)."""
        each = residual.reshape(len(self.whiten), -1)
        return np.einsum("vw,vw->v", each, each) / self.whiten.shape[1]

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
    def residual(self) -> Array:
        """See `Shifts.residual`."""
        return self.shifts.residual(self.predicted)

    @cached_property
    def loss(self) -> float:
        """See `Shifts.loss`."""
        return self.shifts.loss(self.residual)

    @cached_property
    def cost(self) -> float:
        """See `Shifts.cost`."""
        return self.shifts.cost(self.residual)

    @cached_property
    def odd_misfit(self) -> float:
        """See `Shifts.odd_misfit`."""
        return self.shifts.odd_misfit(self.residual)

    @cached_property
    def normal(self) -> tuple[Array, Array]:
        """Information matrix (12, 12) and gradient (12,) of the unknowns."""
        weighted = self.whole * self.shifts.weights(self.residual)
        return weighted @ self.whole.T, weighted @ self.residual
