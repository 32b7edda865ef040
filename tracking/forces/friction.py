"""Friction coefficient from a force field, as known at one instant and over time.

The ratio |Ff,i|/Fn,i is µ where the skin slips and anything below where it sticks. Noise draws the
largest ratio up, towards unsafe; a pure press shows ratios up to the tissue's Poisson factor (E7).
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from ...model import ForceField, FrictionReading

Array = NDArray[np.float64]

#: A node belongs to the core of a contact above this share of the largest normal force.
CORE_SHARE = 0.3
#: Quantile of the core's ratios: the maximum is biased upwards by noise, so towards unsafe.
CORE_QUANTILE = 0.75
#: The core counts as mostly slipping when its lower quartile is above this share of the upper one.
SLIPPING_SPREAD = 0.8
#: Above this margin too little of the contact slips for its ratios to show µ.
OBSERVABLE_MARGIN = 0.85
#: Two-sided 90 % of a normal distribution.
Z90 = 1.645
#: No larger µ is considered: what an interval ends at where only a lower bound is known.
LARGEST_FRICTION = 2.0

#: µ that `slip_zones` weighs against each other …
_FRICTIONS = np.linspace(0.05, LARGEST_FRICTION, 118)
#: … and turns of the force along the contact that the object's fitted curvature leaves, with their
#: standard deviation [rad per unit of the core's half width].
_TURNS, _TURN = np.linspace(-0.25, 0.25, 11), 0.1
#: Error of a force's direction beside the stated one [rad].
_DIRECTION = 0.06
#: Standard deviation from which on a reading is mostly what was assumed before, and shows nothing.
_VAGUE = 0.2
#: Nodes that `slip_zones` reads: more say the same again, as forces are smooth.
_READ = 24


def max_ratio(field: ForceField) -> float:
    """µ_est = max |Ff,i|/Fn,i over the nodes in contact (thesis Eq. 8); NaN without contact."""
    if not field.contact.any():
        return float("nan")
    touching = field.contact
    return float((np.abs(field.friction[touching]) / field.normal[touching]).max())


def core_quantile(field: ForceField) -> float:
    """Upper quartile of the core's ratios; NaN without contact."""
    core = _core(field)
    ratios = np.abs(field.friction[core]) / field.normal[core]
    return float(np.quantile(ratios, CORE_QUANTILE)) if len(ratios) else float("nan")


def mostly_slipping(field: ForceField) -> bool:
    """Whether the core's ratios are nearly all alike, as they are where most of it slips."""
    core = _core(field)
    if not len(core):
        return False
    ratios = np.abs(field.friction[core]) / field.normal[core]
    low, high = np.quantile(ratios, [1.0 - CORE_QUANTILE, CORE_QUANTILE])
    return bool(low > SLIPPING_SPREAD * high)


def slip_zones(field: ForceField) -> FrictionReading:
    """µ from the directions of the core's forces: some slip at atan µ, the others stick below.

    Every node is a mixture of both with the same odds; the posterior of µ, flat beforehand, is
    taken together with a turn that grows along the contact, which is what an object's wrongly
    fitted curvature adds.
    """
    core = _core(field)
    if len(core) < 3:
        return FrictionReading(value=np.nan, deviation=np.nan, observable=False)
    core = core[np.linspace(0, len(core) - 1, min(_READ, len(core))).round().astype(int)]
    normal, friction = field.normal[core], field.friction[core]
    side = 1.0 if field.friction[field.contact].sum() >= 0.0 else -1.0
    direction = side * np.arctan2(friction, normal)
    x = field.position[core, 0]
    along = 2.0 * (x - x.mean()) / np.ptp(x)
    deviation, worth = np.full(len(core), _DIRECTION), 1.0
    if field.spread is not None:
        rows = field.spread.reshape(2, len(field.normal), -1)[:, core]
        turns = (normal[:, None] * rows[1] - friction[:, None] * rows[0]) / (
            normal**2 + friction**2
        )[:, None]
        covariance = turns @ turns.T + _DIRECTION**2 * np.eye(len(core))
        deviation = np.sqrt(np.diag(covariance))
        # Neighbours err alike: as many of them count as there are independent ones.
        worth = np.trace(covariance) ** 2 / (covariance**2).sum() / len(core)
    cone = np.arctan(_FRICTIONS)[:, None, None]
    error = (direction - cone - _TURNS[:, None] * along) / deviation
    slipping = np.exp(-0.5 * error**2) / (np.sqrt(2.0 * np.pi) * deviation)
    sticking = (ndtr((direction + cone) / deviation) - ndtr((direction - cone) / deviation)) / (
        2.0 * cone
    )
    logarithm = worth * np.log(slipping + sticking + 1e-12).sum(axis=2)
    logarithm -= 0.5 * (_TURNS / _TURN) ** 2
    weight = np.exp(logarithm - logarithm.max()).sum(axis=1)
    weight /= weight.sum()
    value = float(weight @ _FRICTIONS)
    uncertainty = float(np.sqrt(weight @ (_FRICTIONS - value) ** 2))
    return FrictionReading(
        value=value,
        deviation=uncertainty,
        observable=uncertainty < _VAGUE and field.safety_margin(value) < OBSERVABLE_MARGIN,
    )


def read_out(field: ForceField) -> FrictionReading:
    """µ as the reconstructor itself read it; NaN of one that does not."""
    return field.friction_reading or FrictionReading(
        value=np.nan, deviation=np.nan, observable=False
    )


