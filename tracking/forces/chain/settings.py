"""Tuned numbers of the reconstructors of the chain, each with its unit and effect."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class CodeSettings:
    """Tuned numbers of the codes of a frame.

    Attributes
    ----------
    least_share, fewest_pairs: share of the design's pairs, and number of pairs, below which the
        codes are not determined
    stray: χ² (of 6) given the others above which a pair is not where its track is
    near_worst: share of the worst χ² below which pairs are judged again without the worst: a stray
        pair draws the others with it
    likely: χ² given the others below which a pair of ambiguous number is used; on folded skin the
        right one is up to 170 off, the wrong one 50 000
    unlike: mean χ² per measurement above which a frame is no trained press
    least_turn: smallest change of the azimuth [rad]
    certain_turn: the same in its standard deviations
    turns: largest number of changes of the azimuth in a frame
    determined: smallest share of a code that pairs must determine for the prior to be undone
    noise_change: relative change of the noise above which weights are computed again
    vaguer: variance of a log size over the usual one above which its pair gets weights of its own
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
    """Tuned numbers of `Learned`.

    Attributes
    ----------
    vague_share, vague: share of ΣFn, and force in addition to it [N], above which its deviation
        leaves it unknown
    observable: deviation of µ over that before any image, below which µ is observable
    largest: largest asinh of |ΣFn| over BEND that is estimated, about 30 N
    slack: logarithm by which the context of a frame may exceed that of the training
    compressed: largest factor of compression on the errors of markers, that of H.264 at crf 18
    smallest_friction: smallest estimate of µ
    no_contact: ΣFn below which there is no contact [N]
    codes: codes of a frame
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
    """Tuned numbers of the object that forces are turned to.

    Attributes
    ----------
    mean: prior mean of its height [m], slope, curvature [1/m], and softness at 251 nodes [m/N]
    deviation: prior deviations of the same: from a flat table to a pea, from steel to a ripe berry
    roughness: deviation of the skin from the object [m]
    common: relative error that all forces share, by knots and linearising
    passes: number of fits; normal forces follow from the slope, and the slope from them
    """

    mean: tuple[float, ...] = (0.0, 0.0, 100.0, 3e-3)
    deviation: tuple[float, ...] = (1e-2, 0.3, 80.0, 4e-3)
    roughness: float = 40e-6
    common: float = 0.03
    passes: int = 2


@dataclass(frozen=True, kw_only=True)
class GaussianProcessSettings:
    """Tuned numbers of `GaussianProcess`; its prior is `ForcePrior`.

    Attributes
    ----------
    margin: angle outside the prior's reach above which markers do not feel the contact [rad]
    farthest: largest displacement of a node over the radius
    blunt: slope of the skin below which the jump in its stiffness is smoothed for Newton's method
    zone_gain: log evidence that another zone must gain; less makes the estimate flicker
    settled: step that ends the passes [m]
    unsettled: largest last step of a solution [m]
    heats: factors on the noise from pass to pass, from rest: smooth, broad forces that sharpen
        later keep the skin from folding the wrong way; a second try takes each twice
    warm_heats: such factors from the last frame
    share, slow_share, warm_share: share of a Newton step in each pass, in the first and the second
        try from rest, and from the last frame
    more: number of passes of half the step that follow where these do not settle
    coarseness: motion of a marker that forces between knots cannot follow [px]; without it, places
        that are known to 0.01 px bend the forces of sharp contacts
    misfit: largest mean squared residual of the markers over their noise
    contact: object that forces are turned to
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


@dataclass(frozen=True, kw_only=True)
class StiffnessSettings:
    """Tuned numbers of `StiffnessReading`.

    Attributes
    ----------
    least_markers: number of visible pairs below which the displacement is not determined
    knots: number of smooth bumps along the half circle that make up a displacement
    width: standard deviation of a bump along the skin [m]
    amplitude: prior deviation of its amplitude [m]
    passes: number of passes with the derivative at rest: lens and tilt make shifts nonlinear
    step: step of the stiffness' derivative [standard deviations]
    contact: object that forces are turned to
    """

    least_markers: int = 40
    knots: int = 41
    width: float = 1.3e-3
    amplitude: float = 0.3e-3
    passes: int = 3
    step: float = 1e-2
    contact: ObjectSettings = ObjectSettings()
