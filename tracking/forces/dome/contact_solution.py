"""Results of fits of contacts: solutions for key frames, and followed contacts."""

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
    """An object and its poses, fitted to key frames.

    Attributes
    ----------
    object_: unknowns of the object, shape (8,)
    keys: key frames with their poses
    explained: prediction for each key frame
    slopes: derivatives of all pairs' shifts in the last key frame by the unknowns, per unit of
        each, shape (12, P, 6)
    contact: contact in the last key frame
    changes: changes of this contact by each unknown
    covariance: covariance of the pose in the last key frame and the object, shape (12, 12)
    cost: minimised cost
    misfit: mean squared residual of the shifts [variances], with reduced weight of outliers
    odd_misfit: see `Shifts.odd_misfit`; median of the key frames [variances]
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
    odd_misfit: float


@dataclass(frozen=True, kw_only=True)
class Followed:
    """A contact that is followed with a fixed object.

    Attributes
    ----------
    contact, pose: contact and pose in the last frame
    seen: predicted shifts of all pairs in it, shape (P, 6)
    slopes: derivatives of the shifts by the pose, per unit, in that or an earlier frame, (4, P, 6)
    """

    contact: PosedContact
    pose: Array
    seen: Array
    slopes: Array


def tells_more(
    held: Solution, units: Array, gain: float, step: Array, settings: ContactFitSettings
) -> bool:
    """Whether a step of the last pose and the object would change the estimate in the last frame.

    Parameters
    ----------
    units: units of the unknowns, shape (12,)
    gain: expected gain of the step in all key frames [squared standard deviations]
    step: step in units, last pose first, shape (12,)
    """
    sums, mu = sums_of(held.changes.contact), math.exp(held.object_[FRICTION])
    slopes = np.zeros((3, MOVING + len(OBJECT)))  # derivatives of ln ΣFn, ln µ and Γ
    normal, across = (sums_of(held.changes.changed) - sums).T / max(float(sums[0]), 1e-12)
    slopes[0], slopes[1, MOVING + FRICTION] = normal / units, 1.0
    share = float(sums[1]) / max(mu * float(sums[0]), 1e-12)
    slopes[2] = share * (slopes[0] + slopes[1]) - across / (mu * units)
    known = np.sqrt(np.diag(slopes @ held.covariance @ slopes.T))
    much = abs(slopes @ step) > np.maximum(settings.unsure_share * known, settings.small_change)
    return bool(much.any()) or gain > settings.telling_gain * held.misfit * len(held.keys)
