"""Reconstructors with a trained read-out, from single frames or averaged over time."""

import math
from copy import copy
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ....errors import UserError
from ....model import ForceField, FrictionReading
from ...tracks import Tracks
from ..calibration import SensorCalibration, required_readout
from ..friction import OBSERVABLE_MARGIN
from ..reconstructors import NoEstimateError
from ..shifts import MarkerShifts
from .codes import CONTEXT, Codes, Kept, fit_codes, trained_codes
from .readout import BEND, ReadOut, forward, linear_sums, linearised, load_readout
from .settings import LearnedSettings
from .specimen import read_specimen

Array = NDArray[np.float64]
#: Array in single or double precision.
Numbers = NDArray[np.floating]

#: Candidate variances of a code's change per frame, in units of its usual variance.
_ACTIVITIES = np.concatenate([[0.0], np.logspace(-9.0, 0.0, 19)])


@dataclass(frozen=True, kw_only=True)
class Average:
    """Average of the codes over frames in which the skin does not move.

    Attributes
    ----------
    codes: averaged codes, shape (K,)
    variance: variance of each, without errors that are the same in every frame, shape (K,)
    """

    codes: Array
    variance: Array

    def after(self, codes: Codes, rates: Array) -> "Average":
        """Update the average by the codes of the next frame, with a Kalman filter for each code.

        The change of the codes per frame is the most likely one of _ACTIVITIES. Codes with little
        noise determine it, and the others are averaged accordingly.

        Parameters
        ----------
        codes: codes of the frame
        rates: relative rates of change of the codes, shape (K,)
        """
        noise, change = codes.variance - codes.constant_variance, codes.value - self.codes
        expected = self.variance + noise + np.outer(_ACTIVITIES, rates)
        likelihood = (change**2 / expected + np.log(expected)).sum(axis=1)
        before = self.variance + _ACTIVITIES[likelihood.argmin()] * rates
        gain = before / (before + noise)
        return Average(codes=self.codes + gain * change, variance=before * (1.0 - gain))


@dataclass(frozen=True, kw_only=True)
class Memory:
    """State between frames: values kept by `fit_codes`, and the average of codes."""

    kept: Kept | None = None
    average: Average | None = None


@dataclass(frozen=True, kw_only=True)
class Totals:
    """Estimate of a frame's sums by a read-out.

    Attributes
    ----------
    normal: ΣFn [N]
    friction: signed ΣFf [N]
    mu: friction coefficient µ
    covariance: covariance of (ΣFn, |ΣFf|, µ), shape (3, 3)
    margin_deviation: standard deviation of Γ
    """

    normal: float
    friction: float
    mu: float
    covariance: Array
    margin_deviation: float


