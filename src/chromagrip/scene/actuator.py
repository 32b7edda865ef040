"""A scene's model of the gripper's drive, between a command and the force that it exerts."""

import math

from ..errors import UserError
from ..strict_toml import NotNegative, Table


class ActuatorSettings(Table, frozen=True):
    """Drive of a gripper whose force lags behind its command; the default follows at once.

    Attributes
    ----------
    lag_ms: time constant of the first-order lag of the force [ms]
    rate_n_per_s: fastest change of the force [N/s]; inf: unlimited
    resolution_n: step to whose multiples commands are rounded [N]; 0: no rounding
    """

    lag_ms: NotNegative = 0.0
    rate_n_per_s: float = math.inf
    resolution_n: NotNegative = 0.0

    def __post_init__(self) -> None:
        if not self.rate_n_per_s > 0.0:
            raise UserError(
                f"rate_n_per_s = {self.rate_n_per_s} must be greater than 0 (inf: unlimited)"
            )

    def rounded(self, command: float) -> float:
        """Round a command to the resolution [N]."""
        if self.resolution_n == 0.0:
            return command
        return self.resolution_n * round(command / self.resolution_n)

    def follow(self, force: float, command: float, dt: float) -> float:
        """Force after `dt` seconds under a constant command, exactly: df/dt = (command − f)/lag.

        The force changes at the fastest rate while that law would be faster.

        Parameters
        ----------
        force: force at the start [N]
        command: rounded command, constant [N]
        dt: time [s]
        """
        lag = 1e-3 * self.lag_ms
        error = abs(command - force)
        # Distance from the command at which the law of the lag is as fast as the rate.
        near = self.rate_n_per_s * lag if lag > 0.0 else 0.0
        straight = max(error - near, 0.0) / self.rate_n_per_s
        if dt <= straight:
            return force + math.copysign(self.rate_n_per_s * dt, command - force)
        remaining = min(error, near) * math.exp((straight - dt) / lag) if lag > 0.0 else 0.0
        return command - math.copysign(remaining, command - force)
