"""Fit of colours and blur to all pairs together, when the misfit of the pairs has grown.

Light over the ground's is 1 − a₀·C₀ − a₁·C₁ + b·C₀₁, with the coverages C, the share a that a dye
absorbs, and the correction b where both dyes lie. For known positions it is linear in a and b.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .kernels.light_kernels import light_sums
from .pair_fit import PairFit
from .pair_state import PairFits, PairState
from .settings import TuningSettings

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Signs of a₀, a₁ and b in the light over the ground's.
_SIGNS = np.array([-1.0, -1.0, 1.0])


def tune(
    fit: PairFit,
    image: Image,
    before: PairFits,
    shapes: Array,
    steps: int,
    settings: TuningSettings,
) -> PairFits:
    """Fit with the best colours, blur and black level; return `before` if nothing is better.

    Parameters
    ----------
    fit: fit of the sensor's pairs
    image, before: image and a fit to it, which may have a large misfit
    shapes: parameters (M, 2, 5) whose sizes and strains are kept until the colours are known;
        otherwise they would compensate wrong colours
    steps: largest number of steps of each fit
    settings: tuned parameters
    """
    places = fit.with_effort(2, fit.rows, fit.arrived)
    fits = np.concatenate([before.state.fits[..., :2], shapes[..., 2:]], axis=-1)
    start = replace(before.state, fits=fits)
    start = replace(start, black=_black(fit, image, start, settings))

    def tuned(width: float) -> PairFits:
        state = replace(start, width=width)
        for _ in range(settings.rounds):
            state = places.fit(image, _with_colours(fit, image, state, settings), steps).state
        return fit.fit(image, _with_colours(fit, image, state, settings), steps)

    best = min(before, tuned(before.state.width), key=lambda fits: fits.score)
    for factor in (settings.wider, 1.0 / settings.wider):
        while 1.0 < settings.widest * fit.optics.width / best.state.width < settings.widest**2:
            tried = tuned(factor * best.state.width)
            if not tried.score < best.score:
                break
            best = tried
    return best


def sharpened(
    fit: PairFit, image: Image, before: PairFits, steps: int, settings: TuningSettings
) -> PairFits:
    """Fit the blur alone, closely, from a fit with the right colours."""
    best, factor = before, settings.closer
    for _ in range(settings.closer_turns):
        width = best.state.width
        for tried in (width * factor, width / factor):
            found = fit.fit(image, replace(best.state, width=tried), steps)
            if found.score < best.score:
                best = found
                break
        else:
            factor = np.sqrt(factor)
    return best


def faded(fit: PairFit, state: PairState, settings: TuningSettings) -> bool:
    """Whether a dye of a state has lost too much contrast for a meaningful fit."""
    now = np.linalg.norm(state.absorbed[:2], axis=1)
    return bool((now < settings.faded * np.linalg.norm(fit.nominal[:2], axis=1)).any())


def _with_colours(
    fit: PairFit, image: Image, state: PairState, settings: TuningSettings
) -> PairState:
    """State with the colours that fit the image best at the state's markers, and matching gains."""
    pairs, sums = _light_sums(fit, image, state)
    absorbed, gain, _ = _fit_colours(sums, fit.nominal, settings)
    gains = state.gains.copy()
    gains[pairs] *= gain
    # C order, as in `prepare_fit`: another order would compile every kernel again.
    return replace(state, absorbed=absorbed.astype(np.float32, order="C"), gains=gains)


def _black(
    fit: PairFit, image: Image, state: PairState, settings: TuningSettings
) -> tuple[float, ...]:
    """Black level of each channel for which the colours fit best."""
    doubts = []
    for level in settings.blacks:
        _, sums = _light_sums(fit, image, replace(state, black=(level,) * 3))
        doubts.append(_fit_colours(sums, fit.nominal, settings)[2])
    return tuple(settings.blacks[best] for best in np.argmin(doubts, axis=0))


def _light_sums(fit: PairFit, image: Image, state: PairState) -> tuple[NDArray[np.intp], Array]:
    """Indices of the n pairs that show colours, and their `light_sums`, shape (n, 3, 5, 5)."""
    sums = np.zeros((len(state.fits), 3, 5, 5))
    light_sums(
        image, fit.optics_of(state), state.present, fit.rows, state.fits, state.gains,
        state.slopes, sums, fit.buffer,
    )  # fmt: skip
    pairs = np.flatnonzero((sums[:, :, 0, 0] > 0.0).all(axis=1))
    return pairs, sums[pairs]


def _fit_colours(sums: Array, known: Array, settings: TuningSettings) -> tuple[Array, Array, Array]:
    """Fit colours to all pairs, with the known ones as a prior and separate gains for each pair.

    Parameters
    ----------
    sums: result of `light_sums` for n pairs, shape (n, 3, 5, 5)
    known: prior a₀, a₁ and b (rows) of each channel, shape (3, 3)
    settings: tuned parameters

    Returns
    -------
    absorbed: fitted a₀, a₁ and b, shape (3, 3)
    gain: gain of each pair and channel, shape (n, 3)
    doubt: cost of each channel: weighted squared residuals plus distance from the prior, (3,)
    """
    model, product = _explained(sums, known)
    gain = product / model
    left = sums[:, :, 4, 4] - product**2 / model
    most = settings.odd * np.median(left, axis=0) if len(left) else np.zeros(3)
    # In a picture of one colour residuals are 0, and the weight stays 1. Where most pairs of a
    # channel have none, the others still count a little, or a mean would be undefined.
    weight = np.divide(most, left, out=np.ones_like(left), where=left > most)
    weight = np.maximum(weight, 1e-6)
    sums = sums * weight[..., None, None]
    # Only deviations from the mean over the pair depend on the colours.
    mean = sums[:, :, 0, 1:4] / sums[:, :, :1, 0]
    inner = sums[:, :, 1:4, 1:4] - sums[:, :, :1, 1:4] * mean[..., None]
    pull = sums[:, :, 1:4, 4] - mean * sums[:, :, :1, 4]
    variance = settings.palette_error**2
    weight = settings.own_errors * gain  # a channel without light has no gain, and no weight
    matrix = np.einsum("nc,ncij->cij", weight * gain, inner) + np.eye(3) / variance
    right = np.einsum("nc,nci->ci", weight, pull) + (_SIGNS[:, None] * known).T / variance
    absorbed = _SIGNS[:, None] * np.linalg.solve(matrix, right[..., None])[..., 0].T
    model, product = _explained(sums, absorbed)
    residual = (sums[:, :, 4, 4] - product**2 / model).sum(axis=0)
    doubt = settings.own_errors * residual + ((absorbed - known) ** 2).sum(axis=0) / variance
    return absorbed, product / model, doubt


def _explained(sums: Array, absorbed: Array) -> tuple[Array, Array]:
    """Sums of model squared, and of model times observed light, for each pair and channel."""
    tone = np.concatenate([np.ones((1, 3)), _SIGNS[:, None] * absorbed])
    model = np.einsum("ac,ncab,bc->nc", tone, sums[..., :4, :4], tone)
    return model, np.einsum("ac,nca->nc", tone, sums[..., :4, 4])
