"""A fit of an object and its poses to key frames, as a value that is advanced a key at a time.

A camera's frames do not wait for a fit. One advance simulates one key frame, so that a caller can
spread the fit over frames by counting; the result is the same however it is spread.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ....model.dome import PosedContact
from .contact_way import Changes
from .key_shifts import Explained, Shifts

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Slopes:
    """Derivatives at the present object and poses, and the normal equations from them.

    Attributes
    ----------
    explained: prediction for each key frame, with its derivatives
    changes: changes of the contact in the last key frame
    information, gradient: normal equations, see `ContactCost.normal`
    """

    explained: tuple[Explained, ...]
    changes: Changes
    information: Array
    gradient: Array


@dataclass(frozen=True, kw_only=True)
class Fitting:
    """A fit (Levenberg–Marquardt) that is under way.

    Attributes
    ----------
    shifts: observed shifts of the K key frames
    object_, poses: best unknowns so far, shapes (8,) and (K, 4)
    tried: unknowns that are being simulated
    rounds: largest number of rounds
    known: cost that the fit has to beat; it ends early if that is unlikely
    damping: of the next step
    turn: number of rounds so far
    cost: of the best unknowns; infinite before they were simulated
    gain: decrease of the cost by the last round
    contacts: simulated contacts of the best unknowns
    slopes: derivatives at the best unknowns; None before they are known
    reached, seen: contacts and predicted shifts of the tried unknowns, as far as simulated
    told: key frames explained at the best unknowns, as far as derivatives are known
    last: contact and changes in the last of these
    telling: whether derivatives are being made, rather than a prediction
    done: whether the fit has ended
    """

    shifts: tuple[Shifts, ...]
    object_: Array
    poses: Array
    tried: tuple[Array, Array]
    rounds: int
    known: float = math.inf
    damping: float = 1e-3
    turn: int = 0
    cost: float = math.inf
    gain: float = math.inf
    contacts: tuple[PosedContact, ...] = ()
    slopes: Slopes | None = None
    reached: tuple[PosedContact, ...] = ()
    seen: tuple[Array, ...] = ()
    told: tuple[Explained, ...] = ()
    last: tuple[PosedContact, Changes] | None = None
    telling: bool = False
    done: bool = False

    def trying(self, object_: Array, poses: Array) -> "Fitting":
        """Begin to simulate other unknowns, in another round."""
        return replace(
            self,
            tried=(object_, poses),
            turn=self.turn + 1,
            reached=(),
            seen=(),
            telling=False,
        )

    #: Cost of derivatives, in solved contacts.
    derivatives: ClassVar[int] = 3

    @property
    def calls(self) -> int:
        """Cost of the next advance, in solved contacts."""
        return self.derivatives if self.telling else 1
