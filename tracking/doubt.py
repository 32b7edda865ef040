"""Doubt in the numbers of a field of markers that may have jumped, to where its neighbours were.

After a jump by most of a pitch each marker lies next to the place of another one, and is taken for
it. What tells is the margin: a row is lost, and a row of spots beyond the other end has no number.
So whenever several markers are lost or found again, all numbers are tried moved on by a neighbour.
If more of the spots are explained then, no number is certain, until the own ones explain more.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from .detection import neighbours
from .edge import Edge

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Step of the whole field in a frame above which it may have been the other way [pitches].
_LEAP = 0.25
#: Number of neighbours by which the numbers are moved on.
_AROUND = 8
#: Largest distance of a spot from its marker [pitches].
_REACH = 0.25
#: Difference between the steps of neighbours above which the field is torn [pitches].
_TORN = 0.4
#: Share of the markers that may be torn off the others; if it is more, no number is certain.
_MOST_TORN = 0.3
#: Share of the markers that may be missing where no number is doubted any more.
_FEW_MISSING = 0.1


@dataclass(frozen=True)
class Doubt:
    """What is doubted, from frame to frame.

    Attributes
    ----------
    mask: markers whose number is not certain, shape (L, M)
    lost: markers that were lost when this was last judged, shape (L, M)
    margin: markers at the margin of the field, some of which any jump loses, shape (M,)
    """

    mask: Mask
    lost: Mask
    margin: Mask

    @classmethod
    def of_rest(cls, places: Array, visible: Mask) -> "Doubt":
        """No doubt at rest, with places (L, M, 2) [px] of which some are visible, shape (L, M)."""
        middle = np.nanmean(places, axis=0)
        ways = middle[neighbours(middle, _AROUND)] - middle[:, None]
        aside = np.linalg.norm(ways.sum(axis=1), axis=1) / _AROUND
        margin = aside > 0.5 * np.linalg.norm(ways, axis=2).min(axis=1, initial=np.inf)
        return cls(mask=np.zeros_like(visible), lost=~visible, margin=margin)

    def stands(self, lost: Mask, far: Mask, few: int, leap: float) -> bool:
        """Whether there is no reason to judge again: most of the margin is lost or found as before.

        Parameters
        ----------
        lost: markers that are lost now, shape (L, M)
        far: markers that moved far, or otherwise than those around them
        few: number of markers whose loss is no reason
        leap: mean step of the field since the last frame [pitches]
        """
        if leap > _LEAP and not self.mask.all():
            return False
        if np.count_nonzero((lost != self.lost) & self.margin) > few:
            return False
        if self.mask.all():
            return bool(lost.sum() >= self.lost.sum() - few)
        return not far.any()


def doubted(
    before: Doubt,
    places: tuple[Array, Array, Array],
    lost: Mask,
    pitch: float,
    near: NDArray[np.int64],
    spots: list[Array],
    edge: Edge,
) -> Doubt:
    """Judge the numbers of a frame in which markers were lost or found again, or moved far.

    Parameters
    ----------
    before: doubt before
    places: at rest, in the last frame and now, assumed ones for lost markers; NaN where a layer has
        none [px], shape (L, M, 2)
    lost: markers that are not found, shape (L, M)
    pitch: typical distance to the nearest other marker [px]
    near: indices of K neighbours of each marker, shape (M, K)
    spots: places of each layer's spots in this frame [px], L arrays (n, 2)
    edge: edge of the field, for markers at these places at rest
    """
    rest, last, now = places
    present = np.isfinite(rest[..., 0])
    seen = present & ~lost
    moved = now - rest
    moved[~np.isfinite(rest).any(axis=(1, 2))] = 0.0  # a layer without markers
    whole = rest + np.nanmedian(moved, axis=1, keepdims=True)
    moved_on = (at + step for step in _steps(now[0]) for at in (now, whole))
    tried = np.stack([now, whole, *moved_on])
    out = np.stack([edge.hidden(at) for at in tried])
    explained, left, missing = _explained(tried, out, rest, spots, _REACH * pitch, edge)
    other = explained[2:].max(initial=0.0)
    # In a field that fills the picture the edge hides what would tell.
    alike = left[2:].min(initial=np.inf) <= left[0]
    leap = mean_step(now[0, present[0]], last[0, present[0]], pitch)
    torn = _torn(now - last, seen, near, _TORN * pitch)
    count, most = present.sum(), sum(map(len, spots))
    mask = before.mask
    if explained[1] > explained[0]:
        torn |= seen & (np.linalg.norm(now - whole, axis=2) > 0.5 * pitch)
    if most < 0.5 * count:
        pass  # a frame that shows too little
    elif (
        other > explained[0]
        or (alike and leap > _LEAP)
        or torn.sum() > _MOST_TORN * seen.sum()
        or (missing > _MOST_TORN * count and most > (1.0 - _MOST_TORN) * count)
    ):
        mask = np.ones_like(mask)
    elif not mask.all():
        mask = seen & (mask | torn)
        # Where a lost marker is found again depends on those around it.
        mask |= ~seen & mask[:, near].any(axis=2)
    elif explained[0] > other and missing <= _FEW_MISSING * count:
        mask = torn
    return replace(before, mask=mask, lost=lost)


def mean_step(now: Array, last: Array, pitch: float) -> float:
    """Length of the mean step from the last places (M, 2) to those of now [pitches]."""
    x, y = (now - last).mean(axis=0)
    return math.hypot(x, y) / pitch


def _explained(
    tried: Array, out: Mask, rest: Array, spots: list[Array], reach: float, edge: Edge
) -> tuple[Array, Array, int]:
    """Number of spots that have a marker in T tries, one out of sight counts half, shape (T,).

    Also number of markers in sight without a spot, and of spots without a marker that did not come
    in over the edge, (T,), and number of markers in sight without a spot in the first try.

    Parameters
    ----------
    tried: places of the markers in each try [px], shape (T, L, M, 2)
    out: which of them are out of sight, shape (T, L, M)
    rest: places at rest [px], NaN where a layer has none, shape (L, M, 2)
    spots: places of each layer's spots [px], L arrays (n, 2)
    reach: largest distance of a spot from its marker [px]
    edge: edge of the field
    """
    explained, left, missing = np.zeros((2, len(tried))), np.zeros(len(tried)), 0
    for layer, (own, at_rest) in enumerate(zip(spots, rest, strict=True)):
        there = np.isfinite(at_rest[:, 0])
        if not there.any():
            continue
        off = np.ones((len(tried), there.sum()), dtype=np.bool_)
        if len(own):
            query = scipy.spatial.KDTree(own).query
            apart, spot = query(tried[:, layer, there], distance_upper_bound=reach)
            off = ~np.isfinite(apart)
            taken = np.zeros((len(tried), len(own) + 1), dtype=np.bool_)
            np.put_along_axis(taken, np.asarray(spot), values=True, axis=1)
            explained[0] += taken[:, :-1].sum(axis=1)
            shift = (tried[:, layer, there] - at_rest[there]).mean(axis=1)
            left += (~taken[:, :-1] & ~edge.outside(own - shift[:, None])).sum(axis=1)
        explained[1] += 0.5 * (off & out[:, layer, there]).sum(axis=1)
        in_sight = (off & ~out[:, layer, there]).sum(axis=1)
        left += in_sight
        missing += int(in_sight[0])
    return explained.sum(axis=0), left, missing


def _torn(step: Array, seen: Mask, near: NDArray[np.int64], limit: float) -> Mask:
    """Mask (L, M) of seen markers that went on otherwise than the largest group beside them."""
    torn = np.zeros_like(seen)
    for own, there, result in zip(step, seen, torn, strict=True):
        linked = np.linalg.norm(own[near] - own[:, None], axis=2) < limit
        linked &= there[near] & there[:, None]
        one = np.broadcast_to(np.arange(len(near))[:, None], near.shape)
        links = (np.ones(linked.sum()), (one[linked], near[linked]))
        graph = scipy.sparse.csr_matrix(links, shape=(len(near), len(near)))
        group = scipy.sparse.csgraph.connected_components(graph, directed=False)[1]
        apart = there[near] & there[:, None] & (group[near] != group[:, None])
        if apart.any():
            beside = np.isin(group, group[apart.any(axis=1)])
            result |= there & beside & (group != np.bincount(group[there]).argmax())
    return torn


def _steps(at: Array) -> Array:
    """Ways (K, 2) from the marker in the middle of places (M, 2) to its neighbours [px]."""
    known = at[np.isfinite(at[:, 0])]
    away = np.linalg.norm(known - np.median(known, axis=0), axis=1)
    ways = known - known[np.argmin(away)]
    return ways[np.argsort(np.linalg.norm(ways, axis=1))[1 : _AROUND + 1]]
