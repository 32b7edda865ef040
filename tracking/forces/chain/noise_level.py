"""Weights of the marker pairs at a frame's noise level: information of their shifts about codes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...tracks import Tracks
from ..shifts import MEASURED
from .code_kernels import find_vague
from .settings import CodeSettings
from .specimen import SIZES, Aligned, Specimen

Array = NDArray[np.float64]
#: Type of arrays that every frame multiplies: half the memory, and far more precise than the noise.
Short = NDArray[np.float32]
Mask = NDArray[np.bool_]

#: Smallest model error of log sizes: light and lens change them by more than a calibration states,
#: and differently where the skin has moved.
_SIZE_FLOOR = 1e-3


@dataclass(frozen=True, kw_only=True)
class Weights:
    """Information of P pairs about U unknowns.

    Attributes
    ----------
    whiten: whitening matrix of each pair's shifts, shape (P, 6, 6)
    rows: derivative of each whitened shift with respect to the unknowns, shape (6P, U)
    information: information matrix of all pairs and the prior, shape (U, U)
    covariance: its inverse, shape (U, U)
    """

    whiten: Short
    rows: Short
    information: Array
    covariance: Array


@dataclass(frozen=True, kw_only=True)
class NoiseLevel:
    """Weights for frames of one noise level, and values derived from them if no pair is missing.

    Attributes
    ----------
    aligned: mean and loadings for the azimuth of the load
    level: median variance of a pair's x [px²]
    sizes: variances of a pair's log sizes in a frame, shape (P, 2)
    constant: covariance of the errors that are the same in every frame, shape (P, 6, 6)
    weights: weights of the pairs
    unshrink: factor on each unknown that undoes the shrinkage by the prior, shape (U,); the
        read-out was trained on unshrunk codes
    variance: variance of each even code, shape (K,)
    constant_variance: part of it from errors that are the same in every frame, shape (K,)
    excess: covariance of the codes beyond that in training, shape (K, K)
    across_variance: variance of the first harmonic of the shear across the load's plane [px²]
    odd_unit: standard deviation of each odd code, shape (O,)
    """

    aligned: Aligned
    level: float
    sizes: Array
    constant: Array
    weights: Weights
    unshrink: Array
    variance: Array
    constant_variance: Array
    excess: Array
    across_variance: float
    odd_unit: Array

    def excess_of(self, covariance: Array) -> Array:
        """Compute `excess` for another covariance (U, U) of the unknowns than by `weights`."""
        if covariance is self.weights.covariance:
            return self.excess
        count = len(self.excess)
        change = (covariance - self.weights.covariance)[:count, :count]
        factor = self.unshrink[:count]
        return np.asarray(self.excess + factor[:, None] * change * factor)


@dataclass(frozen=True, kw_only=True)
class VagueSizes:
    """Weights of a frame in which the log sizes of V pairs have a larger variance than usual.

    Attributes
    ----------
    pairs: mask of these pairs, shape (P,)
    variances: variances of their measurements, shape (V, 6)
    weights: weights of all pairs
    """

    pairs: Mask
    variances: Array
    weights: Weights


def believed(floor: Array) -> Array:
    """Raise the variances of a pair's model errors (6,) of log sizes to their smallest value."""
    least = np.zeros(MEASURED)
    least[SIZES] = _SIZE_FLOOR**2
    return np.maximum(floor, least)


