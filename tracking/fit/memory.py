"""State of the tracker between frames (`Memory`), and its judged fit to one frame (`Look`)."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..doubt import Doubt
from .kernels.template_kernels import Pool
from .pair_state import PairFits, PairState
from .templates import copied

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Look(NamedTuple):
    """A fit of M pairs to a frame, with the markers that it explains and that are suspicious."""

    fits: PairFits
    visible: Mask  # (M, 2) markers whose pixels the fit explains
    torn: Mask  # (M, 2) markers that moved otherwise than their neighbours or their other layer
    on_others: Mask  # (M, 2) markers that lie on another one of their layer
    touching: Mask  # (M,) pairs with a marker that touches another one of its layer


@dataclass(frozen=True, kw_only=True)
class Memory:
    """Everything that the tracker keeps from one frame to the next, for M pairs and L layers.

    Attributes
    ----------
    start: state from which the next fit starts, before the velocity is added
    velocity: expected change of the fits until the next frame, shape (M, 2, 5)
    templates: templates of the pairs, changed in place
    visible: markers that were found, shape (M, 2)
    intact: markers that were found and moved like their neighbours, shape (M, 2)
    last_seen: time of the last frame in which each marker was found [s], shape (L, M)
    typical: median misfit under the present light, at least 1
    doubt: markers whose number is not certain
    waited: number of frames since colours and blur were fitted
    patience: number of frames to wait before they are fitted again
    frames: number of frames so far; it determines which lost pairs are tried
    """

    start: PairState
    velocity: Array
    templates: Pool
    visible: Mask
    intact: Mask
    last_seen: Array
    typical: float
    patience: int
    doubt: Doubt
    waited: int = 0
    frames: int = 0

    def copied(self) -> "Memory":
        """Copy, including the templates."""
        return replace(self, templates=copied(self.templates))

    def expected(self) -> PairState:
        """State from which the next fit starts."""
        return replace(self.start, fits=self.start.fits + self.velocity)
