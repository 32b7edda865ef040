"""Tuned parameters of the reconstructor `contact`, each with its unit and effect."""

from dataclasses import dataclass

#: Error of a marker's position due to the linear silicone and the simple object [px].
PLACE_ERROR = 0.02
#: Error of the logarithm of a marker's size due to the same.
SIZE_ERROR = 5e-3
#: Largest effective number of independent key frames, as errors of the model are common to all.
INDEPENDENT = 3.0


@dataclass(frozen=True, kw_only=True)
class ContactModelSettings:
    """Tuned parameters of the fitted contact.

    Attributes
    ----------
    dahl_exponent: exponent of the Dahl law, which is not fitted
    light_shift: smallest prior standard deviation of a shift, over the thickness of the silicone
    shift_per_press: prior standard deviation of a shift over the press
    hollow: prior standard deviation of a negative curvature, times the dome's radius: gripped
        objects are rarely hollow, and a soft plane shows almost the same markers as a stiff hollow
    farthest: largest press of silicone and object together, over the thickness of the silicone
    deepest: deepest press of the silicone, over its thickness
    flattest, sharpest: bounds of curvature times the dome's radius; deeper hollows fit nowhere
    longest_part: longest part of a step over the thickness; shorter parts follow friction better
    most_parts: largest number of parts
    derivative_step: change of an unknown for its derivative, over its unit
    """

    dahl_exponent: float = 0.7
    light_shift: float = 0.02
    shift_per_press: float = 0.6
    hollow: float = 0.1
    farthest: float = 2.0
    deepest: float = 0.75
    flattest: float = -0.9
    sharpest: float = 8.0
    longest_part: float = 0.08
    most_parts: int = 8
    derivative_step: float = 1e-4


@dataclass(frozen=True, kw_only=True)
class ContactFitSettings:
    """Tuned parameters of the fit of a contact; gains are decreases of the cost.

    Attributes
    ----------
    least_gain: gain of a round below which the fit ends
    promising_rounds: rounds of a rival after which its expected cost decides whether it goes on
    corrections: steps that follow a step of a round, with its derivatives; these cost several times
        as much as the contacts themselves
    chord_rounds: rounds with the derivatives of an earlier solution
    chord_reach: distance from that solution, over the longest step, above which they no longer hold
    follow_steps: largest number of steps of a pose from frame to frame
    follow_gain: expected gain below which a pose stays as it is
    slow: share of the previous gain above which derivatives of a followed pose are computed again,
        and share of a round's gain below which a correction is its last
    small_change: change of ln ΣFn, ln µ and Γ below which the object is not refitted; it is small
        against errors of silicone and friction law
    unsure_share: such a change as a share of the standard deviations of ln ΣFn, ln µ and Γ
    telling_gain: expected gain per key frame, over the misfit, above which the object is refitted
    independent_keys: largest effective number of key frames; more have less weight each
    model: settings of the fitted contact
    """

    least_gain: float = 0.3
    promising_rounds: int = 2
    corrections: int = 4
    chord_rounds: int = 3
    chord_reach: float = 0.25
    follow_steps: int = 4
    follow_gain: float = 0.03
    slow: float = 0.1
    small_change: float = 0.003
    unsure_share: float = 0.05
    telling_gain: float = 50.0
    independent_keys: float = INDEPENDENT
    model: ContactModelSettings = ContactModelSettings()


@dataclass(frozen=True, kw_only=True)
class ShiftSettings:
    """Tuned parameters for outliers among the pairs of a frame.

    Attributes
    ----------
    odd: RMS residual of a pair at which its weight in a fit is half [standard deviations]
    off: RMS residual above which the cost of a pair grows linearly [standard deviations]
    moved: mean square of a pair's shifts above which it has moved [variances]
    several: smallest number of moved pairs that show an unlike object
    odd_percent: share of the moved pairs that counts for `odd_misfit` [%]: an unlike object
        contradicts some of them, a few are outliers of any specimen
    over_median: that percentile of noise alone, over its median
    """

    odd: float = 1.5
    off: float = 2.0
    moved: float = 25.0
    several: int = 6
    odd_percent: float = 80.0
    over_median: float = 2.0


@dataclass(frozen=True, kw_only=True)
class KeySettings:
    """Tuned parameters for the choice of key frames; smaller steps give more of them.

    Attributes
    ----------
    most: largest number of key frames; each costs time in every refit
    shift, press: distances from one key pose to the next, over the thickness of the silicone
    twist_rad: twist from one key pose to the next [rad]
    """

    most: int = 8
    shift: float = 0.01
    press: float = 0.015
    twist_rad: float = 0.03


