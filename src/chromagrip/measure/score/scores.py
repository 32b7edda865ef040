"""Scores of points against their truth, with the definitions of TAP-Vid where it has them.

Numbers of tracked points are given to true ones once: where they are each other's nearest, within
half the distance to the next, in the first frame in which both are seen. From then on a number
stands for that point.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ...errors import UserError
from .matching import doubt, matched
from .points import Points

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: TAP-Vid's distances [px].
WITHIN = (1.0, 2.0, 4.0, 8.0, 16.0)
#: Units of the scores.
UNITS = {
    "bias": "px",
    "rms": "px",
    "median": "px",
    "p95": "px",
    "rms_mm": "mm",
    "bound": "× limit",
    "lost": "%",
    "false": "%",
    "swaps": "",
    "within": "%",
    "occlusion": "%",
    "jaccard": "%",
}
MEANING = {
    "bias": "length of the mean error",
    "rms": "root mean square of the errors along x and y",
    "median": "median distance from the truth",
    "p95": "distance that 95 % stay below",
    "rms_mm": "rms on the skin at rest",
    "bound": "rms over the Cramér–Rao bound at rest",
    "lost": "visible points that are not reported",
    "false": "reports of points that are not visible, or of none",
    "swaps": "points reported where another one is",
    "within": "TAP-Vid's mean share within 1, 2, 4, 8 and 16 px",
    "occlusion": "TAP-Vid's share of rightly told visibility",
    "jaccard": "TAP-Vid's average Jaccard",
}


@dataclass(frozen=True, kw_only=True)
class Truth:
    """True places of points, and what they are compared with.

    Attributes
    ----------
    points: true places
    mm_per_px: on the skin at rest, of each point, shape (N,); None where it is not known
    bound: Cramér–Rao bound of the deviation along x or y at rest [px], shape (N,); None likewise
    """

    points: Points
    mm_per_px: Array | None = None
    bound: Array | None = None


@dataclass(frozen=True, kw_only=True)
class Scored:
    """Scores, and the errors that they are of.

    Attributes
    ----------
    scores: by the names of UNITS; NaN for what is not known, and without the errors where nothing
        was followed
    error: of true points that are visible and reported [px], shape (F, N, 2)
    at: where true points are reported [px], shape (F, N, 2)
    doubt: sentence on what seems wrong with all of the table; empty if nothing does
    """

    scores: dict[str, float]
    error: Array
    at: Array
    doubt: str = ""


def score(tracked: Points, truth: Truth) -> Scored:
    """Scores of tracked points.

    Raises
    ------
    UserError
        When no point of the truth is among them, or they do not say which of its layers they are
        of.
    """
    true = truth.points
    _check_layers(tracked, true)
    frames, count = true.visible.shape
    numbers, words = matched(tracked, true), doubt(tracked, true)
    if (numbers < 0).all():
        raise UserError(
            "none of the tracked points is where a point of the truth is: "
            f"{words or 'are the frames the same?'}"
        )
    known, shared = numbers >= 0, min(frames, len(tracked.position))
    own = tracked.part(numbers[known]).seen
    at = np.full((frames, count, 2), np.nan)
    at[:shared, known] = own[:shared]
    reported = np.isfinite(at).all(axis=2)
    error = np.where((reported & true.visible)[..., None], at - true.position, np.nan)
    strangers = int(tracked.visible[:shared].sum() - reported[:shared].sum())
    result = _accuracy(error, truth)
    seen = max(int(true.visible.sum()), 1)
    result["lost"] = 100.0 * float((true.visible & ~reported).sum()) / seen
    wrong = int((reported & ~true.visible).sum()) + strangers
    result["false"] = 100.0 * wrong / max(wrong + int((reported & true.visible).sum()), 1)
    result["swaps"] = float(_swapped(at, true).sum())
    return Scored(
        scores=result | _tap(error, reported, true.visible),
        error=error,
        at=at,
        doubt=words,
    )


def score_nothing(truth: Truth) -> Scored:
    """Scores of a tracker that cannot follow these points: all are lost, and no error is known."""
    true = truth.points
    nowhere = np.full((*true.visible.shape, 2), np.nan)
    scores = {"lost": 100.0 * bool(true.visible.any()), "false": 0.0, "swaps": 0.0}
    tap = _tap(nowhere, np.zeros_like(true.visible), true.visible)
    return Scored(scores=scores | tap, error=nowhere, at=nowhere)


def _check_layers(tracked: Points, true: Points) -> None:
    """Refuse points without layers where those of the truth's layers lie on each other."""
    layers, own = (sorted(set(points.layers)) for points in (true, tracked))
    if len(layers) > 1 and not set(layers) & set(own):
        there = f"the layer {' and '.join(own)}" if any(own) else "no layer"
        raise UserError(
            f"the points have {there}, those of the truth {' and '.join(layers)}, which lie on "
            "each other; wanted: a column or array layer with these names"
        )


def _accuracy(error: Array, truth: Truth) -> dict[str, float]:
    there = np.isfinite(error[..., 0])
    nothing = dict.fromkeys(("bias", "rms", "median", "p95", "rms_mm", "bound"), np.nan)
    if not there.any():
        return nothing
    length = np.linalg.norm(error[there], axis=-1)
    result = nothing | {
        "bias": float(np.hypot(*error[there].mean(axis=0))),
        "rms": float(np.sqrt((error[there] ** 2).mean())),
        "median": float(np.median(length)),
        "p95": float(np.percentile(length, 95)),
    }
    for name, unit in (("rms_mm", truth.mm_per_px), ("bound", truth.bound)):
        if unit is not None:
            ratio = error * unit[:, None] if name == "rms_mm" else error / unit[:, None]
            result[name] = float(np.sqrt(np.nanmean(ratio**2)))
    return result


def _swapped(at: Array, true: Points) -> Mask:
    """Points (F, N) that are reported nearer to another one of their layer than to themselves."""
    swapped = np.zeros(true.visible.shape, dtype=bool)
    for layer in set(true.layers):
        of = np.flatnonzero(true.layers == layer)
        for k, (reported, place) in enumerate(zip(at[:, of], true.position[:, of], strict=True)):
            there = np.flatnonzero(true.visible[k, of])
            asked = np.flatnonzero(np.isfinite(reported[:, 0]) & true.visible[k, of])
            if len(there) < 2 or len(asked) == 0:
                continue
            nearest = there[KDTree(place[there]).query(reported[asked])[1]]
            swapped[k, of[asked]] = nearest != asked
    return swapped


def _tap(error: Array, reported: Mask, visible: Mask) -> dict[str, float]:
    length = np.where(visible & reported, np.linalg.norm(error, axis=-1), np.inf)
    within, jaccard = [], []
    for limit in WITHIN:
        near = length < limit
        within.append(near.sum() / max(visible.sum(), 1))
        wrong = (reported & ~visible) | (reported & visible & ~near)
        jaccard.append(near.sum() / max(visible.sum() + wrong.sum(), 1))
    return {
        "within": 100.0 * float(np.mean(within)),
        "occlusion": 100.0 * float((reported == visible).mean()),
        "jaccard": 100.0 * float(np.mean(jaccard)),
    }
