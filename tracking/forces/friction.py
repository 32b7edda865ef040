"""Friction coefficient from a force field, at one instant and averaged over time.

The ratio |Ff,i|/Fn,i is µ where the skin slips, and smaller where it sticks. Noise biases the
largest ratio upwards, which is unsafe. A pure press has ratios up to the tissue's Poisson factor
(E7).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model import ForceField, FrictionReading


@dataclass(frozen=True, kw_only=True)
class FrictionSettings:
    """Tuned parameters of the estimate of µ.

    Attributes
    ----------
    core_share: share of the largest normal force above which a node belongs to the core
    core_quantile: quantile of the core's ratios that is taken as µ; noise biases the largest one
        upwards, which is unsafe
    slipping_spread: lower over upper quartile of the core's ratios, above which most of it slips
    majority: share of the averaged fields that must allow µ to fall
    """

    core_share: float = 0.3
    core_quantile: float = 0.75
    slipping_spread: float = 0.8
    majority: float = 0.5


#: Margin Γ above which too little of the contact slips for its ratios to show µ.
OBSERVABLE_MARGIN = 0.85
#: Half width of the 90 % interval of a normal distribution, in standard deviations.
Z90 = 1.645
#: Upper end of the interval of µ if only a lower bound is known.
LARGEST_FRICTION = 2.0


def max_ratio(field: ForceField) -> float:
    """µ_est = max |Ff,i|/Fn,i over the nodes in contact (thesis Eq. 8); NaN without contact."""
    if not field.contact.any():
        return math.nan
    return float(_ratios(field, np.flatnonzero(field.contact)).max())


def core_quantile(field: ForceField, settings: FrictionSettings = FrictionSettings()) -> float:
    """Upper quartile of the ratios |Ff,i|/Fn,i in the well-loaded core; NaN without contact."""
    ratios = _ratios(field, _core(field, settings))
    return float(np.quantile(ratios, settings.core_quantile)) if len(ratios) else math.nan


def mostly_slipping(field: ForceField, settings: FrictionSettings = FrictionSettings()) -> bool:
    """Whether the core's ratios are nearly equal, as when most of it slips."""
    ratios = _ratios(field, _core(field, settings))
    if not len(ratios):
        return False
    low, high = np.quantile(ratios, [1.0 - settings.core_quantile, settings.core_quantile])
    return bool(low > settings.slipping_spread * high)


def _read_out(field: ForceField) -> FrictionReading:
    """Return the reconstructor's own estimate of µ; NaN if it gives none."""
    return field.friction_reading or FrictionReading(
        value=math.nan, deviation=math.nan, observable=False
    )


def _read_largest(field: ForceField) -> FrictionReading:
    """Estimate µ by the largest ratio, of unknown error; NaN if no node has friction."""
    value = max_ratio(field) or math.nan
    observable = field.safety_margin(value) < OBSERVABLE_MARGIN
    return FrictionReading(value=value, deviation=math.nan, observable=observable)


def _read_core(field: ForceField) -> FrictionReading:
    """Estimate µ by the upper quartile of the core's ratios, of unknown error."""
    value = core_quantile(field)
    observable = field.safety_margin(value) < OBSERVABLE_MARGIN
    return FrictionReading(value=value, deviation=math.nan, observable=observable)


#: Functions that estimate µ from one field, by name.
FRICTION: dict[str, Callable[[ForceField], FrictionReading]] = {
    "max-ratio": _read_largest,
    "core-quantile": _read_core,
    "read-out": _read_out,
}


def _core(field: ForceField, settings: FrictionSettings = FrictionSettings()) -> NDArray[np.intp]:
    """Indices of the well-loaded nodes of the contact; empty without contact."""
    largest = field.normal[field.contact].max(initial=0.0)
    return np.flatnonzero(field.contact & (field.normal > settings.core_share * largest))


def _ratios(field: ForceField, nodes: NDArray[np.intp]) -> NDArray[np.float64]:
    """Ratios |Ff,i|/Fn,i of some nodes."""
    return field.friction_sizes[nodes] / field.normal[nodes]


@dataclass(frozen=True, kw_only=True)
class FrictionRule:
    """Rule for µ: its estimate from one field, and which estimates are averaged.

    Attributes
    ----------
    read: function that estimates µ from one field, see FRICTION
    may_fall: function that decides whether a field may lower µ. A grip that is raised under a
        constant load lets the skin stick again: ratios fall below µ although µ has not changed
    every: whether every field counts, not only those in which µ is observable
    """

    read: Callable[[ForceField], FrictionReading]
    may_fall: Callable[[ForceField], bool]
    every: bool = False


# Named functions, as lambdas cannot be pickled with a saved grasp.


def _always(field: ForceField) -> bool:
    return True


def _read(field: ForceField) -> FrictionReading:
    return field.friction_reading or FRICTION["core-quantile"](field)


def _may_fall(field: ForceField, settings: FrictionSettings = FrictionSettings()) -> bool:
    return field.friction_reading is not None or mostly_slipping(field, settings)


