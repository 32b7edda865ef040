"""From a frame (camera path) or from the model itself (truth path) to a GripObservation."""

import math
from dataclasses import replace

import numpy as np

from ..by_name import Choice
from ..control import GripObservation
from ..model import Fingertip, ForceField
from ..render import Frame
from ..tracking import (
    CAMERA_RULE,
    THESIS_RULE,
    Z90,
    FrictionEstimate,
    FrictionRule,
    NoEstimateError,
    Palette,
    SensorCalibration,
    Tracks,
    load_reconstructor,
    load_tracker,
)

#: Correlation of the sums' errors where stiffnesses are off: the tissue's turn both alike, the
#: membrane's do not.
_ALIKE = 0.95
#: µ that is put off is no less.
_LEAST_FRICTION = 0.01
#: Marks the random numbers of the truth path's noise among those of a seed.
_MARGIN_NOISE = 7


class TruthObserver:
    """Reads forces and displacement off the model; µ by the thesis's own estimator (Eq. 8).

    Parameters
    ----------
    window: moving average of the friction estimate [s]
    margin_noise: standard deviation of white noise on Γ, as wrong friction forces; µ is left alone
    seed: of the noise
    """

    def __init__(self, window: float, margin_noise: float = 0.0, seed: int = 0) -> None:
        self._friction = FrictionEstimate(THESIS_RULE, window)
        self._noise = margin_noise
        self._random = np.random.default_rng([seed, _MARGIN_NOISE])

    def observe(
        self, time: float, field: ForceField, lateral_displacement: float
    ) -> GripObservation:
        """Observation of the true contact forces."""
        seen = _observation(time, field, self._friction, lateral_displacement)
        if self._noise == 0.0 or math.isnan(seen.margin):
            return seen
        return _with_margin_noise(seen, self._noise, float(self._random.standard_normal()))


def _with_margin_noise(seen: GripObservation, sigma: float, drawn: float) -> GripObservation:
    """The observation with friction forces that are wrong by what puts the margin off by σ·drawn.

    Nodes share the error as they share ΣFn; near Γ = 1 the sum may change its sign.
    """
    field = seen.field
    side = 1.0 if field.friction[field.contact].sum() >= 0.0 else -1.0
    share = np.where(field.contact, field.normal, 0.0)
    spread = side * seen.friction * share * sigma
    covariance = np.diag([0.0, (seen.friction * field.total_normal * sigma) ** 2])
    noisy = replace(field, friction=field.friction - drawn * spread, totals_covariance=covariance)
    margin = noisy.safety_margin(seen.friction)
    interval = (margin - Z90 * sigma, margin + Z90 * sigma)
    return replace(seen, field=noisy, margin=margin, margin_interval=interval)


class ForceObserver:
    """Reads forces and friction off the tracks of one specimen, frame after frame.

    Parameters
    ----------
    calibration: of the sensor
    rest: tracks of the unloaded sensor
    reconstructor: see `load_reconstructor`
    window: moving average of the friction estimate [s]
    rule: how µ is read off a field
    """

    def __init__(
        self,
        calibration: SensorCalibration,
        rest: Tracks,
        reconstructor: Choice,
        window: float,
        rule: FrictionRule = CAMERA_RULE,
    ) -> None:
        self._forces = load_reconstructor(reconstructor)(calibration, rest)
        self._friction = FrictionEstimate(rule, window)
        self._fingertip = calibration.fingertip
        self._stiffness_deviation = calibration.stiffness_deviation

    def observe(self, time: float, tracks: Tracks) -> GripObservation:
        """Observation of a frame's tracks.

        Where they say nothing of the forces, the observation says so: an empty field, a margin of
        NaN, and the reason.
        """
        reason = ""
        try:
            field = _as_sure(self._forces.update(tracks), self._stiffness_deviation)
        except NoEstimateError as error:
            field, reason = _empty_field(self._fingertip), str(error)
        return _observation(time, field, self._friction, math.nan, reason)


