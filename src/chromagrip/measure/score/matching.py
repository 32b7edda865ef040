"""Which tracked point stands for which true one, and what seems wrong with a table of them."""

from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from .points import Points

Array = NDArray[np.float64]

#: A point is given a number within this share of the distance to its nearest neighbour.
_NEAR = 0.5
#: Frames in which a table is compared with the truth, evenly spread over it.
_LOOKED = 16
#: Least median error that other places are sought for [px]: good trackers have biases below.
_LEAST = 0.25
#: Error that is left, over that of the table as it is, where frames or places are doubted.
_LEFT_FRAMES, _LEFT_PLACES = 0.5, 0.2
#: A factor is taken for 1 within this, and at first, from the spreads of the places, within that.
_UNSCALED, _ABOUT = 0.002, 0.1
#: Fewest points that a change of the places is fitted to, and times that it is.
_FEWEST, _TURNS = 4, 4
#: Share of the lost points that are there with another number, above which numbers change.
_RENUMBERED = 0.5
#: Places nearer to (0, 0) than this share of the truth's farthest are not in its pixels.
_CLOSE = 0.25


def matched(tracked: Points, true: Points) -> NDArray[np.intp]:
    """Number of the tracked point that stands for each true one, −1 for none, shape (N,)."""
    given = np.full(len(true.names), -1, dtype=np.intp)
    same = set(tracked.layers) & set(true.layers)
    groups = sorted(same) if same else [None]
    for k in range(min(len(tracked.position), len(true.position))):
        if (given >= 0).all():
            break
        for layer in groups:
            of = np.ones(len(given), bool) if layer is None else true.layers == layer
            own = np.ones(len(tracked.names), bool) if layer is None else tracked.layers == layer
            free = np.flatnonzero(of & true.visible[k] & (given < 0))
            offered = np.setdiff1d(np.flatnonzero(own & tracked.visible[k]), given)
            if len(free) == 0 or len(offered) == 0:
                continue
            place, found = true.position[k, free], tracked.position[k, offered]
            all_of = true.position[k, of & true.visible[k]]
            reach = _NEAR * _spacing(place, all_of)
            distance, near = (np.asarray(v) for v in KDTree(found).query(place))
            back = np.asarray(KDTree(place).query(found)[1])
            mutual = (back[near] == np.arange(len(free))) & (distance < reach)
            given[free[mutual]] = offered[near[mutual]]
    return given


def _spacing(place: Array, others: Array) -> Array:
    """Distance of points (n, 2) to the nearest other one, shape (n,)."""
    if len(others) < 2:
        return np.full(len(place), np.inf)
    return np.asarray(KDTree(others).query(place, k=2)[0])[:, 1]


class _Fit(NamedTuple):
    """Places [px] of a table, changed as said, that are matched with true ones, shapes (n, 2).

    In the median error [px] half a marker distance stands for each possible one that is not.
    """

    words: str
    own: Array
    true: Array
    possible: int
    error: float


def _fit(words: str, tracked: Points, true: Points) -> _Fit:
    numbers = matched(tracked, true)
    own, at = tracked.part(numbers[numbers >= 0]).seen, true.part(numbers >= 0).seen
    both = np.isfinite(own - at).all(axis=2)
    k = true.visible.sum(axis=1).argmax()
    of = [true.position[k, true.visible[k] & (true.layers == layer)] for layer in set(true.layers)]
    most = _NEAR * np.median(np.concatenate([_spacing(place, place) for place in of]))
    off = np.full(max(min(tracked.visible.sum(), true.visible.sum()), 1), most)
    off[: both.sum()] = np.minimum(np.linalg.norm(own - at, axis=2)[both], most)
    return _Fit(words, own[both], at[both], len(off), float(np.median(off)))


