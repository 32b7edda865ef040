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
class FilterSettings:
    """Tuned parameters of the filter of a contact; constants as in `way_filter.CONSTANTS`.

    Attributes
    ----------
    members, nodes: number of chains, and of the nodes of each
    middle, deviation: normal distribution of each constant before any frame; where the deviation is
        0 it is even from `first_low` to `first_high`
    first_low, first_high: see `deviation`
    low, high: limits of the constants
    least_spread: standard deviations below which the constants of members do not come together
    depths: positions of the rigid part that are tried in the first frame [m]
    first_move: standard deviations of a motion in the first frame, rigid part and object [m]
    still_move: those of a motion while the skin is still [m]
    move: what is added to them for each pixel by which the skin moves [m/px]
    inertia: share of the speed before that is expected to go on
    ahead, longest_move: longest motion that is expected, and longest step of a search [m]
    rounds, first_rounds: most steps of a search, and in the first frame
    settled: step at which a search ends [m]
    unsure: largest scatter of positions, in its standard deviations or less [m]
    calm: motion of the skin at which positions scatter as much as they are uncertain [px]
    lag: shift by which the whole skin may be held back, as a share of that since the last picture
    lost: loss as a multiple of the median at which a member is replaced
    inflation: number of values that err alike
    least: smallest weight of a frame
    steepest: largest gain of information in a frame, as a multiple of what was known
    longest: longest move of the mean in a frame [standard deviations]
    relaxed: share of the spread before a frame that is kept
    usual_misfit: misfit of frames that are explained; the median so far may be above it
    widened, widest: share by which members spread for each usual misfit above that, and at most
    """

    members: int = 32
    nodes: int = 99
    middle: tuple[float, ...] = (math.log(0.5), 0.0, 0.0, math.log(3500.0), 0.8)
    deviation: tuple[float, ...] = (0.35, 0.0, 0.0, 0.6, 0.25)
    first_low: tuple[float, ...] = (0.0, -5.0, math.log(70.0), 0.0, 0.0)
    first_high: tuple[float, ...] = (0.0, 240.0, math.log(1100.0), 0.0, 0.0)
    low: tuple[float, ...] = (math.log(0.03), -12.0, math.log(20.0), math.log(100.0), 0.3)
    high: tuple[float, ...] = (math.log(2.0), 330.0, math.log(1500.0), math.log(1e5), 1.6)
    least_spread: tuple[float, ...] = (0.005, 0.5, 0.01, 0.02, 0.01)
    depths: tuple[float, ...] = (0.05e-3, 0.1e-3, 0.2e-3, 0.35e-3, 0.55e-3, 0.8e-3, 1.2e-3, 1.8e-3)
    first_move: tuple[float, float] = (300e-6, 200e-6)
    still_move: tuple[float, float] = (2e-6, 1e-6)
    move: float = 2e-3
    inertia: float = 0.7
    ahead: float = 80e-6
    longest_move: float = 120e-6
    rounds: int = 4
    first_rounds: int = 8
    settled: float = 1e-6
    unsure: float = 6e-6
    calm: float = 0.009
    lag: float = 0.2
    lost: float = 3.0
    inflation: float = 20.0
    least: float = 0.1
    steepest: float = 4.0
    longest: float = 1.5
    relaxed: float = 0.1
    usual_misfit: float = 0.2
    widened: float = 0.1
    widest: float = 0.1


@dataclass(frozen=True, kw_only=True)
class WaySettings:
    """Tuned parameters of the estimates along the way.

    Attributes
    ----------
    filter: what follows the contact
    reach: angle from the apex up to which markers are used [rad]
    least_markers: smallest number of marker pairs
    odd: root mean square of a pair's residual at which it counts half
    place, share: error of a predicted place [px], and of a predicted motion as a share of it
    size, size_share: the same of a log size
    touched, left: mean square of the whitened shifts above which something touches, and below which
        it is gone
    quiet: root mean square of the whitened motion, since the last frame, of the markers that move
        most, by noise alone
    full: motion at which a frame has its full weight
    first_dt: time that the first frame stands for [s]
    noise: factor on the noise of places above which the skin is stirred
    turned: difference of the load's azimuth above which the way is followed again [rad]
    tried: number of frames in which it may be
    first_force: ΣFn from which on the way answers [N]
    told: number of frames from which on it does
    misfit: largest mean squared residual of markers of an explained way
    doubt: standard deviation of Γ for each unit of misfit above the filter's usual one
    remembered: number of frames over which the misfit is averaged
    margin_error, normal_error, friction_error: standard deviations of Γ, ΣFn (share) and ΣFf [N]
        beside the spread of the members
    """

    filter: FilterSettings = FilterSettings()
    reach: float = math.radians(50.0)
    least_markers: int = 20
    odd: float = 3.0
    place: float = 0.01
    share: float = 0.005
    size: float = 2e-3
    size_share: float = 0.03
    touched: float = 0.8
    left: float = 0.4
    quiet: float = 0.9
    full: float = 3.0
    first_dt: float = 0.01
    noise: float = 1.3
    turned: float = math.radians(3.0)
    tried: int = 25
    first_force: float = 0.1
    told: int = 8
    misfit: float = 1.2
    doubt: float = 0.5
    remembered: int = 20
    margin_error: float = 0.006
    normal_error: float = 0.005
    friction_error: float = 0.003
