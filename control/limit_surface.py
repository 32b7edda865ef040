"""Limit Surface: the grip at which friction and torsion together have the desired margin.

A contact bears friction in proportion to the grip F. It bears torsion in proportion to F^(4/3),
because more grip also widens it (Hertz: radius ∝ F^(1/3), torsion borne ∝ µ·F·radius). Both share
one limit surface, here an ellipsoid: (pull)² + (twist)² = 1, each over what is borne of it alone.
"""

import math
from collections import deque

from .margin_inversion import InversionSettings, MarginInversion
from .settings import LimitSurfaceSettings
from .values import GripObservation

#: Power of the grip with which a contact of Hertz bears torsion.
TORSION_POWER = 4.0 / 3.0


class LimitSurfaceControl(MarginInversion):
    """Commands the grip that friction and torsion need together, with a lead on the torsion.

    Margin Inversion turns the margin into the friction that alone would have it. Here both parts
    of the load are known, so that the grip is found at once. While the torsion rises, it counts as
    what it will be after `lead_s` if it goes on so: a contact that begins to turn bears no more
    torsion, and the object swings on.
    """

    def __init__(
        self, settings: LimitSurfaceSettings, tuned: InversionSettings = InversionSettings()
    ) -> None:
        self._twists: deque[tuple[float, float]] = deque()
        self._lead, self._rise = settings.lead_s, settings.rise_s
        super().__init__(settings, tuned)

    def reset(self) -> None:
        """Forget load, friction and noise."""
        super().reset()
        self._twists.clear()
        self._peak = 0.0

    def _grip(self, observation: GripObservation, friction: float) -> float:
        """Grip force at which the load, with its lead, has the desired margin with this µ."""
        if math.isnan(observation.limit_margin):
            return super()._grip(observation, friction)
        field, twist = observation.field, abs(observation.torsion)
        ahead = self._ahead(observation.time, twist)
        pull = field.total_friction / (friction * field.total_normal)
        borne = observation.torsion_borne * friction / observation.friction
        turn = twist / borne if borne > 0.0 else 0.0
        used = math.hypot(pull, turn)
        if not used > 0.0:
            return self.settings.floor_n
        # The true surface is no ellipsoid: this one is scaled to meet it at this load.
        real = (1.0 - observation.limit_margin) * observation.friction / friction
        allowed = (1.0 - self.settings.desired_margin) * used / max(real, 1e-6)
        return field.total_normal * grip_factor(pull, turn * ahead / max(twist, 1e-12), allowed)

    def _ahead(self, time: float, twist: float) -> float:
        """Torsion after the lead, if it goes on rising as it does [N·m].

        An object that swings has shown how far it goes: the lead ends a little above the largest
        torsion seen, until there is more of it.
        """
        twists = self._twists
        if twists and twist < twists[-1][1]:
            self._peak = max(self._peak, twists[-1][1])
        # Frame times are products of a period: allow for their rounding.
        while len(twists) > 1 and twists[1][0] <= time - self._rise + 1e-9:
            twists.popleft()
        rise = 0.0
        if twists and time > twists[0][0]:
            rise = max(twist - twists[0][1], 0.0) / (time - twists[0][0])
        twists.append((time, twist))
        ahead = twist + self._lead * rise
        known = 1.2 * self._peak  # tuned
        return ahead if twist > known else min(ahead, known)


def grip_factor(pull: float, turn: float, allowed: float) -> float:
    """Solve (pull/s)² + (turn/s^(4/3))² = allowed² for the factor s on the grip.

    Parameters
    ----------
    pull, turn: friction and torsion, each as a share of the largest carried alone; not both 0
    allowed: share of the limit surface that may be used
    """
    a, b = (pull / allowed) ** 2, (turn / allowed) ** 2
    power = 2.0 * TORSION_POWER
    # In log s the left side is convex and falls: from here it is met from above.
    x = 0.5 * math.log(max(a, b ** (1.0 / TORSION_POWER)))
    # Newton's method converges from one side, in three or four rounds.
    for _ in range(6):
        first, second = a * math.exp(-2.0 * x), b * math.exp(-power * x)
        x += (first + second - 1.0) / (2.0 * first + power * second)
    return math.exp(x)
