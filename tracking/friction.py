"""Friction coefficient and safety margin from a force field, as known at one instant."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..model import ForceField

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


def max_ratio(field: ForceField) -> float:
    """µ_est = max |Ff,i|/Fn,i over the nodes in contact (thesis Eq. 8); NaN without contact."""
    if not field.contact.any():
        return float("nan")
    touching = field.contact
    return float((np.abs(field.friction[touching]) / field.normal[touching]).max())


def core_ratios(field: ForceField) -> NDArray[np.float64]:
    """|Ff,i|/Fn,i over the well-loaded core of the contact; empty without contact."""
    if not field.contact.any():
        return np.empty(0)
    core = field.contact & (field.normal > CORE_SHARE * field.normal[field.contact].max())
    return np.abs(field.friction[core]) / field.normal[core]


def core_quantile(field: ForceField) -> float:
    """Upper quartile of the core's ratios; NaN without contact."""
    ratios = core_ratios(field)
    return float(np.quantile(ratios, CORE_QUANTILE)) if len(ratios) else float("nan")


def mostly_slipping(field: ForceField) -> bool:
    """Whether the core's ratios are nearly all alike, as they are where most of it slips."""
    ratios = core_ratios(field)
    if not len(ratios):
        return False
    low, high = np.quantile(ratios, [1.0 - CORE_QUANTILE, CORE_QUANTILE])
    return bool(low > SLIPPING_SPREAD * high)


@dataclass(frozen=True, kw_only=True)
class FrictionRule:
    """How µ is read off one field, and when what is read counts.

    Attributes
    ----------
    estimate: of one field
    observable_below: margins above this do not update µ once it has been seen
    may_fall: fields that may lower µ. A grip raised under a standing load lets the skin stick
        again, and the ratios sink below µ without µ having changed.
    """

    estimate: Callable[[ForceField], float]
    observable_below: float
    may_fall: Callable[[ForceField], bool]


#: As the thesis does it: maximum ratio, every frame counts (Eq. 8).
THESIS_RULE = FrictionRule(estimate=max_ratio, observable_below=np.inf, may_fall=lambda field: True)
#: For forces with noise: upper quartile, held while it cannot be seen.
CAMERA_RULE = FrictionRule(
    estimate=core_quantile, observable_below=OBSERVABLE_MARGIN, may_fall=mostly_slipping
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
        self._seen: deque[tuple[float, float, bool]] = deque()  # time, µ, may fall
        self._observed = False
        self._held = -np.inf

    def update(self, time: float, field: ForceField) -> tuple[float, tuple[float, float]]:
        """µ and its 90 % interval at `time` [s]; NaN before the first contact.

        Until µ has been observable once, the average of what the ratios show stands in: it
        saturates near the tissue's Poisson factor (E7) and is low rather than high.
        """
        self._note(time, field)
        # Frame times are products of a period: allow for their rounding.
        start = time - self._window + 1e-9
        full = bool(self._seen) and self._seen[0][0] <= start
        while len(self._seen) > 1 and self._seen[0][0] <= start:
            self._seen.popleft()
        if not self._seen:
            return float("nan"), (float("nan"), float("nan"))
        values = np.array([value for _, value, _ in self._seen])
        trusted = np.array([may_fall for _, _, may_fall in self._seen])
        mean = float(values.mean())
        if trusted.mean() > 0.5:
            mean = self._held = float(values[trusted].mean())
        elif full:  # a few first frames are too noisy to be held on to
            mean = self._held = max(self._held, mean)
        else:
            mean = max(self._held, mean)
        spread = Z90 * float(values.std(ddof=1)) if len(values) > 1 else float("nan")
        return mean, (mean - spread, mean + spread)

    def _note(self, time: float, field: ForceField) -> None:
        """Keep what this frame says of µ, if it says anything."""
        value = self._rule.estimate(field)
        if not np.isfinite(value):
            return
        observable = field.safety_margin(value) < self._rule.observable_below
        if observable and not self._observed:
            self._seen.clear()
            self._observed = True
        if observable or not self._observed:
            self._seen.append((time, value, self._rule.may_fall(field)))
