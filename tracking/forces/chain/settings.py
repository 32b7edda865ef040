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
class WaySettings:
    """Tuned parameters of the fit along the way; constants are in the order of `way_fit.CONSTANTS`.

    Attributes
    ----------
    nodes: number of nodes of the copies, graded
    reach: angle from the apex up to which markers are used [rad]
    free: constants that are searched; the others keep their mean
    mean, deviation: prior of the constants
    spread: differences of the constants between copies
    longest: longest steps of the constants
    low, high: limits of the constants
    curvatures, stiffnesses: curvatures [1/m] and stiffnesses [N/m] of the starts
    ruled_out, ruled_out_by, tried: factor on the least sum of squares, and addition to it, above
        which a candidate is dropped after so many frames
    worse, slack: factor on the sum of squares so far, and share of the whole added to it, above
        which a search ends
    least_markers: smallest number of marker pairs
    odd: root mean square of a pair's residual at which it counts half
    place, share: error of a predicted place [px], and of a predicted motion as a share of it
    lag: motion by which the whole skin may be held back, as a share of that since the last picture
    size, size_share: the same of a log size
    inflation: number of values that err alike
    touched: mean square of the whitened shifts above which something touches
    moved: root mean square of the whitened motion since the last frame above which a frame counts
    still: number of frames of which one counts though nothing moves
    quiet: such a motion of noise alone
    full: motion at which a frame has its full weight, and weight of one without motion
    least: see `full`
    move: standard deviation of a motion from frame to frame, rigid part and object [m]
    ahead: longest motion that is foreseen [m]
    settled: motion at which a position is found [m]
    chord: motion up to which derivatives are kept [m]
    apart: motion of a copy above which it is corrected once more [m]
    longest_move: longest motion of a correction [m]
    depths, sides: positions of the rigid part [m] that are tried in the first frame, and of the
        object, as shares of these
    rounds, first_rounds: most corrections of a position, and in the first frame
    sums_share, sums_bend: error of the sums of the other method: share, and force below which it is
        absolute [N]
    sums_free, sums_limit: deviation up to which it is explained, and largest that counts [errors]
    sums_weight: weight of the sums in a frame
    first_frames, first_force: least number of frames, and ΣFn [N], from which a search starts
    light: force, as a share of the largest so far, at which a frame counts a quarter
    gain, gain_share: least decrease of the sum of squares for which the way is followed again, and
        the same as a share of the sum
    near: spread of the copies after a short step
    catch_up: number of frames that are followed again in each frame
    most_frames: number of frames that are kept, after which the constants are not searched any more
    most_damping, patience: damping at which a search is given up, and number of turns to the next
    first_dt: time that the first frame stands for [s]
    turned: difference of the load's azimuth above which the way is followed again [rad]
    told: number of frames from which on the way answers
    misfit: largest mean squared residual of markers of an explained way
    usual_misfit: up to which errors are those below; they grow with the misfit
    promised: gain of the next step, as a share of the sum of squares, that doubles the errors
    young: number of frames at which they are twice those of a long way
    margin_error, normal_error, friction_error: standard deviations of Γ, ΣFn (share) and ΣFf [N]
    """

    nodes: int = 99
    reach: float = math.radians(50.0)
    free: tuple[int, ...] = (0, 1, 2, 3, 4)
    mean: tuple[float, ...] = (math.log(0.5), 60.0, math.log(250.0), math.log(3000.0), 0.9, 0.0)
    deviation: tuple[float, ...] = (0.3, 90.0, 1.0, 0.9, 0.4, 0.02)
    spread: tuple[float, ...] = (0.08, 8.0, 0.12, 0.3, 0.12, 0.03)
    longest: tuple[float, ...] = (0.5, 80.0, 1.0, 0.8, 0.3, 0.08)
    low: tuple[float, ...] = (math.log(0.03), -12.0, math.log(20.0), math.log(100.0), 0.3, -0.3)
    high: tuple[float, ...] = (math.log(2.0), 330.0, math.log(1500.0), math.log(1e5), 1.6, 0.3)
    curvatures: tuple[float, ...] = (5.0, 60.0, 120.0, 200.0)
    stiffnesses: tuple[float, ...] = (80.0, 250.0, 800.0)
    ruled_out: float = 2.0
    ruled_out_by: float = 100.0
    tried: int = 25
    worse: float = 1.3
    slack: float = 0.1
    least_markers: int = 20
    odd: float = 3.0
    place: float = 0.01
    share: float = 0.005
    lag: float = 0.2
    size: float = 2e-3
    size_share: float = 0.03
    inflation: float = 4.0
    touched: float = 1.5
    moved: float = 1.3
    still: int = 6
    quiet: float = 0.9
    full: float = 3.0
    least: float = 0.05
    move: tuple[float, float] = (300e-6, 200e-6)
    ahead: float = 80e-6
    settled: float = 0.5e-6
    chord: float = 20e-6
    apart: float = 8e-6
    longest_move: float = 120e-6
    depths: tuple[float, ...] = (0.05e-3, 0.1e-3, 0.2e-3, 0.35e-3, 0.55e-3, 0.8e-3, 1.2e-3, 1.8e-3)
    sides: tuple[float, ...] = (-0.5, 0.0, 0.5)
    rounds: int = 5
    first_rounds: int = 9
    sums_share: float = 0.06
    sums_bend: float = 0.4
    sums_free: float = 1.5
    sums_limit: float = 6.0
    sums_weight: float = 20.0
    first_frames: int = 5
    first_force: float = 0.3
    light: float = 0.3
    gain: float = 1.0
    gain_share: float = 0.01
    near: float = 0.5
    catch_up: int = 4
    most_frames: int = 250
    most_damping: float = 80.0
    patience: int = 4
    first_dt: float = 0.01
    turned: float = math.radians(3.0)
    told: int = 8
    misfit: float = 1.2
    usual_misfit: float = 0.25
    promised: float = 0.2
    young: float = 30.0
    margin_error: float = 0.015
    normal_error: float = 0.02
    friction_error: float = 0.008
