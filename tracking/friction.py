"""Friction coefficient and safety margin from a force field, as known at one instant."""

from collections import deque
from collections.abc import Callable

import numpy as np

from ..model import ForceField

#: A node belongs to the core of a contact above this share of the largest normal force.
CORE_SHARE = 0.3
#: Quantile of the core's ratios: the maximum is biased upwards by noise, so towards unsafe.
CORE_QUANTILE = 0.75
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


def core_quantile(field: ForceField) -> float:
    """Upper quartile of |Ff,i|/Fn,i over the well-loaded core; NaN without contact."""
    if not field.contact.any():
        return float("nan")
    core = field.contact & (field.normal > CORE_SHARE * field.normal[field.contact].max())
    ratios = np.abs(field.friction[core]) / field.normal[core]
    return float(np.quantile(ratios, CORE_QUANTILE))


class FrictionEstimate:
    """Moving average of a per-frame friction estimate, held while µ cannot be seen.

    Parameters
    ----------
    estimate: of one field, `max_ratio` or `core_quantile`
    window: length of the average [s]
    observable_below: margins above this do not update µ once it has been seen
    """

    def __init__(
        self, estimate: Callable[[ForceField], float], window: float, observable_below: float
    ) -> None:
        self._estimate = estimate
        self._window = window
        self._observable_below = observable_below
        self.reset()

    def reset(self) -> None:
        """Forget all frames."""
        self._seen: deque[tuple[float, float]] = deque()
        self._observed = False

    def update(self, time: float, field: ForceField) -> tuple[float, tuple[float, float]]:
        """µ and its 90 % interval at `time` [s]; NaN before the first contact.

        Until µ has been observable once, the average of what the ratios show stands in: it
        saturates near the tissue's Poisson factor (E7) and is low rather than high.
        """
        value = self._estimate(field)
        if np.isfinite(value):
            observable = field.safety_margin(value) < self._observable_below
            if observable and not self._observed:
                self._seen.clear()
                self._observed = True
            if observable or not self._observed:
                self._seen.append((time, value))
        # Frame times are sums of periods: allow for their rounding.
        while len(self._seen) > 1 and self._seen[0][0] <= time - self._window + 1e-9:
            self._seen.popleft()
        if not self._seen:
            return float("nan"), (float("nan"), float("nan"))
        values = np.array([v for _, v in self._seen])
        mean = float(values.mean())
        spread = Z90 * float(values.std(ddof=1)) if len(values) > 1 else float("nan")
        return mean, (mean - spread, mean + spread)
