"""Codes and context of training snapshots, read off their shifts as `tracking` reads a frame's."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ..tracking.forces import MEASURED
from ..tracking.forces.chain import (
    SIZES,
    Smooth,
    at_places,
    limited,
    odd_statistic,
    smooth_functions,
    with_focus,
    with_focus_variances,
)
from .networks import NOISE, USUAL_NOISE, Basis
from .variations import log_uniform

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Learner:
    """Least squares of the codes for pairs at some places, with the design's noise.

    Attributes
    ----------
    basis: of the codes
    mean: of the shifts, shape (P, 6)
    rows: of the shifts over their noise, by each unknown, shape (6P, U), single precision
    strength: prior variance of each unknown, shape (U,)
    smooth: functions of the residual's statistics
    """

    #: Share of the snapshots that have the usual noise.
    usual_share = 0.75
    #: Share of the snapshots in which pairs are lost.
    losing_share = 0.3

    basis: Basis
    mean: Array
    rows: NDArray[np.float32]
    strength: Array
    smooth: Smooth

    @classmethod
    def of(cls, basis: Basis, places: Array) -> Self:
        """For pairs of the design at places (P, 2), turned by any angle."""
        both = np.stack([places] * 2)
        loadings = with_focus(at_places(basis.fields, basis.odd, both).at(0.0))
        white = loadings / basis.noise[..., None]
        mean = at_places(basis.mean[None], np.array([False]), both).at(0.0)[..., 0]
        return cls(
            basis=basis,
            mean=mean,
            rows=white.reshape(-1, white.shape[2]).astype(np.float32),
            strength=with_focus_variances(basis.strength),
            smooth=smooth_functions(places),
        )

    def read(self, rng: np.random.Generator, shifts: Array) -> tuple[Array, Array, Array]:
        """Even codes (S, K), level of noise (S,) and context (S, C) of shifts (S, P, 6)."""
        count, pairs = shifts.shape[:2]
        basis, codes = self.basis, len(self.basis.amounts) - 1
        white = ((limited(shifts) - self.mean) / basis.noise).reshape(count, -1).astype(np.float32)
        usual = rng.random(count) < self.usual_share
        levels = [log_uniform(rng, limits, count) for limits in (USUAL_NOISE, NOISE)]
        level = np.where(usual, *levels)
        noise = self._noise(rng, level, shifts.shape)
        used = np.ones((count, pairs), dtype=bool)
        information = (self.rows.T @ self.rows).astype(float)
        covariance = np.linalg.inv(information + np.diag(1.0 / self.strength))
        unshrink = 1.0 / (1.0 - np.diag(covariance) / self.strength)
        unshrink[-len(SIZES) :] = 1.0
        operator = (covariance * unshrink).astype(np.float32)
        clean = (white @ self.rows) @ operator
        for k in np.flatnonzero(rng.random(count) < self.losing_share):
            used[k] = ~_lost(rng, shifts[k])
            kept = self.rows[np.repeat(used[k], MEASURED)]
            within = (kept.T @ kept).astype(float) + np.diag(1.0 / self.strength)
            moment = kept.T @ white[k, np.repeat(used[k], MEASURED)]
            clean[k] = np.linalg.solve(within, moment) * unshrink
        # Of the noise the codes take up what is in their rows; the rest stays in the residual.
        taken = (noise.reshape(count, -1) @ self.rows) @ operator
        unknowns = clean + taken
        residual = white + noise.reshape(count, -1) - unknowns @ self.rows.T
        residual = residual.reshape(shifts.shape) * used[..., None] / level[:, None, None]
        odd = unknowns[:, codes:-2] / level[:, None]
        context = np.column_stack(
            [self.smooth.statistics(residual, used), odd_statistic(odd, axis=1)]
        )
        return clean[:, :codes], level, context

    def _noise(self, rng: np.random.Generator, level: Array, shape: tuple[int, ...]) -> Array:
        """Errors of the shifts over the design's noise: a frame's, and some of the floor."""
        frame = (self.basis.frame / self.basis.noise) ** 2
        floor = 1.0 - frame
        square = level[:, None, None] ** 2
        of_frame = np.maximum(square - floor, 0.0)
        present = rng.random((len(level), 1, 1)) ** 2 * np.minimum(floor, square)
        deviation = np.sqrt(of_frame + present).astype(np.float32)
        return np.asarray(deviation * rng.standard_normal(shape, dtype=np.float32))


def _lost(rng: np.random.Generator, shifts: Array) -> NDArray[np.bool_]:
    """A few pairs side by side of shifts (P, 6), likely ones that the press moves far, or hides."""
    moved = np.linalg.norm(shifts[:, :2], axis=1) + 1e-6
    middle = rng.choice(len(moved), p=moved / moved.sum())
    difference = np.linalg.norm(shifts[:, [0, 1, 3, 4]] - shifts[middle, [0, 1, 3, 4]], axis=1)
    lost = np.zeros(len(moved), dtype=bool)
    most = 8  # largest number of pairs that are lost at once
    lost[np.argsort(difference)[: rng.integers(1, most + 1)]] = True
    return lost
