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


@dataclass(frozen=True, kw_only=True)
class ObjectSettings:
    """Tuned parameters of the object along whose normal forces are resolved.

    Attributes
    ----------
    mean: prior mean of its height [m], slope, curvature [1/m], and softness at 251 nodes [m/N]
    deviation: prior standard deviations of the same: flat table to pea, steel to ripe berry
    roughness: standard deviation of the skin from the object [m]
    common: relative error common to all forces, due to knots and linearisation
    passes: number of fits; normal forces follow from the slope, and the slope from them
    """

    mean: tuple[float, ...] = (0.0, 0.0, 100.0, 3e-3)
    deviation: tuple[float, ...] = (1e-2, 0.3, 80.0, 4e-3)
    roughness: float = 40e-6
    common: float = 0.03
    passes: int = 2


@dataclass(frozen=True, kw_only=True)
class GaussianProcessSettings:
    """Tuned parameters of `GaussianProcess`; its prior is `ForcePrior`.

    Attributes
    ----------
    margin: angle outside the prior's reach above which markers are not used [rad]
    farthest: largest displacement of a node over the radius
    blunt: slope of the skin below which the jump in its stiffness is smoothed for Newton's method
    zone_gain: smallest gain of log evidence for another zone; less makes the estimate flicker
    settled: step below which the passes end [m]
    unsettled: largest last step of a solution [m]
    heats: factors on the noise from pass to pass, from rest: smooth, broad forces that sharpen
        later keep the skin from folding the wrong way; a second try takes each twice
    warm_heats: such factors for a start from the last frame
    share, slow_share, warm_share: share of a Newton step in each pass, in the first and the second
        try from rest, and from the last frame
    more: number of further passes with half the step if these do not settle
    coarseness: error of a marker's motion because forces are linear between knots [px]; without it,
        positions known to 0.01 px distort the forces of sharp contacts
    misfit: largest mean squared residual of the markers over their noise
    contact: settings of the object
    """

    margin: float = math.radians(20.0)
    farthest: float = 0.5
    blunt: float = 0.05
    zone_gain: float = 1.5
    settled: float = 20e-6
    unsettled: float = 60e-6
    heats: tuple[float, ...] = (100.0, 30.0, 10.0, 5.0, 3.0, 2.0, 1.0, 1.0, 1.0)
    warm_heats: tuple[float, ...] = (1.0, 1.0)
    share: float = 0.8
    slow_share: float = 0.4
    warm_share: float = 0.8
    more: int = 8
    coarseness: float = 0.15
    misfit: float = 9.0
    contact: ObjectSettings = ObjectSettings()
