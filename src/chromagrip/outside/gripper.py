"""Grippers for a loop outside of the simulation."""

import math
from contextlib import suppress
from typing import Protocol

from ..by_name import Registry, blaming
from ..errors import UserError
from ..output.time_limit import NoAnswerError, TimeLimit


class Gripper(Protocol):
    """Takes grip forces; a class of yours drives your hardware."""

    def command(self, force: float) -> None:
        """Grip with a force from now on [N]; it holds until the next one."""
        ...


class SimulatedGripper:
    """Accepts every force, without an object."""

    def command(self, force: float) -> None:
        """Grip with a force from now on [N]."""


#: Grippers by name.
GRIPPERS = Registry(
    protocol=Gripper,
    package=__package__,
    entries={
        "simulated": (".gripper:SimulatedGripper", "accepts every force, without an object"),
    },
)


class HeldGripper:
    """A gripper whose failure is one sentence, and that can repeat its last safe force.

    Parameters
    ----------
    gripper: gripper that is commanded
    name: name of the gripper in messages
    limit: time in which it must accept a force [s]
    """

    def __init__(self, gripper: Gripper, name: str, limit: float) -> None:
        self._gripper, self._name = gripper, name
        self._limit = TimeLimit(limit)
        self.force = math.nan

    def command(self, force: float, place: str) -> None:
        """Command a force.

        Parameters
        ----------
        force: force from now on [N]
        place: instant, for messages

        Raises
        ------
        UserError
            When the gripper raises, or does not answer in time.
        """
        late = False
        with blaming(f"gripper {self._name} failed {place}", Exception, SystemExit):
            try:
                self._limit.call(self._gripper.command, force)
            except NoAnswerError:
                late = True
        if late:
            raise UserError(
                f"gripper {self._name} did not answer within {self._limit.seconds:g} s {place}"
            )
        self.force = force

    def hold(self) -> None:
        """Command the last accepted force again, if the gripper still answers."""
        if math.isfinite(self.force):
            with suppress(Exception):
                self._limit.call(self._gripper.command, self.force)
