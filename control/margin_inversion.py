"""Margin Inversion: the grip at which the load that is seen has the desired safety margin.

Γ = 1 − ΣFf/(µ·Fn), solved for the grip: Fn = ΣFf/(µ·(1 − Γ_des)). The answer is right at once and
does not build up, so that no gain times a delay can make it swing.
"""

import math
from dataclasses import dataclass

from .values import GripCommand, GripObservation

#: Two-sided 90 % of a normal distribution, which intervals of an observation have.
_Z90 = 1.645
#: No smaller µ is believed, whatever is read before it has shown.
_LEAST_FRICTION = 0.1
#: Skin that sticks reads µ low by up to this share, however sure the reading is of itself.
_STICKS = 0.1
#: Changes of this many times their usual size are no noise.
_UNUSUAL = 4.0
#: Over which the usual size is learned [s].
_MEMORY = 0.5


@dataclass(frozen=True, kw_only=True)
class MarginInversionSettings:
    """Settings of Margin Inversion.

    Attributes
    ----------
    desired_margin: Γ_des
    start: grip force until µ has shown [N]
    floor, ceiling: lowest and highest grip force [N]
    release: fastest that the grip gives way [N/s]; it may rise at once
    caution: standard deviations below the µ that is read of the µ that is counted on
    tolerance: standard deviations, none smaller than a tenth of µ, that the µ counted on may be
        above the one that is read
    slip_margin: estimated Γ below which the skin slips, so that µ is what it reads
    surge: times more grip while it slips than the friction seen asks for: the load is more
    smoothing: time constant of small changes [s]
    band: share of the grip up to which a change is small
    """

    desired_margin: float = 0.30
    start: float = 1.0
    floor: float = 0.1
    ceiling: float = 15.0
    release: float = 3.0
    caution: float = 0.25
    tolerance: float = 1.0
    slip_margin: float = 0.1
    surge: float = 1.5
    smoothing: float = 0.1
    band: float = 0.05


class MarginInversion:
    """Commands Fn = ΣFf/(µ·(1 − Γ_des)) with a µ that is rather low than high.

    That µ is the highest lower bound so far. A grip raised under a standing load lets the skin
    stick again and µ read low, which would raise the grip again; so µ falls only where the margin
    says that the skin slips, or where what is read can no longer be squared with it.
    """

    def __init__(self, settings: MarginInversionSettings) -> None:
        self.settings = settings
        self.reset()

    def reset(self) -> None:
        """Forget the load, the friction and their noise."""
        self._force = self.settings.start
        self._time = math.nan
        self._need = math.nan
        self._friction = math.nan
        self._noise = 0.0

    def command(self, observation: GripObservation) -> GripCommand:
        """Grip force for this observation; the last one where it says nothing of the forces."""
        settings = self.settings
        period = 0.0 if math.isnan(self._time) else observation.time - self._time
        self._time = observation.time
        if observation.no_estimate:
            return GripCommand(force=self._force)
        if math.isnan(observation.margin):  # nothing touches yet, or any more
            self._force = max(self._force, settings.start)
            return GripCommand(force=self._force)
        friction = self._counted_on(observation)
        load = observation.field.total_friction
        need = load / (friction * (1.0 - settings.desired_margin))
        if not observation.friction_observable:
            need = max(need, settings.start)
        elif observation.margin < settings.slip_margin:
            need *= settings.surge
        self._follow(need, period)
        return GripCommand(force=self._force)

    def _counted_on(self, observation: GripObservation) -> float:
        """µ that may be counted on."""
        low = observation.friction_interval[0]
        deviation = 0.0 if math.isnan(low) else (observation.friction - low) / _Z90
        bound = max(observation.friction - self.settings.caution * deviation, _LEAST_FRICTION)
        if not observation.friction_observable:
            return bound
        slips = observation.margin < self.settings.slip_margin
        if slips or not self._friction > bound:
            self._friction = bound
        low_by = max(deviation, _STICKS * observation.friction)
        most = observation.friction + self.settings.tolerance * low_by
        self._friction = min(self._friction, max(most, _LEAST_FRICTION))
        return self._friction

    def _follow(self, need: float, period: float) -> None:
        """Take the grip to what is needed: at once where that is new, or else slowly."""
        settings = self.settings
        small = max(settings.band * self._force, _UNUSUAL * self._noise)
        jump = 0.0 if math.isnan(self._need) else abs(need - self._need)
        self._need = need
        self._noise += _share(period, _MEMORY) * (min(jump, small) - self._noise)
        change = need - self._force
        if abs(change) <= small:
            change *= _share(period, settings.smoothing)
        force = self._force + max(change, -settings.release * period)
        self._force = min(max(force, settings.floor), settings.ceiling)


def _share(period: float, constant: float) -> float:
    """Share of a step that a first-order filter of that time constant follows in a period."""
    return 1.0 - math.exp(-period / constant)