def doubt(tracked: Points, true: Points) -> str:
    """Sentence on what seems wrong with a table as a whole; empty if nothing does.

    The simplest change of its frames or places that makes the error much smaller is said.
    """
    layers = set(tracked.layers) & set(true.layers) or {*tracked.layers, *true.layers}
    tracked, true = (p.part(np.isin(p.layers, [*layers])) for p in (tracked, true))
    said = []
    own_shape, true_shape = tracked.visible.shape, true.visible.shape
    if own_shape == true_shape[::-1] and own_shape != true_shape:
        said.append("points and frames seem to be exchanged")
    for value in (0.0, -1.0):
        rows, real = (p.visible & (p.position == value).all(axis=2) for p in (tracked, true))
        if rows.any() and not real.any():
            where = f"({value:g}, {value:g})"
            said.append(f"{rows.sum()} rows are at {where}: leave the places of lost points empty")
            tracked = replace(tracked, visible=tracked.visible & ~rows)
    frames = np.unique(np.linspace(0, len(true.position) - 1, _LOOKED).astype(int))
    earlier, own, later = (_at(tracked, frames + k) for k in (-1, 0, 1))
    truth = _at(true, frames)
    if not (own.visible.any() and truth.visible.any()):
        return "; ".join(said)
    words = "the frames seem to be shifted by one: counted from one "
    as_is, less = _fit("", own, truth), _fit(f"{words}less", later, truth)
    shifted = min(less, _fit(f"{words}more", earlier, truth), key=lambda fit: fit.error)
    error, left = as_is.error, shifted.error
    # Where nothing moves, nearly all of a frame more is matched.
    more = len(shifted.own) > len(as_is.own) + 0.8 * as_is.possible / len(frames)
    fits = [shifted] * bool(left < _LEFT_FRAMES * error or (more and left <= error))
    if error > _LEAST and min(len(own.names), len(truth.names)) >= _FEWEST:
        both = ("", own), (f"{words}less; ", later), (f"{words}more; ", earlier)
        placed = [
            fit._replace(words=f"{w}{fit.words}") for w, p in both for fit in _placed(p, truth)
        ]
        fits += [fit for fit in placed if fit.error < _LEFT_PLACES * error]
    if fits:
        least = min(fit.error for fit in fits)
        best = next(fit for fit in fits if fit.error <= 2.0 * least)  # the simplest of the like
        said.insert(
            0,
            f"{best.words}, {len(best.own)} sampled places have a median error of {best.error:.2g} "
            f"px, as they are {len(as_is.own)} places {error:.2g} px",
        )
    elif len(as_is.own) < 0.5 * as_is.possible:
        near, far = (np.quantile(np.abs(p.position[p.visible]), 0.9) for p in (own, truth))
        if near < _CLOSE * far:
            return f"most places are within {near:.2g} of (0, 0): displacements, or not in pixels?"
    if not fits and (share := _renumbered(own, truth)) > _RENUMBERED:
        said.append(f"where points are lost, {share:.0%} have one of a new number: numbers change")
    return "; ".join(said)


def _renumbered(tracked: Points, true: Points) -> float:
    """Share of the lost true points at whose place is a tracked one of another number, if many."""
    numbers = matched(tracked, true)
    found = tracked.visible[:, numbers] & (numbers >= 0)
    lost, there = true.visible & ~found, 0
    for k, some in enumerate(lost):
        own = tracked.position[k, tracked.visible[k]]
        if some.any() and len(own):
            place, others = true.position[k, some], true.position[k, true.visible[k]]
            near = np.asarray(KDTree(own).query(place)[0])
            there += int((near < 0.5 * _NEAR * _spacing(place, others)).sum())
    return there / lost.sum() if lost.sum() > _RENUMBERED**4 * true.visible.sum() else 0.0


def _at(points: Points, frames: NDArray[np.intp]) -> Points:
    """Points in some frames, which need not be there."""
    there = (frames >= 0) & (frames < len(points.visible))
    k = np.where(there, frames, 0)
    visible = points.visible[k] & there[:, None]
    return replace(points, position=points.position[k], visible=visible)


def _placed(tracked: Points, true: Points) -> list[_Fit]:
    """Fits of places that are scaled, mirrored, exchanged and moved, the simplest first."""
    found, wanted = (points.position[points.visible] for points in (tracked, true))
    if wanted.std(axis=0).min() < 1.0:  # one row, whose scale across it is not known
        return []
    starts: list[tuple[list[int], Array, Array]] = [([0, 1], np.ones(2), np.zeros(2))]
    for order, x, y in product(([0, 1], [1, 0]), (1.0, -1.0), (1.0, -1.0)):
        own = found[:, order]
        ratio = wanted.std(axis=0) / np.maximum(own.std(axis=0), 1e-9)
        scale = np.where(np.abs(ratio - 1.0) < _ABOUT, 1.0, ratio) * (x, y)
        starts.append((order, scale, wanted.mean(axis=0) - scale * own.mean(axis=0)))
    fits = []
    for order, scale, offset in starts:
        for _ in range(_TURNS):
            moved = replace(tracked, position=scale * tracked.position[..., order] + offset)
            fit = _fit(_words(order, scale, offset), moved, true)
            off = np.linalg.norm(fit.own - fit.true, axis=1)
            near = off <= 2.0 * np.median(off) if len(off) else []
            own, at = (fit.own[near] - offset) / scale, fit.true[near]
            if len(own) < _FEWEST or np.hstack([own, at]).std(axis=0).min() < 1e-6:
                break
            spread = own - own.mean(axis=0)
            scale = (spread * at).sum(axis=0) / (spread**2).sum(axis=0)
            scale = np.where(np.abs(np.abs(scale) - 1.0) < _UNSCALED, np.sign(scale), scale)
            offset = (at - scale * own).mean(axis=0)
        fits.append(fit)
    return fits


def _words(order: list[int], scale: Array, offset: Array) -> str:
    """What seems wrong with places that fit after this change, and the change."""
    kinds = ["exchanged"] * (order == [1, 0])
    kinds += [f"mirrored in {axis}" for axis, s in zip("xy", scale, strict=True) if s < 0]
    kinds += ["scaled"] * bool((np.abs(scale) != 1.0).any())
    terms = []
    for k, s, more in zip(order, scale, offset.round(1), strict=True):
        factor = {1.0: "", -1.0: "-"}.get(s, f"{s:.4g} ")
        added = f" {'-' if more < 0 else '+'} {abs(more):g}" if more else ""
        terms.append(f"{factor}{'xy'[k]}{added}")
    return f"the places seem to be {' and '.join(kinds or ['offset'])}: as ({', '.join(terms)})"
