"""Tuned parameters of the reconstructors of the chain, each with its unit and effect."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class CodeSettings:
    """Tuned parameters of the codes of a frame.

    Attributes
    ----------
    least_share, fewest_pairs: smallest share of the design's pairs, and number of pairs
    stray: χ² (6 values) given the other pairs above which a pair is mistracked
    near_worst: share of the worst χ² below which pairs are judged again without the worst, as a
        mistracked pair affects the others
    likely: χ² given the other pairs below which a pair of ambiguous number is used; on folded skin
        it is up to 170 for the right number, and 50 000 for a wrong one
    unlike: mean χ² per measurement above which a frame is unlike any trained press
    least_turn: smallest change of the azimuth [rad]
    certain_turn: smallest change of the azimuth in standard deviations
    turns: largest number of changes of the azimuth in a frame
    determined: smallest share of a code that pairs must determine for the prior to be undone
    noise_change: relative change of the noise above which weights are computed again
    vaguer: variance of a log size over the usual one above which its pair gets separate weights
    few: number of measurements over unknowns up to which a covariance is updated
    noisier: variance of a direction over the median above which it widens the interval
    """

    least_share: float = 0.15
    fewest_pairs: int = 12
    stray: float = 50.0
    near_worst: float = 0.25
    likely: float = 1000.0
    unlike: float = 9.0
    least_turn: float = math.radians(0.7)
    certain_turn: float = 3.0
    turns: int = 6
    determined: float = 0.7
    noise_change: float = 0.25
    vaguer: float = 4.0
    few: float = 0.5
    noisier: float = 2.0


@dataclass(frozen=True, kw_only=True)
class LearnedSettings:
    """Tuned parameters of `Learned`.

    Attributes
    ----------
    vague_share, vague: largest standard deviation of ΣFn: share of ΣFn, plus a force [N]
    observable: standard deviation of µ over that of the prior, below which µ is observable
    largest: largest estimate of asinh(|ΣFn|/BEND), about 30 N
    slack: logarithm by which the statistics of a frame may exceed those in training
    compressed: largest factor of compression on the errors of markers, that of H.264 at crf 18
    smallest_friction: smallest estimate of µ
    no_contact: ΣFn below which there is no contact [N]
    codes: settings of the codes
    """

    vague_share: float = 0.4
    vague: float = 0.1
    observable: float = 0.4
    largest: float = 5.0
    slack: float = 0.2
    compressed: float = 7.5
    smallest_friction: float = 0.05
    no_contact: float = 0.01
    codes: CodeSettings = CodeSettings()
