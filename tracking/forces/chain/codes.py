"""Codes of a frame: coefficients of trained shift patterns, fitted to the pairs of one specimen.

Shifts are y = m(ψ) + U(ψ)·a + noise, with the mean m and the patterns U. The codes a, and a common
change of log sizes in each layer, are the mean of their Gaussian posterior given all pairs; a pair
that contradicts the others is left out. The azimuth ψ of the load is the one for which the least
shear across its plane remains. Even patterns are mirror-symmetric to that plane, odd ones are not.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....model import LoadPlane
from ....render import SensorDesign
from ...tracks import Tracks
from ..reconstructors import NoEstimateError
from ..shifts import MEASURED
from .code_kernels import left_over, typical_variance, whitened
from .noise_level import (
    NoiseLevel,
    VagueSizes,
    Weights,
    changed,
    noise_level,
    vague_sizes,
)
from .readout import SIZE_CHANGE
from .settings import CodeSettings
from .specimen import SIZES, Specimen, aligned

Array = NDArray[np.float64]
#: Names of the statistics of a frame's residual after the even codes, and of the odd codes.
CONTEXT = (
    *(
        f"{part} residual of the {layer} {component}"
        for part in ("the smooth", "the rough")
        for layer in ("magenta", "yellow")
        for component in ("places along the load", "places across the load", "sizes")
    ),
    "motion across the load's plane",
)
#: Type of arrays that every frame multiplies: half the memory, and far more precise than the noise.
Short = NDArray[np.float32]
Mask = NDArray[np.bool_]

#: Share of the noise's variance that is added before a logarithm, as a lower bound.
_LEAST = 0.01


@dataclass(frozen=True, kw_only=True)
class Posterior:
    """Covariance (U, U) of the U unknowns from some of P pairs with given weights.

    `excess` is the covariance of the K even codes beyond that in training, shape (K, K).
    """

    weights: Weights
    pairs: Mask
    covariance: Array
    excess: Array


@dataclass(frozen=True, kw_only=True)
class Kept:
    """Values kept for the next frame, as they seldom change and take long to compute."""

    noise: NoiseLevel
    vague: VagueSizes | None = None
    posterior: Posterior | None = None


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Fitted unknowns of a frame.

    Attributes
    ----------
    pairs: mask of the pairs used in the fit, shape (P,)
    unknowns: codes and common changes of log size, shape (U,)
    posterior: their covariance
    missed: whitened residuals of the shifts, shape (P, 6)
    misfit: χ² of each pair, shape (P,)
    """

    pairs: Mask
    unknowns: Array
    posterior: Posterior
    missed: Short
    misfit: Short


@dataclass(frozen=True, kw_only=True)
class Codes:
    """Codes of a frame.

    Attributes
    ----------
    value: K even codes, shape (K,)
    variance: variance of each, as in training, shape (K,)
    constant_variance: part of it from errors that are the same in every frame, shape (K,)
    excess: covariance of the codes beyond that in training, shape (K, K)
    context: C statistics of residual and odd codes, input of the read-out, shape (C,)
    plane: plane of the load
    """

    value: Array
    variance: Array
    constant_variance: Array
    excess: Array
    context: Array
    plane: LoadPlane


def least_pairs(sensor: SensorDesign, settings: CodeSettings) -> int:
    """Smallest number of pairs that must be visible."""
    return max(settings.fewest_pairs, round(settings.least_share * len(sensor.places)))


def fit_codes(
    specimen: Specimen, kept: Kept | None, tracks: Tracks, settings: CodeSettings
) -> tuple[Fit, Kept]:
    """Fit the unknowns of a frame; also return values to keep for the next one.

    Parameters
    ----------
    specimen: specimen whose pairs were tracked
    kept: values kept from the previous frame
    tracks: tracks of the frame

    Raises
    ------
    NoEstimateError
        When too few pairs of the design are visible.
    """
    shifts, certain = specimen.shifts(tracks, least_pairs(specimen.shifts.sensor, settings))
    visible = specimen.shifts.whole(tracks.visible)
    level = typical_variance(tracks.covariance, specimen.shifts.pairs, visible)
    if kept is None or abs(level - kept.noise.level) >= settings.noise_change * kept.noise.level:
        plane = aligned(specimen, 0.0) if kept is None else kept.noise.aligned
        kept = Kept(noise=noise_level(specimen, plane, level, tracks, visible, settings))
    for turns in range(settings.turns):
        fit, after = _fit_aligned(specimen, kept, tracks, shifts, visible, certain, settings)
        turn, deviation = _turn(specimen, fit, after.noise)
        least = max(settings.least_turn, settings.certain_turn * deviation)
        if turns == settings.turns - 1 or abs(turn) < least:
            break
        plane = aligned(specimen, kept.noise.aligned.azimuth + turn)
        kept = Kept(noise=noise_level(specimen, plane, level, tracks, visible, settings))
    return fit, after


