"""Values of the pair fit: the state of the pairs, and a fit with its misfit and covariance."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .kernels.neighbour_kernels import median

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PairState:
    """State of M pairs and of the light on them.

    Attributes
    ----------
    fits: parameters (x, y, e, p, q) of both layers' markers, see `pair_kernels`, shape (M, 2, 5)
    present: whether each layer has a marker, shape (M, 2)
    gains: light of each channel over that at rest, shape (M, 3)
    slopes: change of the light across each pair, see `pixel_kernels`, shape (M, 5)
    absorbed: a₀, a₁ and b (rows) of each channel, see `fit`, shape (3, 3)
    width: standard deviation of an edge [px]
    black: black level of each channel, which means no light
    """

    fits: Array
    present: NDArray[np.bool_]
    gains: Array
    slopes: Array
    absorbed: NDArray[np.float32]
    width: float
    black: tuple[float, ...]

    def copied(self) -> "PairState":
        """Copy whose arrays a fit may change in place."""
        return replace(
            self,
            fits=self.fits.copy(),
            present=self.present.copy(),
            gains=self.gains.copy(),
            slopes=self.slopes.copy(),
        )

    def unsloped(self) -> "PairState":
        """Copy with even light on each pair."""
        return replace(self, slopes=np.zeros_like(self.slopes))


@dataclass(frozen=True)
class PairFits:
    """Result of a fit: the state, its misfit to the image, and its covariance.

    Attributes
    ----------
    state: state after the fit
    misfit: mean squared residual over noise variance, shape (M,); infinite where no fit was found
    covariance: covariance of (x, y, e) of both layers and the logarithms of the gains, (M, 9, 9)
    """

    state: PairState
    misfit: Array
    covariance: Array

    @cached_property
    def typical(self) -> float:
        """Median misfit."""
        return float(median(self.misfit))

    @property
    def score(self) -> float:
        """Median misfit; a pair without a fit counts as 1e9."""
        return float(median(np.minimum(self.misfit, 1e9)))


def chosen(which: NDArray[np.bool_], first: PairState, second: PairState) -> PairState:
    """Combine two states: pairs in `which`, shape (M,), from the first, others from the second."""
    row = which[:, None]
    return replace(
        second,
        fits=np.where(row[..., None], first.fits, second.fits),
        present=np.where(row, first.present, second.present),
        gains=np.where(row, first.gains, second.gains),
        slopes=np.where(row, first.slopes, second.slopes),
    )
