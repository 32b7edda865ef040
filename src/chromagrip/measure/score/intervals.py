"""Intervals of mean scores: whole sequences are drawn again, since frames of one are alike."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

#: Number of draws of the bootstrap, and its seed.
DRAWS, SEED = 4000, 0
#: Ends of an interval [%]: it covers 90 %.
ENDS = (5.0, 95.0)
#: Quantile of the normal distribution at those ends.
_Z = 1.6448536269514722


def intervals(sequences: Sequence[Mapping[str, float]]) -> dict[str, tuple[float, float]]:
    """Bounds of the mean of each score, over draws of as many sequences with replacement.

    Draws depend on the number of sequences alone: two makers' tracks of the same sequences are
    judged on the same draws. A score that is not known of a sequence has NaN for bounds. One that a
    sequence lacks, as a tracker cannot follow it, is that of the others. Of one sequence there are
    no intervals.
    """
    count = len(sequences)
    if count < 2:
        return {}
    drawn = np.random.default_rng(SEED).integers(count, size=(DRAWS, count))
    bounds = {}
    for name in {name: None for scores in sequences for name in scores}:
        has = np.array([name in scores for scores in sequences])
        values = np.array([scores.get(name, 0.0) for scores in sequences])
        means = values[drawn].sum(axis=1) / np.maximum(has[drawn].sum(axis=1), 1)
        low, high = np.percentile(means[has[drawn].any(axis=1)], ENDS)
        bounds[name] = (float(low), float(high))
    return bounds


def share_interval(hits: int, count: int) -> tuple[float, float]:
    """Bounds of 90 % of a share of which `hits` of `count` were seen (Wilson 1927); NaN of none."""
    if count == 0:
        return math.nan, math.nan
    share, weight = hits / count, _Z**2 / count
    middle = (share + 0.5 * weight) / (1.0 + weight)
    half = math.sqrt(weight * (share * (1.0 - share) + 0.25 * weight)) / (1.0 + weight)
    return max(middle - half, 0.0), min(middle + half, 1.0)