class Learned:
    """Estimates ΣFn, ΣFf, µ and a matching force field by a trained read-out.

    Parameters
    ----------
    calibration: calibration of the sensor, with a read-out
    rest: tracks of the unloaded sensor
    averaged: whether to average codes while the skin does not move, else use single frames
    settings: tuned parameters
    """

    def __init__(
        self,
        calibration: SensorCalibration,
        rest: Tracks,
        *,
        averaged: bool = True,
        settings: LearnedSettings = LearnedSettings(),
    ) -> None:
        self._settings = settings
        path, tip = required_readout(calibration), calibration.fingertip
        readout = load_readout(path)
        nodes = readout.modes.shape[1]
        if tip.law != "split" or tip.nodes != nodes:
            raise UserError(
                f"{path.name} was trained on a split chain of {nodes} nodes, the calibration has a "
                f"{tip.law} one of {tip.nodes}"
            )
        self._fingertip, self._readout, self._averaged = tip, readout, averaged
        self._specimen = read_specimen(readout, MarkerShifts(calibration, rest, np.pi))
        #: Displacement of the chain for each code and 1 [m], shape (K + 1, 2N).
        self._displacement = (
            readout.amounts @ readout.modes.reshape(len(readout.modes), -1)
        ).astype(np.float32)
        self._at_rest, self._threshold = tip.rest_positions(), tip.contact_threshold
        self._memory = Memory()

    def __deepcopy__(self, memo: dict[int, object]) -> Self:
        """Independent copy; it is shallow, as nothing is changed in place."""
        return copy(self)

    def reset(self) -> None:
        """Forget previous frames, except for weights, which depend only on the noise."""
        self._memory = replace(self._memory, average=None)

    def update(self, tracks: Tracks) -> ForceField:
        """Estimate the force field of a frame, from it alone or with previous ones.

        Raises
        ------
        NoEstimateError
            When too few pairs of the design are visible.
        NoEstimateError
            When no trained press explains them, or ΣFn is not determined.
        """
        settings = self._settings
        before = self._memory
        self.reset()
        if tracks.compression > settings.compressed:
            raise NoEstimateError(
                f"compressed too much to read forces: markers are {tracks.compression:.1f} times "
                f"less certain than noise makes them, {settings.compressed:g} times at most is "
                "allowed; record H.264 at crf <= 12, or pictures without loss"
            )
        fit, kept = fit_codes(self._specimen, before.kept, tracks, settings.codes)
        self._memory = Memory(kept=kept)
        codes = trained_codes(self._specimen, fit, kept.noise, settings.codes)
        if self._averaged:
            noise = codes.variance - codes.constant_variance
            average = Average(codes=codes.value, variance=noise)
            if before.average is not None:
                average = before.average.after(codes, self._readout.rates)
            self._memory = Memory(kept=kept, average=average)
            variance = average.variance + codes.constant_variance
            codes = replace(codes, value=average.codes, variance=variance)
        _check_trained(self._readout, codes, settings.slack)
        # Noise matters in the weak codes, which come last.
        weak = codes.variance[len(codes.variance) // 2 :]
        level = math.exp(0.5 * float(np.log(weak).mean()))
        x = self._readout.inputs(codes.value, level, codes.context)
        # Forces scale with the stiffness relative to the fingertip used in training.
        stiffness = self._fingertip.tissue_stiffness / self._readout.tissue_stiffness
        totals = _read_totals(self._readout, codes, x, stiffness, settings)
        displacement = np.append(codes.value, 1.0).astype(np.float32) @ self._displacement
        position = self._at_rest + displacement.reshape(-1, 2)
        field = _force_field(self._readout, self._threshold, totals, x, position, settings)
        return replace(field, plane=codes.plane)


def _check_trained(readout: ReadOut, codes: Codes, slack: float) -> None:
    """Refuse a frame outside the training range.

    Raises
    ------
    NoEstimateError
        With the value that is too large.
    """
    over = codes.context - readout.context[2]
    worst = int(over.argmax())
    if over[worst] > slack:
        raise NoEstimateError(
            f"the markers move as no trained press moves them: {CONTEXT[worst]} is "
            f"{math.exp(0.5 * over[worst]):.1f} times what it was in training"
        )
    reach = float(readout.size_of(codes.value)) / readout.reach
    if reach > 1.0 + slack:
        raise NoEstimateError(
            f"the skin has moved {reach:.1f} times as far as in the hardest trained press"
        )


def _read_totals(
    readout: ReadOut, codes: Codes, x: Numbers, stiffness: float, settings: LearnedSettings
) -> Totals:
    """Estimate sums and µ from codes.

    Parameters
    ----------
    readout: read-out
    codes: codes of the frame
    x: input of the networks, see `network_inputs`
    stiffness: stiffness of the fingertip over that used in training
    settings: tuned parameters

    Raises
    ------
    NoEstimateError
        When the codes do not determine ΣFn.
    """
    short = x.astype(np.float32)
    # Propagate noise beyond that in training through the network's derivative.
    noisier = bool(codes.excess.any())
    if noisier:
        output, by_input = linearised(readout.totals, short)
    else:
        output = forward(readout.totals, short)
    middle, scale = readout.targets
    totals = middle + scale * output
    totals[:2] += linear_sums(readout.sums, codes.value)
    deviations = np.exp(0.5 * forward(readout.deviations, short).astype(float))
    covariance = np.outer(deviations[:3], deviations[:3]) * readout.correlation
    if noisier:
        slope = readout.slope(codes.value, by_input)
        covariance += slope @ codes.excess @ slope.T
    most = settings.largest
    normal, friction = (
        BEND * math.sinh(min(max(float(value), -most), most)) for value in totals[:2]
    )
    mu = max(math.exp(min(float(totals[2]), 1.0)), settings.smallest_friction)
    # Convert to newtons, and to |ΣFf|.
    side = 1.0 if friction >= 0.0 else -1.0
    unit = stiffness * np.array([math.hypot(normal, BEND), side * math.hypot(friction, BEND), 0.0])
    # An image cannot make µ less certain than the prior.
    unit[2] = mu / math.hypot(1.0, math.sqrt(covariance[2, 2]) / readout.prior)
    covariance *= np.outer(unit, unit)
    deviation = math.sqrt(covariance[0, 0])
    if deviation > settings.vague_share * abs(normal) + settings.vague:
        raise NoEstimateError(
            f"the markers leave ΣFn open: {normal:.1f} N with a deviation of {deviation:.1f} N"
        )
    return Totals(
        normal=stiffness * normal,
        friction=stiffness * friction,
        mu=mu,
        covariance=covariance,
        margin_deviation=float(deviations[3]),
    )


def _force_field(
    readout: ReadOut,
    threshold: Array,
    totals: Totals,
    x: Numbers,
    position: Array,
    settings: LearnedSettings,
) -> ForceField:
    """Make a force field with these sums, at deformed positions (N, 2) [m].

    Nodes are in contact above a threshold (N,) [N].
    """
    normal, friction, mu = totals.normal, totals.friction, totals.mu
    shapes = forward(readout.shapes, x.astype(np.float32))
    half = len(shapes) // 2
    press = np.append(1.0, shapes[:half]) @ readout.normal_shapes
    drag = np.append(1.0, shapes[half:]) @ readout.friction_shapes
    press = np.maximum(press, 0.0)
    touching = normal > settings.no_contact
    pressing = normal * press / press.sum() if touching else np.zeros(len(position))
    contact = pressing > threshold
    touches = bool(contact.any())
    if touches:
        pressing *= contact * (normal / pressing[contact].sum())
        dragging = normal * drag * contact
        # Correct the shapes to the sums, which are more precise.
        dragging += (friction - dragging.sum()) * pressing / normal
    else:
        dragging = np.zeros(len(position))
    deviation = math.sqrt(totals.covariance[2, 2])
    # A pure press hardly determines µ, and only through the friction law used in training.
    slips = touches and 1.0 - abs(friction) / (mu * normal) < OBSERVABLE_MARGIN
    return ForceField(
        position=position,
        normal=pressing,
        friction=dragging,
        contact=contact,
        totals_covariance=totals.covariance[:2, :2],
        friction_reading=FrictionReading(
            value=mu,
            deviation=deviation,
            observable=slips and deviation < settings.observable * readout.prior * mu,
            totals_covariance=(float(totals.covariance[0, 2]), float(totals.covariance[1, 2])),
            margin_deviation=totals.margin_deviation,
        ),
    )
