"""The gripper's drive between a command and the force that it exerts, as a scene has it."""

import math
from typing import Annotated

from msgspec import Meta

from ..errors import UserError
from ..strict_toml import Table

NotNegative = Annotated[float, Meta(ge=0.0, le=1e9)]


class ActuatorSettings(Table, frozen=True):
    """A gripper whose force lags behind its command; all is off by default, as in the thesis.

    Attributes
    ----------
    lag_ms: time constant of the force, first order
    rate_n_per_s: fastest change of the force
    resolution_n: commands are rounded to multiples of it; 0 is off
    """

    lag_ms: NotNegative = 0.0
    rate_n_per_s: float = math.inf
    resolution_n: NotNegative = 0.0

    def __post_init__(self) -> None:
        if not self.rate_n_per_s > 0.0:
            raise UserError(f"rate_n_per_s = {self.rate_n_per_s} must be above 0, inf is off")

    def rounded(self, command: float) -> float:
        """Command that the drive takes for this one [N]."""
        if self.resolution_n == 0.0:
            return command
        return self.resolution_n * round(command / self.resolution_n)

    def follow(self, force: float, command: float, dt: float) -> float:
        """Force after `dt` seconds under a held command, exactly: df/dt = (command − f)/lag.

        Where that is faster than the rate, the force runs straight until it no longer is.

        Parameters
        ----------
        force: at the start [N]
        command: held meanwhile, see `rounded` [N]
        dt: time [s]
        """
        lag = 1e-3 * self.lag_ms
        error = abs(command - force)
        # Distance from the command at which the lag gets slower than the rate.
        near = self.rate_n_per_s * lag if lag > 0.0 else 0.0
        straight = max(error - near, 0.0) / self.rate_n_per_s
        if dt <= straight:
            return force + math.copysign(self.rate_n_per_s * dt, command - force)
        left = min(error, near) * math.exp((straight - dt) / lag) if lag > 0.0 else 0.0
        return command - math.copysign(left, command - force)
