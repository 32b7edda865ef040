"""Margin Inversion: the grip force at which the estimated load has the desired safety margin.

Γ = 1 − ΣFf/(µ·Fn) is solved for the grip force: Fn = ΣFf/(µ·(1 − Γ_des)). There is no integral and
no gain, so that a delay does not make the grip oscillate.
"""

import math

from .grip_first import GripFirst, grown
from .settings import MarginInversionSettings
from .values import GripCommand, GripObservation

#: Standard deviations from the middle to an end of an observation's 90 % intervals.
Z90 = 1.645
#: Smallest µ that is used, because estimates are too low while µ is not observable.
LEAST_FRICTION = 0.1
#: Share by which skin that sticks makes the estimate of µ too low at most, beside its deviation.
STICKING_ERROR = 0.1
#: A change of more than this many times the usual size of changes is not noise.
UNUSUAL_CHANGE = 4.0
#: Time constant of the average that is the usual size of changes [s].
NOISE_MEMORY_S = 0.5


class MarginInversion:
    """Commands Fn = ΣFf/(µ·(1 − Γ_des)) with a cautious µ.

    The cautious µ is the highest lower bound of µ so far. More grip under a constant load lets the
    skin stick again, and then the estimate of µ is too low, which would raise the grip further.
    Therefore the cautious µ falls only while Γ shows that the skin slips, or as far as the estimate
    contradicts it. The command is never below the least grip in doubt, see `GripFirst`: without
    that, friction that follows the grip of a sliding object would let the grip fall with it.
    """

    def __init__(self, settings: MarginInversionSettings) -> None:
        self.settings = settings
        self._grip_first = GripFirst(settings.grip_first)
        self.reset()

    def reset(self) -> None:
        """Forget load, friction and noise."""
        self._force = self.settings.start_n
        self._time = math.nan
        self._need = math.nan
        self._friction = math.nan
        self._noise = 0.0
        self._slips_since = math.nan
        self._grip_first.reset()

    def command(self, observation: GripObservation) -> GripCommand:
        """Grip force for this observation; unchanged for a moment when no forces were estimated."""
        period = 0.0 if math.isnan(self._time) else observation.time - self._time
        self._time = observation.time
        self._grip_first.see(observation, self._force)
        if observation.no_estimate:
            pass
        elif math.isnan(observation.margin):  # no contact
            self._force = max(self._force, self.settings.start_n)
        else:
            self._follow(self._needed(observation), period)
        most = min(self._grip_first.most, self.settings.ceiling_n)
        self._force = min(max(self._force, self._grip_first.least), most)
        return GripCommand(force=self._force)

    def _needed(self, observation: GripObservation) -> float:
        """Grip force at which the estimated load has the desired margin, or more where it slips."""
        settings = self.settings
        friction = self._cautious_friction(observation)
        need = self._grip(observation, friction)
        if not observation.friction_observable:
            return max(need, settings.start_n)
        if not observation.margin < settings.slip_margin:
            self._slips_since = math.nan
            return need
        if math.isnan(self._slips_since):
            self._slips_since = observation.time
        return need * (1.0 + (settings.surge - 1.0) * grown(observation.time - self._slips_since))

    def _grip(self, observation: GripObservation, friction: float) -> float:
        """Grip force at which the estimated load has the desired margin with this µ."""
        return _friction(observation) / (friction * (1.0 - self.settings.desired_margin))

    def _cautious_friction(self, observation: GripObservation) -> float:
        """µ that the command is calculated with."""
        low = observation.friction_interval[0]
        deviation = 0.0 if math.isnan(low) else (observation.friction - low) / Z90
        bound = max(observation.friction - self.settings.caution * deviation, LEAST_FRICTION)
        if not observation.friction_observable:
            return bound
        slips = observation.margin < self.settings.slip_margin
        if slips or not self._friction > bound:
            self._friction = bound
        error = max(deviation, STICKING_ERROR * observation.friction)
        highest = observation.friction + self.settings.tolerance * error
        self._friction = min(self._friction, max(highest, LEAST_FRICTION))
        return self._friction

    def _follow(self, need: float, period: float) -> None:
        """Move the grip to the needed force: at once after a large change, else slowly."""
        settings = self.settings
        small = max(settings.band * self._force, UNUSUAL_CHANGE * self._noise)
        jump = 0.0 if math.isnan(self._need) else abs(need - self._need)
        self._need = need
        self._noise += _share(period, NOISE_MEMORY_S) * (min(jump, small) - self._noise)
        change = need - self._force
        if abs(change) <= small:
            change *= _share(period, settings.smoothing_s)
        force = self._force + max(change, -settings.release_n_per_s * period)
        self._force = min(max(force, settings.floor_n), settings.ceiling_n)


def _friction(observation: GripObservation) -> float:
    """Friction to be borne [N]; with torsion, the one that alone would have the same margin.

    More grip widens the contact, which then bears more torsion than this says. The next frame shows
    it, so that the grip settles where the limit surface has the desired margin.
    """
    friction = observation.field.total_friction
    if observation.torsion_counts:
        bound = observation.friction * observation.field.total_normal
        return max(friction, (1.0 - observation.margin) * bound)
    return friction


def _share(period: float, constant: float) -> float:
    """Share of a step that a first-order filter follows within a period."""
    return 1.0 - math.exp(-period / constant)