@dataclass(frozen=True, kw_only=True)
class StartSettings:
    """Tuned parameters for the starts of a fit.

    Attributes
    ----------
    places: rings of starts from rest: angle of each from the apex [rad], and number of starts
    press: press of a start from rest, over the thickness
    curves: curvatures of other objects at the same place, times the radius
    rivals: factors on press and curvature, and on µ, of the rivals that are tried in turns
    plausible: prior standard deviations of ln k and ln µ above which a rival is not tried
    softening: exponent with which the stiffness of a rival depends on its press
    rivals_first, rivals_most: key frames from one rival to the next, at first and at most
    """

    places: tuple[tuple[float, int], ...] = ((0.0, 1), (0.25, 6), (0.55, 10))
    press: float = 0.1
    curves: tuple[float, ...] = (0.0, 3.0)
    rivals: tuple[tuple[float, float], ...] = ((1.6, 1.0), (1.0 / 1.6, 1.0), (1.0, 0.5))
    plausible: float = 5.0
    softening: float = -1.8
    rivals_first: int = 2
    rivals_most: int = 32


@dataclass(frozen=True, kw_only=True)
class ContactSettings:
    """Tuned parameters of `ContactReading`; misfits are mean squared residuals over variances.

    Attributes
    ----------
    least_markers: smallest number of visible pairs
    place_error_px: error of a marker's position due to silicone and object [px]
    size_error: error of the logarithm of its size due to the same
    share_error: error of a position as a share of the marker's motion
    untouched: cost of the shifts below which nothing touches
    explained: decrease of the cost that a contact must achieve; noise hides lighter touches
    misfit: largest misfit of a solution; above it the frame is refused
    unlike: largest `odd_misfit` of a solution; objects of two curvatures stay below it, whatever
        the specimen
    hollow, edge: smallest and largest curvature of a smooth, convex object, times the radius
    shaped_misfit: misfit above which an object beyond them is rejected
    same: mean squared change of the shifts below which a refused frame counts as unchanged
    changed: share of the squared shifts; a refused contact whose shifts change by more is searched
        again at once
    search_every: number of frames after which a refused contact is searched again at the latest
    search_patience: unsuccessful searches after which the interval between them doubles
    rounds: largest number of rounds of a fit from rest
    refit_rounds: largest number of rounds of a fit that starts near its solution
    rival_rounds: largest number of rounds of a rival; a better one continues in its next turn
    refit_every: number of key frames that could change the estimate, after which the object is
        fitted again at the latest
    refit_patience: unsuccessful refits after which the interval between them doubles
    rival_gain: decrease of the cost by a rival above which rivals are tried more often
    doubtful: smallest misfit at which other objects are tried
    worse: factor on the misfit of the last solution above which they are tried
    observed: standard deviation of ln µ below which µ is observable
    observable_margin: margin Γ above which µ is not observable
    margin_error: error of Γ due to the layer's thickness and the friction law
    normal_error, friction_error: relative errors of ΣFn and ΣFf due to the same
    touching: share of ΣFn above which a node is in contact
    fit, shifts, keys, starts: settings of the parts of the method
    """

    least_markers: int = 12
    place_error_px: float = PLACE_ERROR
    size_error: float = SIZE_ERROR
    share_error: float = 0.015
    untouched: float = 100.0
    explained: float = 60.0
    misfit: float = 2.0
    unlike: float = 0.21
    hollow: float = -0.2
    edge: float = 4.5
    shaped_misfit: float = 0.8
    same: float = 0.5
    changed: float = 0.25
    search_every: int = 64
    search_patience: int = 2
    rounds: int = 25
    refit_rounds: int = 8
    rival_rounds: int = 4
    refit_every: int = 8
    refit_patience: int = 3
    rival_gain: float = 1.0
    doubtful: float = 1.2
    worse: float = 1.3
    observed: float = 0.3
    observable_margin: float = 0.85
    margin_error: float = 0.03
    normal_error: float = 0.04
    friction_error: float = 0.04
    touching: float = 1e-6
    fit: ContactFitSettings = ContactFitSettings()
    shifts: ShiftSettings = ShiftSettings()
    keys: KeySettings = KeySettings()
    starts: StartSettings = StartSettings()
