"""Observers: make a GripObservation from tracks, or from the model's true forces."""

import math
from copy import copy, deepcopy
from dataclasses import replace
from typing import Self

import numpy as np

from ..by_name import Choice, blaming, name_of
from ..control import GripObservation
from ..model import Fingertip, ForceField
from ..tracking import (
    CAMERA_RULE,
    THESIS_RULE,
    Z90,
    FrictionEstimate,
    FrictionRule,
    NoEstimateError,
    SensorCalibration,
    Tracks,
    load_reconstructor,
)
from ..tracking.forces import DOME_METHODS, name_used, untouched_field


class TruthObserver:
    """Takes forces and displacement from the model; estimates µ as in the thesis (Eq. 8).

    Parameters
    ----------
    window: moving average of the friction estimate [s]
    margin_noise: standard deviation of white noise on Γ (default 0); it is added to the friction
        forces, not to µ
    seed: seed of the noise (default 0)
    """

    def __init__(self, window: float, margin_noise: float = 0.0, seed: int = 0) -> None:
        self._friction = FrictionEstimate(THESIS_RULE, window)
        self._noise = margin_noise
        stream = 7  # number of the random stream of the noise on Γ, among those of a seed
        self._random = np.random.default_rng([seed, stream])

    def observe(
        self, time: float, field: ForceField, lateral_displacement: float
    ) -> GripObservation:
        """Observe the true contact forces at a time [s], and the lateral displacement [m]."""
        observation = _observation(time, field, self._friction, lateral_displacement)
        if self._noise == 0.0 or math.isnan(observation.margin):
            return observation
        return _with_margin_noise(observation, self._noise, float(self._random.standard_normal()))

    def copied(self) -> Self:
        """Observer that goes on from here by itself."""
        other = copy(self)
        other._friction, other._random = copy(self._friction), deepcopy(self._random)
        return other


def _with_margin_noise(
    observation: GripObservation, deviation: float, drawn: float
) -> GripObservation:
    """Add an error to the friction forces, which shifts Γ by deviation·drawn.

    Nodes share the error in proportion to their Fn. Near Γ = 1 the sum may change its sign.
    """
    field, mu = observation.field, observation.friction
    whole, size = field.net_friction, field.total_friction
    side = whole / size if size > 0.0 else np.eye(len(whole))[0]
    share = np.where(field.contact, field.normal, 0.0)
    spread = np.outer(mu * share * deviation, side).reshape(field.friction.shape)
    covariance = np.diag([0.0, (mu * field.total_normal * deviation) ** 2])
    noisy = replace(field, friction=field.friction - drawn * spread, totals_covariance=covariance)
    margin = noisy.safety_margin(mu)
    interval = (margin - Z90 * deviation, margin + Z90 * deviation)
    return replace(observation, field=noisy, margin=margin, margin_interval=interval)


class ForceObserver:
    """Estimates forces and friction from the tracks of one specimen, frame after frame.

    Parameters
    ----------
    calibration: calibration of the sensor
    rest: tracks of the unloaded sensor
    reconstructor: see `load_reconstructor`
    window: moving average of the friction estimate [s]
    rule: rule that estimates µ from a field
    """

    def __init__(
        self,
        calibration: SensorCalibration,
        rest: Tracks,
        reconstructor: Choice,
        window: float,
        rule: FrictionRule = CAMERA_RULE,
    ) -> None:
        self._failure = f"reconstructor {name_of(reconstructor)} failed"
        with blaming(self._failure, SystemExit):
            self._forces = load_reconstructor(reconstructor)(calibration, rest)
        self._friction = FrictionEstimate(rule, window)
        name = name_used(reconstructor, calibration)
        self._empty = (
            untouched_field(calibration.sensor.dome, math.inf)
            if name in DOME_METHODS
            else _no_chain_field(calibration.fingertip)
        )
        self._stiffness_deviation = calibration.stiffness_deviation

    def observe(self, time: float, tracks: Tracks) -> GripObservation:
        """Estimate forces and friction from a frame's tracks.

        If forces cannot be estimated, the field is empty, Γ is NaN, and `no_estimate` has the
        reason.
        """
        reason = ""
        try:
            with blaming(self._failure, SystemExit):
                field = self._forces.update(tracks)
            field = _with_stiffness_deviation(field, self._stiffness_deviation)
        except NoEstimateError as error:
            field, reason = self._empty, str(error)
        return _observation(time, field, self._friction, math.nan, reason)

    def copied(self) -> Self:
        """Observer that goes on from here by itself."""
        other = copy(self)
        other._friction, other._forces = copy(self._friction), deepcopy(self._forces)
        return other