def _fit_aligned(
    specimen: Specimen,
    kept: Kept,
    tracks: Tracks,
    shifts: Array,
    visible: Mask,
    certain: Mask,
    settings: CodeSettings,
) -> tuple[Fit, Kept]:
    """Fit the unknowns for the kept azimuth to shifts (P, 6) of the visible pairs (P,)."""
    noise = kept.noise
    vague = vague_sizes(specimen, noise, kept.vague, tracks, visible, settings)
    weights = noise.weights if vague is None else vague.weights
    white = np.empty(shifts.shape, dtype=np.float32)
    whitened(shifts, noise.aligned.mean, visible, SIZE_CHANGE, weights.whiten, white)
    solver = _Solver(
        noise=noise, weights=weights, white=white, before=kept.posterior, settings=settings
    )
    fit = solver.consistent(certain)
    ambiguous = visible & ~certain
    if ambiguous.any():
        fit = solver.consistent(solver.with_likely(fit, ambiguous, settings.likely))
    return fit, Kept(noise=noise, vague=vague or kept.vague, posterior=fit.posterior)


def _shear(specimen: Specimen, fit: Fit) -> tuple[Array, Array]:
    """First harmonic of the shear along and across the load's plane, weighted, each (R,) [px]."""
    codes, direction = specimen.codes, specimen.direction
    along = direction.along @ np.append(fit.unknowns[:codes], 1.0)
    return along, direction.across @ fit.unknowns[codes : -len(SIZES)]


def _turn(specimen: Specimen, fit: Fit, noise: NoiseLevel) -> tuple[float, float]:
    """Angle from the plane to the shear's own azimuth, and its standard deviation [rad]."""
    along, across = _shear(specimen, fit)
    size = float(along @ along + across @ across)
    turn = 0.5 * math.atan2(2.0 * float(along @ across), float(along @ along - across @ across))
    return turn, math.sqrt(noise.across_variance / max(size, 1e-12))


def trained_codes(specimen: Specimen, fit: Fit, noise: NoiseLevel, settings: CodeSettings) -> Codes:
    """Make the codes of a fit.

    Raises
    ------
    NoEstimateError
        When the pairs move unlike in any trained press.
    """
    count = len(noise.variance)
    every = bool(fit.pairs.all())
    measured = specimen.shifts.measured if every else specimen.shifts.measured[fit.pairs]
    misfit = float(fit.misfit @ fit.pairs) / (measured.sum() - len(fit.unknowns))
    if misfit > settings.unlike:
        raise NoEstimateError(
            f"the markers move as no trained press moves them: χ² is {misfit:.0f} a measurement, "
            f"{settings.unlike:g} at most is allowed"
        )
    odd = fit.unknowns[count : -len(SIZES)]
    unit = noise.odd_unit
    missed = fit.missed if every else fit.missed * fit.pairs[:, None]
    residual = _turned(missed, -noise.aligned.azimuth)
    along, across = _shear(specimen, fit)
    return Codes(
        value=fit.unknowns[:count],
        variance=noise.variance,
        constant_variance=noise.constant_variance,
        excess=fit.posterior.excess,
        context=np.append(
            specimen.smooth.statistics(residual, fit.pairs), odd_statistic(odd / unit, axis=0)
        ),
        plane=LoadPlane(
            azimuth=noise.aligned.azimuth,
            out_of_plane=_share(across, along),
            twist=float(specimen.direction.twist @ odd),
        ),
    )


