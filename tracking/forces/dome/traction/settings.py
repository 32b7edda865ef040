"""Tuned parameters of the reconstructor `traction`, each with its unit and effect."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class TractionFitSettings:
    """Tuned parameters of the fit of tractions.

    Attributes
    ----------
    amplitude: prior standard deviation of tractions over Young's modulus
    length: prior correlation length of tractions over the radius; longer gives smoother ones
    rough: share of the prior variance that is not smooth
    focus: prior standard deviation of a common change of all log sizes of a layer
    least_pressure: share of the largest pressure below which a node leaves the zone
    weak_pressure: share of it below which a node with more friction than `largest_ratio` leaves
    largest_ratio: largest plausible ratio of friction to pressure
    around: number of pairs of a group, whose median squared shift is compared with noise
    touched: median squared shift of a group, over the usual one, above which something touches
    clearly: such a value above which this is certain
    joining: share of the largest pressure above which a node next to the zone joins it
    rounds, few_rounds: largest number of Gauss–Newton rounds, from rest and from the last frame
    changes, few_changes: largest number of changes of the zone in a round, for the same two
    settled: norm of the change of all whitened shifts below which rounds end; the derivatives at
        rest are wrong by a tenth of it
    stuck: share of the previous misfit above which rounds end, if the misfit is large
    large: misfit above which it is large and cannot be explained
    kept_priors: number of zones whose prior is cached; more take memory, fewer take time
    odd: RMS residual of a pair above which its weight is reduced [standard deviations, and over
        that of the pairs around it]
    noisier: noise of a pair, over that in the first frame, above which its weight is reduced
    moved: share of the largest squared shift of a pair, above which nodes under it may be touched
    under: distance of such nodes from the pair [pitches of the nodes]
    lowest_level, highest_level: bounds of the variance of noise and model over the tracker's
    elsewhere: median squared residual of a group above which the fit starts from rest again
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
    """Tuned parameters of the surface that splits forces into normal force and friction.

    Attributes
    ----------
    beside: distance up to which nodes are neighbours [pitches]
    softness: indentation of an object per pressure [m³/N], for 250 kPa; objects of 60 kPa to 1 MPa
        have a quarter to four times as much
    roughness: standard deviation of the skin from a surface of two curvatures [m]
    height: prior standard deviation of its height over the radius
    slope: prior standard deviation of its slopes
    curve: prior standard deviation of its curvatures times the radius
    sharpest: largest curvature times the radius
    upright: lower bound of 1 − g·z, which limits the slope towards the side of the surface
    passes: number of times that forces are split and the surface is fitted
    rounds: number of rounds of that fit
    least_pressure: smallest pressure of a node in the fit, as a share of the largest
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
    """Tuned parameters of the estimate of µ.

    Attributes
    ----------
    smooth: distance over which forces are smoothed before their ratio, over the radius
    rounds: number of rounds that determine µ and the slipping part from each other
    fewest_nodes: smallest number of nodes of that part
    least_error: smallest relative error of µ
    sticking_error, sticking_power: relative error at Γ = 1, and the power of Γ it falls with
    narrow_error: relative error of a contact that is all rim, falling with the cube of the rim's
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
    """Tuned parameters for the effect of a calibration's uncertain silicone.

    Attributes
    ----------
    highest_poisson: largest ν for which the elasticity is solved
    changed: change of ΣFn, or of a component of the friction, as a share of ΣFn, after which
        derivatives are computed again
    moved: such a change of the contact's position, over the radius
    """

    highest_poisson: float = 0.494
    changed: float = 0.1
    moved: float = 0.02


@dataclass(frozen=True, kw_only=True)
class TractionSettings:
    """Tuned parameters of `TractionReading`; errors are standard deviations.

    Attributes
    ----------
    least_markers: smallest number of visible pairs
    reach: largest angle from the apex of the pairs that are used [rad]
    prepared: largest angle of the nodes prepared before the first frame [rad]; more take memory
    misfit: mean squared residual above which a frame may be refused [variances]
    residual_share: share of the shifts that tractions must also leave unexplained
    usual_friction: µ before one has been observed
    unseen_error: relative error of µ while it is not observable
    observed: relative error of µ below which it is observable
    observable_margin: margin Γ above which µ is not observable
    rim_error: error of ΣFn due to the unknown surface, over ΣFn and the squared share of the rim
    misfit_error: error of ΣFn over ΣFn and the misfit in excess of noise
    normal_error: smallest relative error of ΣFn
    stiffening_error: relative error of ΣFn per share that stiffening adds
    depth_error: relative error of ΣFn per depth of the press in thicknesses, as real silicone moves
        its markers more than linear silicone
    friction_error: smallest relative error of ΣFf
    tilt_error: error of force across the normals, over the force that stiffening adds
    margin_error: smallest error of Γ
    arm: smallest error of the position of the normal force over the radius
    rim_arm: its increase per squared share of the rim
    fit, skin, slip, silicone: settings of the parts of the method
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