def _observation(
    time: float,
    field: ForceField,
    friction: FrictionEstimate,
    lateral_displacement: float,
    no_estimate: str = "",
) -> GripObservation:
    mu, interval = friction.update(time, field)
    margin = field.safety_margin(mu)
    deviation = _friction_deviation(field, mu, interval)
    direction, out_of_plane, twist = _direction(field)
    return GripObservation(
        time=time,
        field=field,
        friction=mu,
        friction_interval=interval,
        friction_observable=friction.observable,
        margin=margin,
        margin_interval=margin_interval(field, mu, deviation),
        lateral_displacement=lateral_displacement,
        no_estimate=no_estimate,
        direction=direction,
        out_of_plane=out_of_plane,
        twist=twist,
    )


def _friction_deviation(field: ForceField, mu: float, interval: tuple[float, float]) -> float:
    """Standard deviation of µ from its 90 % interval."""
    low, high = interval
    if field.friction_reading is not None and field.friction_reading.logarithmic:
        return mu * math.log(high / low) / (2.0 * Z90)
    return (high - low) / (2.0 * Z90)


def _direction(field: ForceField) -> tuple[float, float, float]:
    """Azimuth of the friction on the sensor [rad], share out of its plane, and twist [rad]."""
    plane = field.plane
    if plane is None or not field.contact.any():
        return math.nan, math.nan, math.nan
    backwards = field.friction[field.contact].sum() < 0.0
    azimuth = plane.azimuth + (math.pi if backwards else 0.0)
    return math.remainder(azimuth, 2.0 * math.pi), plane.out_of_plane, plane.twist


def margin_interval(field: ForceField, mu: float, mu_deviation: float) -> tuple[float, float]:
    """90 % interval of Γ.

    Γ = 1 − ΣFf/(µ·ΣFn) falls faster as µ falls. On a dome µ is often uncertain, and its error is
    treated as an error of its logarithm.
    """
    margin = field.safety_margin(mu)
    spread = Z90 * margin_deviation(field, mu, mu_deviation)
    # Largest half-width of the interval of ln µ that skews the interval of Γ: about the prior's.
    most_doubt = 1.0
    doubt = min(Z90 * mu_deviation / mu, most_doubt) if mu > 0.0 else 0.0
    if field.directions is None or field.friction_reading is None or not doubt > 0.0:
        return margin - spread, margin + spread
    return margin - spread * math.expm1(doubt) / doubt, margin - spread * math.expm1(-doubt) / doubt


def margin_deviation(field: ForceField, mu: float, mu_deviation: float) -> float:
    """Standard deviation of Γ from those of ΣFn, ΣFf and µ, to first order.

    An error of a µ that was estimated together with the sums is correlated with theirs. The result
    is NaN if Γ is, and infinite if the deviation of a sum is.
    """
    normal, friction = field.total_normal, field.total_friction
    if not (normal > 0.0 and mu > 0.0):
        return math.nan
    if not np.isfinite(field.totals_covariance).all():
        return math.inf
    reading = field.friction_reading
    slope = np.array([friction / normal, -1.0, friction / mu]) / (mu * normal)

    def variance(deviation: float) -> float:
        """Variance of Γ for a standard deviation of µ."""
        covariance = np.zeros((3, 3))
        covariance[:2, :2] = field.totals_covariance
        covariance[2, 2] = deviation**2
        if reading is not None:
            shared = min(deviation / reading.deviation, 1.0) * np.array(reading.totals_covariance)
            covariance[2, :2] = covariance[:2, 2] = shared
        return max(float(slope @ covariance @ slope), 0.0)

    if reading is None or math.isnan(reading.margin_deviation):
        return math.sqrt(variance(mu_deviation))
    # Add the variance by which the averaged µ is less certain than the one used in training.
    more = max(variance(mu_deviation) - variance(reading.deviation), 0.0)
    return math.sqrt(reading.margin_deviation**2 + more)


def _with_stiffness_deviation(field: ForceField, deviation: float) -> ForceField:
    """Add the relative deviation of the calibration's stiffnesses to that of the sums."""
    if deviation == 0.0:
        return field
    totals = deviation * np.array([field.total_normal, field.total_friction])
    added = np.outer(totals, totals)
    # Correlation of the errors of ΣFn and ΣFf from wrong stiffnesses: the tissue's scale both
    # alike, the membrane's do not.
    correlation = 0.95
    added *= [[1.0, correlation], [correlation, 1.0]]
    wrench = field.wrench_covariance
    if wrench is not None:
        wrench = wrench + deviation**2 * np.outer(field.wrench, field.wrench)
    return replace(
        field, totals_covariance=field.totals_covariance + added, wrench_covariance=wrench
    )


def _no_chain_field(fingertip: Fingertip) -> ForceField:
    n = fingertip.nodes
    return ForceField(
        position=fingertip.rest_positions(),
        normal=np.zeros(n),
        friction=np.zeros(n),
        contact=np.zeros(n, dtype=bool),
        totals_covariance=np.full((2, 2), np.inf),
    )
