"""Margin Inversion: the grip force at which the estimated load has the desired safety margin.

Γ = 1 − ΣFf/(µ·Fn) is solved for the grip force: Fn = ΣFf/(µ·(1 − Γ_des)). There is no integral and
no gain, so that a delay does not make the grip oscillate.
"""

import math
from dataclasses import dataclass

from .grip_first import DoubtSettings, GripFirst, grown
from .settings import MarginInversionSettings
from .values import GripCommand, GripObservation

#: Standard deviations from the middle to an end of an observation's 90 % intervals.
Z90 = 1.645


@dataclass(frozen=True, kw_only=True)
class InversionSettings:
    """Tuned numbers of `MarginInversion`.

    Attributes
    ----------
    least_friction: smallest µ that is used; estimates are too low while µ is not observable
    sticking_error: relative error of the estimate of µ that sticking skin causes at most
    unusual_change: number of usual changes of the needed grip above which a change is not noise
    noise_memory_s: time constant of the average that is the usual change [s]
    doubt: least grip in doubt
    """

    least_friction: float = 0.1
    sticking_error: float = 0.1
    unusual_change: float = 4.0
    noise_memory_s: float = 0.5
    doubt: DoubtSettings = DoubtSettings()


class MarginInversion:
    """Commands Fn = ΣFf/(µ·(1 − Γ_des)) with a cautious µ.

    The cautious µ is the highest lower bound of µ so far. More grip under a constant load lets the
    skin stick again, and then the estimate of µ is too low, which would raise the grip further.
    Therefore the cautious µ falls only while Γ shows that the skin slips, or as far as the estimate
    contradicts it. The command is never below the least grip in doubt, see `GripFirst`: without
    that, friction that follows the grip of a sliding object would let the grip fall with it.

    Parameters
    ----------
    settings: of the scene
    tuned: further numbers
    """

    def __init__(
        self, settings: MarginInversionSettings, tuned: InversionSettings = InversionSettings()
    ) -> None:
        self.settings, self._tuned = settings, tuned
        self._grip_first = GripFirst(settings.grip_first, tuned.doubt)
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
        share = grown(observation.time - self._slips_since, self._tuned.doubt.growth_s)
        return need * (1.0 + (settings.surge - 1.0) * share)

    def _grip(self, observation: GripObservation, friction: float) -> float:
        """Grip force at which the estimated load has the desired margin with this µ."""
        return _friction(observation) / (friction * (1.0 - self.settings.desired_margin))

    def _cautious_friction(self, observation: GripObservation) -> float:
        """µ that the command is calculated with."""
        tuned = self._tuned
        low = observation.friction_interval[0]
        deviation = 0.0 if math.isnan(low) else (observation.friction - low) / Z90
        bound = max(observation.friction - self.settings.caution * deviation, tuned.least_friction)
        if not observation.friction_observable:
            return bound
        slips = observation.margin < self.settings.slip_margin
        if slips or not self._friction > bound:
            self._friction = bound
        error = max(deviation, tuned.sticking_error * observation.friction)
        highest = observation.friction + self.settings.tolerance * error
        self._friction = min(self._friction, max(highest, tuned.least_friction))
        return self._friction

    def _follow(self, need: float, period: float) -> None:
        """Move the grip to the needed force: at once after a large change, else slowly."""
        tuned = self._tuned
        settings = self.settings
        small = max(settings.band * self._force, tuned.unusual_change * self._noise)
        jump = 0.0 if math.isnan(self._need) else abs(need - self._need)
        self._need = need
        self._noise += _share(period, tuned.noise_memory_s) * (min(jump, small) - self._noise)
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
