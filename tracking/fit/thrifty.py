"""A tracker that looks at markers that hold still only now and then."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...render import Frame
from ..tracks import Tracks
from .neighbour_kernels import median
from .pair_fit import PairFits, PairState
from .tracker import STEPS, Look, MarkerTracker

Image = NDArray[np.uint8]

#: Pairs that moved less than this in a frame take turns of so many frames [px].
_STILL, _TURNS = 0.05, 4
#: Where those whose turn it is are explained so much worse than before, all are looked at.
_CHANGED = 1.1


class ThriftyTracker(MarkerTracker):
    """Fits as `MarkerTracker` does, but pairs that hold still only every fourth frame.

    What moves, and what lies next to it, is fitted in every frame; what is not fitted stays as it
    was found last: it lags by three frames at most, and its noise stays as long, so that a loop
    which noise shakes is shaken more. Where light changes, or any pair is lost, all are fitted.
    """

    def reset(self, rest: list[Frame]) -> Tracks:
        """Find the markers in frames of the unloaded sensor."""
        tracks = super().reset(rest)
        count = len(self._rest.fits)
        self._turn = 0
        self._covariance, self._misfit = np.full((count, 9, 9), np.nan), np.full(count, np.inf)
        return tracks

    @property
    def state(self) -> dict[str, Any]:
        """Everything that changes from frame to frame."""
        own = {"turn": self._turn, "covariance": self._covariance, "misfit": self._misfit}
        return {**super().state, **own}

    @state.setter
    def state(self, values: dict[str, Any]) -> None:
        own = dict(values)
        self._turn = int(own.pop("turn"))
        self._covariance, self._misfit = own.pop("covariance"), own.pop("misfit")
        MarkerTracker.state.fset(self, own)  # type: ignore[attr-defined]

    def _first_fit(self, image: Image, start: PairState) -> PairFits:
        self._turn = (self._turn + 1) % _TURNS
        there = self._rest.present
        known = np.isfinite(self._misfit[there.any(axis=1)]).all()
        if not (known and self._seen[there].all()):
            return super()._first_fit(image, start)
        moving = abs(self._velocity[..., :2]).max(axis=(1, 2)) > _STILL
        turn = np.arange(len(moving)) % _TURNS == self._turn
        active = self._and_around(moving) | turn
        fits = np.where(active[:, None, None], start.fits, self._next.fits)
        found = self._fit.refit(
            image, replace(start, fits=fits), active, self._covariance, self._misfit, STEPS
        )
        still = turn & ~moving
        if median(found.misfit[still]) > _CHANGED * max(1.0, median(self._misfit[still])):
            return super()._first_fit(image, start)
        # Who moves after all wakes those around it.
        went = abs((found.state.fits - self._next.fits)[..., :2]).max(axis=(1, 2)) > _STILL
        woken = self._and_around(went) & ~active
        if not woken.any():
            return found
        return self._fit.refit(image, found.state, woken, found.covariance, found.misfit, STEPS)

    def _and_around(self, which: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """These pairs and those next to them."""
        return np.asarray(which | which[self._fit.near].any(axis=1))

    def _remember(self, look: Look, steady: bool) -> None:
        super()._remember(look, steady)
        self._covariance, self._misfit = look.fits.covariance, look.fits.misfit


class SparseTracker(ThriftyTracker):
    """The same, from every other row of the image: noisier, in half the time."""

    stride = 2
