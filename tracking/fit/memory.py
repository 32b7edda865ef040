"""Memory of the tracker from frame to frame, and its look at one frame."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .kernels.template_kernels import Pool
from .pair_state import PairFits, PairState
from .templates import copied

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Look(NamedTuple):
    """A fit to a frame; the markers that it explains, and which of them are at odd places."""

    fits: PairFits
    visible: Mask  # (M, 2)
    torn: Mask  # (M, 2), those that came off their neighbours, or their other layer
    on_others: Mask  # (M, 2), those that lie on another one of their layer
    touching: Mask  # (M,), pairs with a marker that touches another one of its layer


@dataclass(frozen=True, kw_only=True)
class Memory:
    """All that the tracker remembers from one frame to the next, for M pairs and L layers.

    Attributes
    ----------
    start: state that the next fit starts from, before the velocity is added
    velocity: expected change of the fits until the next frame, shape (M, 2, 5)
    templates: of the pairs, changed in place
    visible: markers that were found, shape (M, 2)
    intact: markers that were found and moved as their neighbours did, shape (M, 2)
    last_seen: time of the last frame in which each marker was found [s], shape (L, M)
    typical: median misfit under today's light, at least 1
    waited: frames since colours and blur were fitted
    patience: frames to wait before they are fitted again
    frames: so far; lost pairs are looked for in turns by it
    """

    start: PairState
    velocity: Array
    templates: Pool
    visible: Mask
    intact: Mask
    last_seen: Array
    typical: float
    patience: int
    waited: int = 0
    frames: int = 0

    def copied(self) -> "Memory":
        """The same memory with templates of its own."""
        return replace(self, templates=copied(self.templates))

    def expected(self) -> PairState:
        """State that the next fit starts from."""
        return replace(self.start, fits=self.start.fits + self.velocity)