#: The thesis's rule: maximum ratio, every frame counts (Eq. 8).
THESIS_RULE = FrictionRule(read=FRICTION["max-ratio"], may_fall=_always, every=True)
#: Rule for noisy forces: the reconstructor's own estimate, else the upper quartile of the ratios;
#: held while µ is not observable.
CAMERA_RULE = FrictionRule(read=_read, may_fall=_may_fall)


@dataclass(frozen=True, kw_only=True)
class _Reading:
    """Estimate from one frame: time [s], µ, its standard deviation, whether µ may fall to it."""

    time: float
    value: float
    deviation: float
    may_fall: bool


@dataclass(frozen=True, kw_only=True)
class _Memory:
    """Averaged readings, the held µ, and whether µ was observable since the reset.

    `logarithmic`: whether the last reading is an estimate of ln µ.
    """

    readings: tuple[_Reading, ...] = ()
    kept: float = -math.inf
    observable: bool = False
    logarithmic: bool = False


@dataclass(frozen=True, kw_only=True)
class _Average:
    """Weighted mean of readings, its error by their scatter, and by their own deviations or NaN."""

    mean: float
    scatter: float
    stated: float


class FrictionEstimate:
    """Moving average of a per-frame friction estimate, held while µ is not observable.

    Parameters
    ----------
    rule: rule for µ
    window: length of the average [s]
    settings: tuned parameters
    """

    def __init__(
        self, rule: FrictionRule, window: float, settings: FrictionSettings = FrictionSettings()
    ) -> None:
        self._rule, self._settings = rule, settings
        self._window = window
        self._memory = _Memory()

    def reset(self) -> None:
        """Forget all frames."""
        self._memory = _Memory()

    @property
    def observable(self) -> bool:
        """Whether µ was observable in a frame since the reset."""
        return self._memory.observable

    def update(self, time: float, field: ForceField) -> tuple[float, tuple[float, float]]:
        """Estimate µ and its 90 % interval at `time` [s]; NaN before the first contact.

        Until µ has been observable once, the average of the ratios is reported: it saturates near
        the tissue's Poisson factor (E7) and is rather too low. As any larger µ explains the frames
        equally well, the interval extends to LARGEST_FRICTION. A reading of ln µ has its own error.
        """
        memory = self._with_reading(time, field)
        # Frame times are products of a period: allow for their rounding.
        start = time - self._window + 1e-9
        readings = memory.readings
        full = bool(readings) and readings[0].time <= start
        # Keep at least one reading, however old it is.
        first = next((k for k, r in enumerate(readings) if r.time > start), len(readings) - 1)
        readings = readings[max(first, 0) :]
        if not readings:
            self._memory = memory
            return math.nan, (math.nan, math.nan)
        weighted = all(reading.deviation > 0.0 for reading in readings)
        average = _average(readings, weighted)
        mean, kept = average.mean, memory.kept
        trusted = [reading for reading in readings if reading.may_fall]
        if len(trusted) > self._settings.majority * len(readings):
            fallen = len(trusted) < len(readings)
            mean = kept = _average(trusted, weighted).mean if fallen else average.mean
        else:
            if full:  # the first few frames are too noisy to rely on
                stated = 0.0 if math.isnan(average.stated) else average.stated
                kept = max(kept, mean - stated)
            mean = max(kept, mean)
        self._memory = replace(memory, readings=readings, kept=kept)
        # The stated error of readings is common to all frames and does not average out.
        known = [x for x in (average.scatter, average.stated) if not math.isnan(x)]
        spread = Z90 * max(known, default=math.nan)
        if memory.logarithmic:
            factor = math.exp(spread / mean)
            return mean, (mean / factor, mean * factor)
        bounded = memory.observable or self._rule.every
        return mean, (mean - spread, mean + spread if bounded else LARGEST_FRICTION)

    def _with_reading(self, time: float, field: ForceField) -> _Memory:
        """Add this frame's reading to the memory, if it counts."""
        reading, memory, every = self._rule.read(field), self._memory, self._rule.every
        if not math.isfinite(reading.value):
            return memory
        if reading.observable and not memory.observable:
            # Discard readings from before µ was observable.
            memory = replace(memory, observable=True, readings=memory.readings if every else ())
        memory = replace(memory, logarithmic=reading.logarithmic)
        if not (reading.observable or every or not memory.observable):
            return memory
        this = _Reading(
            time=time,
            value=reading.value,
            deviation=reading.deviation,
            may_fall=self._rule.may_fall(field),
        )
        return replace(memory, readings=(*memory.readings, this))


def _average(readings: Sequence[_Reading], weighted: bool) -> _Average:
    """Average readings, weighted by inverse variance or equally.

    It uses Python floats, which are several times faster than short arrays.
    """
    count = len(readings)
    values = [reading.value for reading in readings]
    plain = math.fsum(values) / count
    squares = math.fsum([(value - plain) ** 2 for value in values])
    scatter = math.sqrt(squares / (count - 1)) if count > 1 else math.nan
    if not weighted:
        return _Average(mean=plain, scatter=scatter, stated=math.nan)
    weights = [reading.deviation**-2.0 for reading in readings]
    total = math.fsum(weights)
    return _Average(
        mean=math.fsum([w * value for w, value in zip(weights, values, strict=True)]) / total,
        scatter=scatter,
        stated=math.sqrt(count / total),
    )
