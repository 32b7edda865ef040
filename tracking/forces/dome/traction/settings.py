"""Tuned numbers of the reconstructor `traction`, each with its unit and effect."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class TractionFitSettings:
    """Tuned numbers of the fit of tractions.

    Attributes
    ----------
    amplitude: prior deviation of tractions over Young's modulus
    length: prior correlation length of tractions over the radius; longer gives smoother ones
    rough: share of the prior variance that is not smooth
    focus: prior deviation of a common change of all log sizes of a layer
    least_pressure: share of the largest pressure below which a node leaves the zone
    weak_pressure: share of it below which a node with more friction than `largest_ratio` leaves
    largest_ratio: ratio of friction to pressure that no surface has
    around: number of pairs whose energy is compared with noise together
    touched: median energy of such pairs, over the usual one, above which something touches
    clearly: the same beyond doubt
    joining: share of the largest pressure above which a node next to the zone joins it
    rounds, few_rounds: largest number of rounds of Gauss–Newton, from rest and from the last frame
    changes, few_changes: largest number of changes of the zone in a round, for the same two
    settled: size of the change of all whitened shifts below which rounds end; the derivative at
        rest is off by a tenth of it
    stuck: share of the misfit of the round before above which rounds end, if it is large
    large: misfit that is large; nothing will explain it
    kept_priors: number of zones whose prior is kept; more take memory, fewer time
    odd: root mean square of a pair's residuals above which it weighs less [deviations], and over
        that of the pairs around it
    noisier: noise of a pair, over that in the first frame, above which it weighs less
    moved: share of the largest energy of a pair's shift above which nodes under it may be touched
    under: distance of such nodes from the pair [pitches of the nodes]
    lowest_level, highest_level: bounds of the variance of noise and model over the tracker's
    elsewhere: median energy of a group of residuals above which the fit starts from rest again
    most_pairs: largest number of pairs whose nodes are considered from rest
    fewest_nodes, most_nodes: bounds of the number of nodes in contact
    """

    amplitude: float = 0.25
    length: float = 0.1
    rough: float = 1e-4
    focus: float = 3e-3
    least_pressure: float = 0.0
    weak_pressure: float = 0.1
    largest_ratio: float = 2.0
    around: int = 7
    touched: float = 4.0
    clearly: float = 100.0
    joining: float = 0.02
    rounds: int = 12
    few_rounds: int = 3
    changes: int = 6
    few_changes: int = 3
    settled: float = 25.0
    stuck: float = 0.8
    large: float = 8.0
    kept_priors: int = 8
    odd: float = 2.5
    noisier: float = 1.4
    moved: float = 0.1
    under: float = 3.0
    lowest_level: float = 1.0
    highest_level: float = 30.0
    elsewhere: float = 100.0
    most_pairs: int = 60
    fewest_nodes: int = 4
    most_nodes: int = 450


@dataclass(frozen=True, kw_only=True)
class SkinSettings:
    """Tuned numbers of the surface that parts forces into normal force and friction.

    Attributes
    ----------
    beside: distance up to which nodes are next to each other [pitches]
    softness: depth of an object per pressure [m³/N], here of one of 250 kPa; objects of 60 kPa to
        1 MPa have a quarter to four times as much
    roughness: deviation of the skin from a surface of two curvatures [m]
    height: prior deviation of height over the radius
    slope: prior deviation of slopes
    curve: prior deviation of curvatures times the radius
    sharpest: largest curvature times the radius
    upright: least slope of the surface towards its side
    passes: number of times that forces are parted and the surface is fitted
    rounds: number of rounds of that fit
    least_pressure: share of the largest pressure that a node has at least in the fit
    """

    beside: float = 1.6
    softness: float = 0.8e-9
    roughness: float = 20e-6
    height: float = 0.1
    slope: float = 0.5
    curve: float = 3.0
    sharpest: float = 4.0
    upright: float = 0.2
    passes: int = 2
    rounds: int = 3
    least_pressure: float = 0.01


@dataclass(frozen=True, kw_only=True)
class SlipSettings:
    """Tuned numbers of the estimate of µ.

    Attributes
    ----------
    smooth: distance over which forces are smoothed before their ratio, over the radius
    rounds: number of rounds that find µ and the slipping part from each other
    fewest_nodes: smallest number of nodes of that part
    least_error: smallest relative deviation of µ
    sticking_error, sticking_power: relative deviation at Γ = 1, and the power of Γ it falls with
    narrow_error: relative deviation of a contact that is all rim, falling with the cube of its
        share
    smallest, largest: bounds of µ
    """

    smooth: float = 0.035
    rounds: int = 20
    fewest_nodes: int = 3
    least_error: float = 0.04
    sticking_error: float = 0.3
    sticking_power: float = 1.1
    narrow_error: float = 6.0
    smallest: float = 0.02
    largest: float = 3.0


@dataclass(frozen=True, kw_only=True)
class UnsureSettings:
    """Tuned numbers for the covariance of a calibration's silicone.

    Attributes
    ----------
    highest_poisson: highest ν whose elasticity is solved for
    changed: change of ΣFn, or of a component of the friction, as a share of ΣFn, after which slopes
        are computed again
    moved: the same of the place of the contact, over the radius
    """

    highest_poisson: float = 0.494
    changed: float = 0.1
    moved: float = 0.02


@dataclass(frozen=True, kw_only=True)
class TractionSettings:
    """Tuned numbers of `TractionReading`; errors are standard deviations.

    Attributes
    ----------
    least_markers: number of visible pairs below which no tractions are determined
    reach: largest angle from the apex of the pairs that are read [rad]
    prepared: largest angle of the nodes prepared before the first frame [rad]; more take memory
    misfit: mean squared residual above which a frame may be refused [squared deviations]
    residual_share: share of the shifts that tractions must also leave unexplained
    usual_friction: µ before one has been observed
    unseen_error: relative error of µ while it is not observable
    observed: relative error of µ below which it is observable
    observable_margin: Γ from which on µ is not observable
    rim_error: error of ΣFn by the unknown surface, over ΣFn and the squared share of the rim
    misfit_error: the same over ΣFn and the misfit in excess of noise
    normal_error: smallest relative error of ΣFn
    stiffening_error: relative error of ΣFn per share that stiffening adds
    depth_error: the same per depth of the press in thicknesses: silicone moves its markers more
        than the linear one does
    friction_error: smallest relative error of ΣFf
    tilt_error: error of force across the normals, over the force that stiffening adds
    margin_error: smallest error of Γ
    arm: smallest error of the place of the normal force over the radius
    rim_arm: the same per squared share of the rim
    fit, skin, slip, silicone: parts of the method
    """

    least_markers: int = 40
    reach: float = math.pi / 2
    prepared: float = math.radians(28.0)
    misfit: float = 4.0
    residual_share: float = 0.02
    usual_friction: float = 0.5
    unseen_error: float = 0.4
    observed: float = 0.2
    observable_margin: float = 0.85
    rim_error: float = 0.25
    misfit_error: float = 0.05
    normal_error: float = 0.004
    stiffening_error: float = 0.1
    depth_error: float = 0.25
    friction_error: float = 0.003
    tilt_error: float = 0.006
    margin_error: float = 0.01
    arm: float = 4e-5
    rim_arm: float = 2.5e-3
    fit: TractionFitSettings = TractionFitSettings()
    skin: SkinSettings = SkinSettings()
    slip: SlipSettings = SlipSettings()
    silicone: UnsureSettings = UnsureSettings()
