"""Results of fits of contacts: solutions of key frames, and contacts that are followed."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....model.dome import PosedContact
from .contact_state import FRICTION, MOVING, OBJECT
from .contact_way import Changes, sums_of
from .key_shifts import Explained, Key
from .settings import ContactFitSettings

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Solution:
    """An object and its poses, that explain key frames.

    Attributes
    ----------
    object_: unknowns of the object, shape (8,)
    keys: with their poses
    explained: what the contact shows of each
    slopes: of the shifts in the last of them by the unknowns over their units, shape (12, P, 6)
    contact: in the last of them
    changes: of it by each unknown
    covariance: of the pose in the last key frame and the object, shape (12, 12)
    cost: what a fit makes least
    misfit: mean square of what is left of the shifts, in deviations, odd pairs held down
    typical: median over pairs that have moved of what is left of their shifts, squared
    """

    object_: Array
    keys: tuple[Key, ...]
    explained: tuple[Explained, ...]
    slopes: Array
    contact: PosedContact
    changes: Changes
    covariance: Array
    cost: float
    misfit: float
    typical: float


@dataclass(frozen=True, kw_only=True)
class Followed:
    """A contact that is followed with its object held.

    Attributes
    ----------
    contact, pose: in the last frame
    seen: shifts of all pairs in it, shape (P, 6)
    slopes: of the shifts by the pose over its units, in that frame or a frame before, (4, P, 6)
    """

    contact: PosedContact
    pose: Array
    seen: Array
    slopes: Array


def tells_more(
    held: Solution, units: Array, gain: float, step: Array, settings: ContactFitSettings
) -> bool:
    """Whether a step of the last pose and the object changes the estimate in the last frame.

    Parameters
    ----------
    units: of the unknowns, shape (12,)
    gain: of that step in all key frames, in squared deviations
    """
    sums, mu = sums_of(held.changes.contact), math.exp(held.object_[FRICTION])
    slopes = np.zeros((3, MOVING + len(OBJECT)))  # of ln ΣFn, ln µ and Γ
    normal, across = (sums_of(held.changes.changed) - sums).T / max(float(sums[0]), 1e-12)
    slopes[0], slopes[1, MOVING + FRICTION] = normal / units, 1.0
    share = float(sums[1]) / max(mu * float(sums[0]), 1e-12)
    slopes[2] = share * (slopes[0] + slopes[1]) - across / (mu * units)
    known = np.sqrt(np.diag(slopes @ held.covariance @ slopes.T))
    much = abs(slopes @ step) > np.maximum(settings.unsure_share * known, settings.small_change)
    return bool(much.any()) or gain > settings.telling_gain * held.misfit * len(held.keys)