def noise_level(
    specimen: Specimen,
    plane: Aligned,
    level: float,
    tracks: Tracks,
    visible: Mask,
    settings: CodeSettings,
) -> NoiseLevel:
    """Compute weights for frames as noisy as this one, and a load in the given plane."""
    frame = specimen.shifts.covariance(tracks)
    # A pair that is not visible now may be visible in a later frame.
    frame[~visible] = np.median(frame[visible], axis=0)
    frame = specimen.shifts.separated(frame)
    floor = believed(specimen.shifts.floor)
    constant = specimen.shifts.rest_covariance + np.diag(floor)
    constant = constant + specimen.unexplained[:, :, None] * np.eye(MEASURED)
    whiten = np.linalg.inv(np.linalg.cholesky(frame + constant))
    pairs, _, unknowns = plane.loadings.shape
    rows = (whiten @ plane.loadings).reshape(-1, unknowns)
    # The prior keeps unknowns that no visible pair determines near their mean.
    information = rows.T @ rows + np.diag(1.0 / specimen.strength)
    covariance = np.asarray(np.linalg.inv(information))
    # Keep a code near its mean if the visible pairs hardly determine it.
    unshrink = 1.0 / np.maximum(1.0 - np.diag(covariance) / specimen.strength, settings.determined)
    codes = specimen.codes
    unshrink[-len(SIZES) :] = 1.0
    variance = (unshrink * np.diag(covariance))[:codes]
    # If markers were missing at rest, some directions are noisier than any in training.
    typical = float(np.median(variance))
    raised = (unshrink[:, None] * covariance * unshrink)[:codes, :codes]
    spreads, directions = np.linalg.eigh(raised)
    excess = np.where(spreads > settings.noisier * typical, spreads - typical, 0.0)
    odd, across = slice(codes, -len(SIZES)), specimen.direction.across
    operator = (unshrink[:, None] * (covariance @ rows.T))[:codes].reshape(codes, pairs, MEASURED)
    whitened = whiten @ constant @ np.swapaxes(whiten, 1, 2)
    return NoiseLevel(
        aligned=plane,
        level=level,
        sizes=frame[:, SIZES, SIZES],
        constant=constant,
        weights=Weights(
            whiten=whiten.astype(np.float32),
            rows=rows.astype(np.float32),
            information=information,
            covariance=covariance,
        ),
        unshrink=unshrink,
        variance=variance,
        constant_variance=np.einsum("kpi,pij,kpj->k", operator, whitened, operator, optimize=True),
        excess=(directions * excess) @ directions.T,
        across_variance=float(((across @ covariance[odd, odd]) * across).sum()),
        odd_unit=np.sqrt(np.diag(covariance)[odd]),
    )


def vague_sizes(
    specimen: Specimen,
    noise: NoiseLevel,
    before: VagueSizes | None,
    tracks: Tracks,
    visible: Mask,
    settings: CodeSettings,
) -> VagueSizes | None:
    """Weights of a frame in which log sizes of some touching pairs have larger variances."""
    shifts, pairs = specimen.shifts, np.empty_like(visible)
    vaguer = settings.vaguer
    if not find_vague(tracks.covariance, shifts.pairs, visible, noise.sizes, vaguer, pairs):
        return None
    if before is not None and not (pairs & ~before.pairs).any():
        # Pairs at the bound come and go: those that are surer again are weighed as before.
        now = shifts.covariance(tracks, pairs).diagonal(axis1=1, axis2=2)
        then = before.variances[pairs[before.pairs]]
        if (abs(now - then) < settings.noise_change * then).all():
            return before
    covariance = shifts.covariance(tracks, pairs)
    variances = covariance.diagonal(axis1=1, axis2=2)
    weights, loadings = noise.weights, noise.aligned.loadings[pairs]
    own = np.linalg.inv(np.linalg.cholesky(covariance + noise.constant[pairs]))
    usual = weights.whiten[pairs].astype(float)
    unknowns = loadings.shape[2]
    whiten, rows = weights.whiten.copy(), weights.rows.copy()
    whiten[pairs] = own
    rows.reshape(len(pairs), MEASURED, unknowns)[pairs] = own @ loadings
    change = np.swapaxes(own, 1, 2) @ own - np.swapaxes(usual, 1, 2) @ usual
    information, covariance = changed(weights, loadings, change, settings.few)
    vague = Weights(whiten=whiten, rows=rows, information=information, covariance=covariance)
    return VagueSizes(pairs=pairs, variances=variances, weights=vague)


def changed(weights: Weights, rows: Array, change: Array, few: float) -> tuple[Array, Array]:
    """Update information and covariance of all unknowns for changed weights of V pairs.

    Parameters
    ----------
    weights: weights before the change
    rows: derivatives of these pairs' whitened shifts, shape (V, 6, U)
    change: change of their inverse covariance in the units of `rows`, shape (V, 6, 6)
    few: number of measurements over unknowns up to which the covariance is updated

    Returns
    -------
    Both of shape (U, U).
    """
    flat, weighed = (x.reshape(-1, rows.shape[2]) for x in (rows, change @ rows))
    information = weights.information + flat.T @ weighed
    if len(flat) > few * rows.shape[2]:
        return information, np.asarray(np.linalg.inv(information))
    # By the formula of Woodbury.
    gain = weighed @ weights.covariance
    left = np.eye(len(flat)) + gain @ flat.T
    across = weights.covariance @ flat.T
    return information, np.asarray(weights.covariance - across @ np.linalg.solve(left, gain))
