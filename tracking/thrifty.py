"""A tracker that looks at markers far from the contact only now and then."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..render import Frame
from .pair_fit import PairFits, PairState
from .tracker import _STEPS, Look, MarkerTracker
from .tracks import Tracks

Image = NDArray[np.uint8]

#: Pairs that lie within this of where they lay at rest take turns of so many frames [px].
_STILL, _TURNS = 0.25, 4
#: Where those whose turn it is are explained so much worse than before, all are looked at.
_CHANGED = 1.1


class ThriftyTracker(MarkerTracker):
    """Fits as `MarkerTracker` does, but pairs that lie still at rest only every fourth frame.

    What moved, and what lies next to it, is fitted in every frame; what is not fitted stays as it
    was found last. Where light changes, or any pair is lost, all are fitted.
    """

    def reset(self, rest: list[Frame]) -> Tracks:
        """Find the markers in frames of the unloaded sensor."""
        self._last: PairFits | None = None
        self._turn = 0
        return super().reset(rest)

    @property
    def state(self) -> dict[str, Any]:
        """Everything that changes from frame to frame; after it is set, the next frame is whole."""
        return {**super().state, "turn": self._turn}

    @state.setter
    def state(self, values: dict[str, Any]) -> None:
        own = dict(values)
        self._turn, self._last = int(own.pop("turn")), None
        MarkerTracker.state.fset(self, own)  # type: ignore[attr-defined]

    def _first_fit(self, image: Image, start: PairState) -> PairFits:
        self._turn = (self._turn + 1) % _TURNS
        before = self._last
        if before is None or not self._seen[self._rest.present].all():
            return super()._first_fit(image, start)
        moved = abs((start.fits - self._rest.fits)[..., :2]).max(axis=(1, 2)) > _STILL
        turn = np.arange(len(moved)) % _TURNS == self._turn
        active = moved | moved[self._fit.near].any(axis=1) | turn
        found = self._fit.refit(image, start, before, active, _STEPS)
        still = turn & ~moved
        if np.median(found.misfit[still]) > _CHANGED * max(1.0, np.median(before.misfit[still])):
            return super()._first_fit(image, start)
        return found

    def _remember(self, look: Look, steady: bool) -> None:
        super()._remember(look, steady)
        self._last = look.fits


class SparseTracker(ThriftyTracker):
    """The same, from every other row of the image: noisier, in half the time."""

    stride = 2