def _turned(residual: Short, angle: float) -> Short:
    """Rotate the positions in a residual (P, 6) by an angle [rad]."""
    if angle == 0.0:
        return residual
    turned, c, s = residual.copy(), math.cos(angle), math.sin(angle)
    for k in (0, 3):
        turned[:, k] = c * residual[:, k] - s * residual[:, k + 1]
        turned[:, k + 1] = s * residual[:, k] + c * residual[:, k + 1]
    return turned


def _share(across: Array, along: Array) -> float:
    """Share of the first vector in the norm of both; 0 if both vanish."""
    whole = float(np.linalg.norm(np.append(along, across)))
    return float(np.linalg.norm(across)) / max(whole, 1e-12)


def odd_statistic(odd: Array, axis: int) -> Array:
    """Logarithm of the mean square of odd codes, over their noise."""
    return np.asarray(np.log((odd**2).mean(axis=axis) + _LEAST))


@dataclass(frozen=True, kw_only=True)
class _Solver:
    """Least squares of one frame.

    Attributes
    ----------
    noise: weights at the noise level of the frame
    weights: weights of the frame's pairs
    white: whitened shifts, 0 where a pair is not visible, shape (P, 6)
    before: posterior of the previous frame, reused if weights and pairs are the same
    settings: tuned parameters
    """

    noise: NoiseLevel
    weights: Weights
    white: Short
    before: Posterior | None
    settings: CodeSettings

    def consistent(self, certain: Mask) -> Fit:
        """Fit to those of the certain pairs that do not contradict the others."""
        settings, pairs, limit = self.settings, certain, self.settings.stray
        while True:
            fit = self.fit(pairs)
            worst = float(fit.misfit[pairs].max())
            if worst > settings.stray or pairs is not certain:
                limit = settings.stray * max(1.0, float(np.median(fit.misfit[pairs])) / MEASURED)
            stray = pairs & (fit.misfit > max(limit, settings.near_worst * worst))
            if not stray.any():
                break
            pairs = pairs & ~stray
        # Use pairs again that only seemed wrong because of another one.
        likely = self.with_likely(fit, certain & ~pairs, limit)
        return fit if np.array_equal(likely, pairs) else self.fit(likely)

    def with_likely(self, fit: Fit, doubtful: Mask, limit: float) -> Mask:
        """Mask of a fit's pairs, and of doubtful ones whose χ² given the fit is below a limit."""
        pairs, shrunk = fit.pairs.copy(), fit.unknowns / self.noise.unshrink
        for pair in np.flatnonzero(doubtful):
            rows = self.weights.rows[MEASURED * pair : MEASURED * (pair + 1)].astype(float)
            missed = self.white[pair] - rows @ shrunk
            spread = np.eye(MEASURED) + rows @ fit.posterior.covariance @ rows.T
            pairs[pair] = missed @ np.linalg.solve(spread, missed) < limit
        return pairs

    def fit(self, pairs: Mask) -> Fit:
        """Fit the unknowns to these pairs."""
        posterior, rows = self._posterior(pairs), self.weights.rows
        white = self.white if pairs.all() else self.white * pairs[:, None]
        moment = white.ravel() @ rows
        unknowns = self.noise.unshrink * (posterior.covariance @ moment)
        explained = (rows @ unknowns.astype(np.float32)).reshape(self.white.shape)
        missed, misfit = np.empty_like(self.white), np.empty(len(pairs), dtype=np.float32)
        left_over(self.white, explained, missed, misfit)
        return Fit(
            pairs=pairs, unknowns=unknowns, posterior=posterior, missed=missed, misfit=misfit
        )

    def _posterior(self, pairs: Mask) -> Posterior:
        """Posterior of the unknowns from these pairs; the previous one if nothing changed."""
        weights, before = self.weights, self.before
        if before is not None and before.weights is weights and np.array_equal(before.pairs, pairs):
            return before
        covariance = weights.covariance
        if not pairs.all():
            # Subtract the information of the lost pairs.
            lost = weights.rows.reshape(len(pairs), MEASURED, -1)[~pairs].astype(float)
            less = np.broadcast_to(-np.eye(MEASURED), (*lost.shape[:2], MEASURED))
            _, covariance = changed(weights, lost, less, self.settings.few)
        return Posterior(
            weights=weights,
            pairs=pairs,
            covariance=covariance,
            excess=self.noise.excess_of(covariance),
        )