def _read_largest(field: ForceField) -> FrictionReading:
    """Largest ratio, which knows nothing of its own error; without any friction none is seen."""
    value = max_ratio(field) or np.nan
    observable = field.safety_margin(value) < OBSERVABLE_MARGIN
    return FrictionReading(value=value, deviation=np.nan, observable=observable)


def _read_core(field: ForceField) -> FrictionReading:
    """Upper quartile of the core's ratios, its error that of the upper half's mean."""
    value, core, deviation = core_quantile(field), _core(field), np.nan
    if field.spread is not None and len(core):
        ratio = field.friction[core] / field.normal[core]
        rows = field.spread.reshape(2, len(field.normal), -1)[:, core]
        change = (np.sign(ratio) / field.normal[core])[:, None] * (
            rows[1] - ratio[:, None] * rows[0]
        )
        upper = np.abs(ratio) >= np.median(np.abs(ratio))
        deviation = float(np.hypot(np.linalg.norm(change[upper].mean(axis=0)), _DIRECTION))
    observable = field.safety_margin(value) < OBSERVABLE_MARGIN
    return FrictionReading(value=value, deviation=deviation, observable=observable)


#: How µ is read off one field, by name.
FRICTION: dict[str, Callable[[ForceField], FrictionReading]] = {
    "max-ratio": _read_largest,
    "core-quantile": _read_core,
    "slip-zones": slip_zones,
    "read-out": read_out,
}


def _core(field: ForceField) -> NDArray[np.intp]:
    """Numbers of the well-loaded nodes of the contact; none without contact."""
    largest = field.normal[field.contact].max(initial=0.0)
    return np.flatnonzero(field.contact & (field.normal > CORE_SHARE * largest))


@dataclass(frozen=True, kw_only=True)
class FrictionRule:
    """How µ is read off one field, and when what is read counts.

    Attributes
    ----------
    read: of one field, see FRICTION
    may_fall: fields that may lower µ. A grip raised under a standing load lets the skin stick
        again, and the ratios sink below µ without µ having changed.
    every: every field counts, not only those that show µ
    """

    read: Callable[[ForceField], FrictionReading]
    may_fall: Callable[[ForceField], bool]
    every: bool = False


#: As the thesis does it: maximum ratio, every frame counts (Eq. 8).
THESIS_RULE = FrictionRule(read=FRICTION["max-ratio"], may_fall=lambda field: True, every=True)
#: For forces with noise: what the reconstructor read, or else the ratios' upper quartile; held
#: while µ cannot be seen.
CAMERA_RULE = FrictionRule(
    read=lambda field: field.friction_reading or FRICTION["core-quantile"](field),
    may_fall=lambda field: field.friction_reading is not None or mostly_slipping(field),
)


class FrictionEstimate:
    """Moving average of a per-frame friction estimate, held while µ cannot be seen.

    Parameters
    ----------
    rule: how one field is read
    window: length of the average [s]
    """

    def __init__(self, rule: FrictionRule, window: float) -> None:
        self._rule = rule
        self._window = window
        self.reset()

    def reset(self) -> None:
        """Forget all frames."""
        self._seen: deque[tuple[float, FrictionReading, bool]] = deque()  # time, µ, may fall
        self._held = -np.inf
        #: Whether µ has shown since the reset.
        self.observable = False

    def update(self, time: float, field: ForceField) -> tuple[float, tuple[float, float]]:
        """µ and its 90 % interval at `time` [s]; NaN before the first contact.

        Until µ has been observable once, the average of what the ratios show stands in: it
        saturates near the tissue's Poisson factor (E7) and is low rather than high. Any µ above
        explains it just as well, and the interval says so.
        """
        self._note(time, field)
        # Frame times are products of a period: allow for their rounding.
        start = time - self._window + 1e-9
        full = bool(self._seen) and self._seen[0][0] <= start
        while len(self._seen) > 1 and self._seen[0][0] <= start:
            self._seen.popleft()
        if not self._seen:
            return float("nan"), (float("nan"), float("nan"))
        values = np.array([reading.value for _, reading, _ in self._seen])
        deviations = np.array([reading.deviation for _, reading, _ in self._seen])
        trusted = np.array([may_fall for _, _, may_fall in self._seen])
        known = bool((deviations > 0.0).all())
        weights = deviations**-2.0 if known else np.ones(len(values))
        mean = float(np.average(values, weights=weights))
        # What a reading errs by stays the same from frame to frame: it does not average out.
        scatter = values.std(ddof=1) if len(values) > 1 else np.nan
        stated = np.sqrt(np.average(deviations**2, weights=weights)) if known else np.nan
        if trusted.mean() > 0.5:
            mean = float(np.average(values[trusted], weights=weights[trusted]))
            self._held = mean
        else:
            if full:  # a few first frames are too noisy to be held on to, and so is what is unsure
                self._held = max(self._held, mean - (float(stated) if known else 0.0))
            mean = max(self._held, mean)
        spread = Z90 * float(np.fmax(scatter, stated))
        shown = self.observable or self._rule.every
        return mean, (mean - spread, mean + spread if shown else LARGEST_FRICTION)

    def _note(self, time: float, field: ForceField) -> None:
        """Keep what this frame says of µ, if it says anything."""
        reading = self._rule.read(field)
        if not np.isfinite(reading.value):
            return
        if reading.observable and not self.observable:
            self.observable = True
            if not self._rule.every:
                self._seen.clear()
        if reading.observable or self._rule.every or not self.observable:
            self._seen.append((time, reading, self._rule.may_fall(field)))
