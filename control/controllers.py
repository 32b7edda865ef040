"""The three grip controllers of the thesis: `command(observation) -> GripCommand`."""

import math
from collections import deque
from typing import Protocol

from .settings import ConservativeSettings, ReactToSlipSettings, SafetyMarginSettings
from .values import GripCommand, GripObservation


class Controller(Protocol):
    """Commands a grip force at each observation, in order of time."""

    def reset(self) -> None:
        """Forget all observations; the next one starts a new grasp."""

    def command(self, observation: GripObservation) -> GripCommand:
        """Grip force for this observation."""


class SafetyMarginControl:
    """PI control of the safety margin: F = u + Kp·e + Ki·Σe·T, e = Γ_des − Γ (Eq. 6 with E1, E2).

    The sum is held while the command is at its floor. Without contact Γ is undefined, and the
    command is the feedforward, which makes contact.
    """

    def __init__(self, settings: SafetyMarginSettings) -> None:
        self.settings = settings
        self.reset()

    def reset(self) -> None:
        """Clear the sum."""
        self._sum = 0.0
        self._time = math.nan

    def command(self, observation: GripObservation) -> GripCommand:
        """Grip force for this observation."""
        settings = self.settings
        period = 0.0 if math.isnan(self._time) else observation.time - self._time
        self._time = observation.time
        if observation.time < settings.start_s or math.isnan(observation.margin):
            return GripCommand(force=settings.feedforward_n)
        error = settings.desired_margin - observation.margin
        total = self._sum + error * period
        force = settings.feedforward_n + settings.proportional_n * error
        force += settings.integral_n_per_s * total
        if force < settings.floor_n:
            return GripCommand(force=settings.floor_n)
        self._sum = total
        return GripCommand(force=force)


class ReactToSlip:
    """Adds a fixed force at each slip event (thesis Eq. 9 with E12).

    Where the lateral displacement is known, an event is another `displacement_mm` since the last
    event. On the camera path it is unknown. There an event begins when the mean of Γ over `hold_s`
    falls below `margin`, and ends when it is above again.
    """

    def __init__(self, settings: ReactToSlipSettings) -> None:
        self.settings = settings
        self.reset()

    def reset(self) -> None:
        """Forget all events."""
        self._force = self.settings.start_n
        self._counted = 0.0
        self._margins: deque[tuple[float, float]] = deque()
        self._reacted = False

    def command(self, observation: GripObservation) -> GripCommand:
        """Grip force for this observation."""
        if math.isnan(observation.lateral_displacement):
            slipped = self._low_margin(observation)
        else:
            threshold = self.settings.displacement_mm * 1e-3
            slipped = observation.lateral_displacement - self._counted > threshold
            if slipped:
                self._counted = observation.lateral_displacement
        if slipped:
            self._force += self.settings.step_n
        return GripCommand(force=self._force)

    def _low_margin(self, observation: GripObservation) -> bool:
        if math.isnan(observation.margin):
            self._margins.clear()
            return False
        self._margins.append((observation.time, observation.margin))
        # Frame times are products of a period: allow for their rounding.
        start = observation.time - self.settings.hold_s + 1e-9
        if self._margins[0][0] > start:
            return False  # the margin is known for less than `hold_s`
        while len(self._margins) > 1 and self._margins[1][0] <= start:
            self._margins.popleft()
        mean = sum(margin for _, margin in self._margins) / len(self._margins)
        low = mean < self.settings.margin
        begins = low and not self._reacted
        self._reacted = low
        return begins


class ConservativeControl:
    """Constant grip force, whatever is observed (thesis section 4.3)."""

    def __init__(self, settings: ConservativeSettings) -> None:
        self.settings = settings

    def reset(self) -> None:
        """Nothing to forget."""

    def command(self, observation: GripObservation) -> GripCommand:
        """Grip force for this observation."""
        return GripCommand(force=self.settings.force_n)