def with_friction_off(seen: GripObservation, bias: float) -> GripObservation:
    """The observation with µ that is off by so much, 0.01 at least, and Γ that goes with it."""
    if bias == 0.0 or math.isnan(seen.margin):
        return seen
    mu = max(seen.friction + bias, _LEAST_FRICTION)
    margin = seen.field.safety_margin(mu)
    low, high = (value + mu - seen.friction for value in seen.friction_interval)
    margin_low, margin_high = (value + margin - seen.margin for value in seen.margin_interval)
    return replace(
        seen,
        friction=mu,
        friction_interval=(low, high),
        margin=margin,
        margin_interval=(margin_low, margin_high),
    )


class CameraObserver:
    """Reads forces and friction off camera frames; knows only pixels and the calibration.

    Parameters
    ----------
    calibration: of the sensor
    tracker: see `load_tracker`
    reconstructor: see `load_reconstructor`
    noise: camera noise, from its data sheet [grey levels]
    window: moving average of the friction estimate [s]
    rest: frames of the unloaded sensor
    """

    def __init__(
        self,
        calibration: SensorCalibration,
        tracker: Choice,
        reconstructor: Choice,
        noise: float,
        window: float,
        rest: list[Frame],
    ) -> None:
        self._tracker = load_tracker(tracker)(Palette.of_sensor(calibration.sensor), noise)
        #: Tracks of the rest frames, from which displacements are counted.
        self.rest: Tracks = self._tracker.reset(rest)
        self._forces = ForceObserver(calibration, self.rest, reconstructor, window)

    def observe(self, frame: Frame) -> tuple[GripObservation, Tracks]:
        """Observation of a frame, and the tracks it rests on."""
        tracks = self._tracker.update(frame)
        return self._forces.observe(frame.time, tracks), tracks


def _observation(
    time: float,
    field: ForceField,
    friction: FrictionEstimate,
    lateral_displacement: float,
    no_estimate: str = "",
) -> GripObservation:
    mu, interval = friction.update(time, field)
    margin = field.safety_margin(mu)
    spread = Z90 * margin_deviation(field, mu, (interval[1] - interval[0]) / (2 * Z90))
    return GripObservation(
        time=time,
        field=field,
        friction=mu,
        friction_interval=interval,
        friction_observable=friction.observable,
        margin=margin,
        margin_interval=(margin - spread, margin + spread),
        lateral_displacement=lateral_displacement,
        no_estimate=no_estimate,
    )


def margin_deviation(field: ForceField, mu: float, mu_deviation: float) -> float:
    """Standard deviation of Γ from those of ΣFn, ΣFf and µ, to first order.

    Where µ was read together with the sums, it errs together with them too.
    """
    normal, friction = field.total_normal, field.total_friction
    if not normal > 0.0:
        return math.nan
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = field.totals_covariance
    covariance[2, 2] = mu_deviation**2
    reading = field.friction_reading
    if reading is not None:
        shared = min(mu_deviation / reading.deviation, 1.0) * np.array(reading.totals_covariance)
        covariance[2, :2] = covariance[:2, 2] = shared
    slope = np.array([friction / normal, -1.0, friction / mu]) / (mu * normal)
    return math.sqrt(max(float(slope @ covariance @ slope), 0.0))


def _as_sure(field: ForceField, stiffness_deviation: float) -> ForceField:
    """Field whose sums are no surer than the stiffnesses they were read with."""
    totals = stiffness_deviation * np.array([field.total_normal, field.total_friction])
    more = np.outer(totals, totals) * [[1.0, _ALIKE], [_ALIKE, 1.0]]
    return replace(field, totals_covariance=field.totals_covariance + more)


def _empty_field(fingertip: Fingertip) -> ForceField:
    n = fingertip.nodes
    return ForceField(
        position=fingertip.rest_positions(),
        normal=np.zeros(n),
        friction=np.zeros(n),
        contact=np.zeros(n, dtype=bool),
        totals_covariance=np.full((2, 2), np.inf),
    )
