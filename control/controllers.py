"""The three grip controllers of the thesis: `command(observation) -> GripCommand`."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Protocol

from .values import GripCommand, GripObservation


class Controller(Protocol):
    """Anything that answers observations, in order of time, with grip commands."""

    def reset(self) -> None:
        """Forget the past; the next observation starts a new grasp."""

    def command(self, observation: GripObservation) -> GripCommand:
        """Grip force for this observation."""


@dataclass(frozen=True, kw_only=True)
class SafetyMarginGains:
    """Gains of Safety Margin Control as printed for 1 kHz (thesis section 4.1, E1, E2).

    Attributes
    ----------
    desired_margin: Γ_des
    feedforward: u [N]
    proportional: Kp [N]
    integral: Ki, per second (E2: 0.1 per sample of 1 ms) [N/s]
    floor: lowest grip force [N]
    start: the controller is on from here; before, it commands `feedforward` [s]
    """

    desired_margin: float = 0.30
    feedforward: float = 0.5
    proportional: float = 2.5
    integral: float = 100.0
    floor: float = 0.1
    start: float = 0.04


class SafetyMarginControl:
    """PI control of the safety margin: F = u + Kp·e + Ki·Σe·T, e = Γ_des − Γ (Eq. 6 with E1, E2).

    The sum freezes while the output sits at its floor. Without contact there is no margin to
    control: the command is the feedforward, which makes contact.
    """

    def __init__(self, gains: SafetyMarginGains) -> None:
        self.gains = gains
        self.reset()

    def reset(self) -> None:
        """Clear the sum."""
        self._sum = 0.0
        self._time = math.nan

    def command(self, observation: GripObservation) -> GripCommand:
        """Grip force for this observation."""
        gains = self.gains
        period = 0.0 if math.isnan(self._time) else observation.time - self._time
        self._time = observation.time
        if observation.time < gains.start or math.isnan(observation.margin):
            return GripCommand(force=gains.feedforward)
        error = gains.desired_margin - observation.margin
        total = self._sum + error * period
        force = gains.feedforward + gains.proportional * error + gains.integral * total
        if force < gains.floor:
            return GripCommand(force=gains.floor)
        self._sum = total
        return GripCommand(force=force)


@dataclass(frozen=True, kw_only=True)
class ReactToSlipSettings:
    """Settings of React To Slip (thesis section 4.2, E12; the camera's rule from the same source).

    Attributes
    ----------
    start_force: grip force until slip [N]
    step_force: added once per slip event [N]
    displacement: lateral displacement that is called slip where it is known [m]
    margin: estimated Γ that is called slip where the displacement is unknown …
    hold: … once its mean over this time has fallen below it [s]; single frames are noise
    """

    start_force: float = 0.5
    step_force: float = 2.0
    displacement: float = 1.3e-3
    margin: float = 0.05
    hold: float = 0.1


class ReactToSlip:
    """Adds a fixed force each time slip is seen (thesis Eq. 9 with E12).

    With the lateral displacement given, an event is another `displacement` since the last one. On
    the camera path it is unknown, and an event is a mean margin below `margin` over `hold` seconds,
    which ends when that mean recovers.
    """

    def __init__(self, settings: ReactToSlipSettings) -> None:
        self.settings = settings
        self.reset()

    def reset(self) -> None:
        """Forget all events."""
        self._force = self.settings.start_force
        self._counted = 0.0
        self._margins: deque[tuple[float, float]] = deque()
        self._reacted = False

    def command(self, observation: GripObservation) -> GripCommand:
        """Grip force for this observation."""
        if math.isnan(observation.lateral_displacement):
            slipped = self._low_margin(observation)
        else:
            slipped = observation.lateral_displacement - self._counted > self.settings.displacement
            if slipped:
                self._counted = observation.lateral_displacement
        if slipped:
            self._force += self.settings.step_force
        return GripCommand(force=self._force)

    def _low_margin(self, observation: GripObservation) -> bool:
        if math.isnan(observation.margin):
            self._margins.clear()
            return False
        self._margins.append((observation.time, observation.margin))
        # Frame times are products of a period: allow for their rounding.
        start = observation.time - self.settings.hold + 1e-9
        if self._margins[0][0] > start:
            return False  # not yet seen for long enough
        while len(self._margins) > 1 and self._margins[1][0] <= start:
            self._margins.popleft()
        mean = sum(margin for _, margin in self._margins) / len(self._margins)
        low = mean < self.settings.margin
        begins = low and not self._reacted
        self._reacted = low
        return begins


@dataclass(frozen=True, kw_only=True)
class ConservativeSettings:
    """Constant grip force of Conservative Control (thesis Eq. 10) [N]."""

    force: float = 5.0


class ConservativeControl:
    """Constant grip force, whatever is seen (thesis section 4.3)."""

    def __init__(self, settings: ConservativeSettings) -> None:
        self.settings = settings

    def reset(self) -> None:
        """Nothing to forget."""

    def command(self, observation: GripObservation) -> GripCommand:
        """Grip force for this observation."""
        return GripCommand(force=self.settings.force)
