"""Doubt in the numbers of a field of markers that may have jumped, to where its neighbours were.

After a jump by most of a pitch each marker lies next to the place of another one, and is taken for
it. What tells is the margin: a row is lost, and a row of spots beyond the other end has no number.
So whenever several markers are lost or found again, all numbers are tried moved on by a neighbour.
If more of the spots are explained then, no number is certain, until the own ones explain more.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Number of neighbours by which the numbers are moved on.
_AROUND = 8
#: Largest distance of a spot from its marker [pitches].
_REACH = 0.25


@dataclass(frozen=True)
class Doubt:
    """What is doubted, from frame to frame.

    Attributes
    ----------
    mask: markers whose number is not certain, shape (L, M)
    lost: markers that were lost when this was last judged, shape (L, M)
    """

    mask: Mask
    lost: Mask

    @classmethod
    def of_rest(cls, visible: Mask) -> "Doubt":
        """No doubt at rest, where these markers (L, M) are visible."""
        return cls(mask=np.zeros_like(visible), lost=~visible)


def doubted(
    before: Doubt,
    rest: Array,
    at: Array,
    lost: Mask,
    few: int,
    pitch: float,
    spots: Callable[[], list[Array]],
    hidden: Callable[[Array], Mask],
) -> Doubt:
    """Judge the numbers of a frame, if more than a few markers were lost or found again.

    Parameters
    ----------
    before: doubt before
    rest, at: places at rest and now, assumed ones for lost markers [px], shape (L, M, 2)
    lost: markers that are not found, shape (L, M)
    few: number of markers whose loss is no sign of a jump
    pitch: typical distance to the nearest other marker [px]
    spots: finds the places of each layer's spots in this frame, L arrays (n, 2)
    hidden: tells which places (L, M, 2) lie out of sight
    """
    if np.count_nonzero(lost != before.lost) <= few:
        return before
    trees = [scipy.spatial.KDTree(own) if len(own) else None for own in spots()]

    def explained(places: Array) -> float:
        """Number of spots with a marker; a marker out of sight counts half."""
        total, out = 0.0, hidden(places)
        for tree, own, gone in zip(trees, places, out, strict=True):
            there = np.isfinite(own[:, 0])
            near = np.zeros(len(own), dtype=np.bool_)
            if tree is not None and there.any():
                apart, spot = tree.query(own[there], distance_upper_bound=_REACH * pitch)
                near[there] = np.isfinite(apart)
                total += len(np.unique(spot[np.isfinite(apart)]))
            total += 0.5 * np.count_nonzero(there & gone & ~near)
        return total

    moved = np.nanmedian(at - rest, axis=1, keepdims=True)
    steps = _steps(at[0])
    others = [at + step for step in steps]
    others += [rest + moved + step for step in (*steps, np.zeros(2))]
    own, other = explained(at), max(map(explained, others))
    mask = before.mask
    if other > own:
        mask = np.isfinite(rest[..., 0])
    elif own > other + few:
        mask = np.zeros_like(mask)
    return Doubt(mask=mask, lost=lost)


def _steps(at: Array) -> Array:
    """Ways (K, 2) from the marker in the middle of places (M, 2) to its neighbours [px]."""
    known = at[np.isfinite(at[:, 0])]
    away = np.linalg.norm(known - np.median(known, axis=0), axis=1)
    ways = known - known[np.argmin(away)]
    return ways[np.argsort(np.linalg.norm(ways, axis=1))[1 : _AROUND + 1]]
