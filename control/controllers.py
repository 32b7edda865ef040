"""The three grip controllers of the thesis: `command(observation) -> GripCommand`."""

import math
from collections import deque
from typing import Protocol

from .grip_first import DoubtSettings, GripFirst
from .settings import ConservativeSettings, ReactToSlipSettings, SafetyMarginSettings
from .values import GripCommand, GripObservation


class Controller(Protocol):
    """Computes a grip force from each observation, in order of time."""

    def reset(self) -> None:
        """Forget all observations; the next one starts a new grasp."""

    def command(self, observation: GripObservation) -> GripCommand:
        """Grip force for this observation."""


class SafetyMarginControl:
    """PI control of the safety margin: F = u + Kp·e + Ki·Σe·T, e = Γ_des − Γ (Eq. 6 with E1, E2).

    The sum is held while the command is at its floor. Without contact Γ is undefined, and the
    command is the feedforward, which makes contact. The command is never below the least grip in
    doubt, see `GripFirst`; while that is what is commanded, the sum is set so that the law gives
    the same.
    """

    def __init__(
        self, settings: SafetyMarginSettings, doubt: DoubtSettings = DoubtSettings()
    ) -> None:
        self.settings = settings
        self._grip_first = GripFirst(settings.grip_first, doubt)
        self.reset()

    def reset(self) -> None:
        """Clear the sum."""
        self._sum = 0.0
        self._time = math.nan
        self._force = self.settings.feedforward_n
        self._grip_first.reset()

    def command(self, observation: GripObservation) -> GripCommand:
        """Grip force for this observation."""
        period = 0.0 if math.isnan(self._time) else observation.time - self._time
        self._time = observation.time
        self._grip_first.see(observation, self._force)
        least, most = self._grip_first.least, self._grip_first.most
        if observation.time < self.settings.start_s or math.isnan(observation.margin):
            self._force = max(self.settings.feedforward_n, least)
        else:
            self._force = self._law(self.settings.desired_margin - observation.margin, period)
            if not least <= self._force <= most:
                self._force = min(max(self._force, least), most)
                self._follow(self.settings.desired_margin - observation.margin)
        return GripCommand(force=self._force)

    def _law(self, error: float, period: float) -> float:
        """Force of the PI law; the sum goes on where the force is not below the floor."""
        settings = self.settings
        total = self._sum + error * period
        force = settings.feedforward_n + settings.proportional_n * error
        force += settings.integral_n_per_s * total
        if force < settings.floor_n:
            return settings.floor_n
        self._sum = total
        return force

    def _follow(self, error: float) -> None:
        """Set the sum so that the law gives the force that is commanded."""
        settings = self.settings
        if settings.integral_n_per_s > 0.0:
            rest = self._force - settings.feedforward_n - settings.proportional_n * error
            self._sum = rest / settings.integral_n_per_s


class ReactToSlip:
    """Adds a fixed force at each slip event (thesis Eq. 9 with E12).

    If the lateral displacement is known, an event is another `displacement_mm` since the last
    event. On the camera path it is unknown: an object that slides at constant friction does not
    move the skin, so only Γ shows that it slides. There the mean of Γ over `hold_s` below `margin`
    is an event, and another one if it stays below for as long again. If frames do not exclude
    sliding for as long without such an event, the force rises to the least grip in doubt, see
    `GripFirst`.
    """

    def __init__(
        self, settings: ReactToSlipSettings, doubt: DoubtSettings = DoubtSettings()
    ) -> None:
        self.settings = settings
        self._grip_first = GripFirst(settings.grip_first, doubt)
        self.reset()

    def reset(self) -> None:
        """Forget all events."""
        self._force = self.settings.start_n
        self._counted = 0.0
        self._margins: deque[tuple[float, float]] = deque()
        self._sure = math.nan
        self._grip_first.reset()

    def command(self, observation: GripObservation) -> GripCommand:
        """Grip force for this observation."""
        if math.isnan(observation.lateral_displacement):
            self._react_to_margin(observation)
        else:
            threshold = self.settings.displacement_mm * 1e-3
            if observation.lateral_displacement - self._counted > threshold:
                self._counted = observation.lateral_displacement
                self._force += self.settings.step_n
        return GripCommand(force=self._force)

    def _react_to_margin(self, observation: GripObservation) -> None:
        """Raise the force at an event, or in doubt."""
        first = self._grip_first
        first.see(observation, self._force)
        if not first.doubt or math.isnan(self._sure):
            self._sure = observation.time
        if self._low_margin(observation):
            self._force = min(self._force + self.settings.step_n, first.most)
            self._margins.clear()
            self._sure = observation.time
        # Frame times are products of a period: allow for their rounding.
        elif observation.time - self._sure > self.settings.hold_s + 1e-9:
            self._force = max(self._force, first.least)

    def _low_margin(self, observation: GripObservation) -> bool:
        """Return True if the mean of Γ over `hold_s` is below `margin`."""
        if math.isnan(observation.margin):
            self._margins.clear()
            return False
        self._margins.append((observation.time, observation.margin))
        start = observation.time - self.settings.hold_s + 1e-9
        if self._margins[0][0] > start:
            return False  # the margin is known for less than `hold_s`
        while len(self._margins) > 1 and self._margins[1][0] <= start:
            self._margins.popleft()
        mean = sum(margin for _, margin in self._margins) / len(self._margins)
        return mean < self.settings.margin


class ConservativeControl:
    """Constant grip force, whatever is observed (thesis section 4.3)."""

    def __init__(self, settings: ConservativeSettings) -> None:
        self.settings = settings

    def reset(self) -> None:
        """Do nothing: there is no state."""

    def command(self, observation: GripObservation) -> GripCommand:
        """Grip force for this observation."""
        return GripCommand(force=self.settings.force_n)
