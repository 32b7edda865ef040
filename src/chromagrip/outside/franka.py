"""The hand of Franka's robots, through the package franky."""

from importlib import import_module
from time import monotonic
from typing import Any

from ..errors import UserError
from .gripper import force_within

#: Travel of both fingers together [m].
TRAVEL_M = 0.08


class FrankaHand:
    """Franka Hand. It was tried against a fake of the package franky, not on hardware.

    It needs the package `franky-control` in the build for the robot's system version. The limits of
    the force are the continuous grasping force of the hand's product manual (R50010). Forces are
    rounded to 1 N.

    The hand is no force servo: a grasp is one motion, during which no other force is sent; the next
    command after it is. By reports (issues 93 and 108 of libfranka) a hand that holds an object
    takes no other force; that ends with an error. 0 N stops it, which ends the grip.

    Parameters
    ----------
    host: address of the robot
    speed: speed of closing (default 0.02) [m/s]
    floor: close with the least force where less is commanded, but more than 0 N; by default that
        is refused
    """

    #: Least and greatest force [N].
    limits = (30.0, 70.0)

    def __init__(self, host: str, speed: float = 0.02, floor: bool = False) -> None:
        if not speed > 0.0:
            raise UserError(f"speed {speed:g}: expected more than 0")
        try:
            franky = import_module("franky")
        except ImportError:
            raise UserError(
                "the Franka Hand needs the package franky: pip install franky-control, in the "
                "build for the robot's system version"
            ) from None
        self._hand = franky.Gripper(str(host))
        self._who = f"hand at {host}"
        self._speed, self._floor = speed, floor
        self._sent = self._held = 0
        self._task: Any = None
        self._due = 0.0

    def command(self, force: float) -> None:
        """Grasp with a force from now on [N]; it returns at once.

        Raises
        ------
        UserError
            For a force that it cannot hold, and when the grasp before failed or does not end.
        """
        wanted = round(force_within(self.limits, force, self._floor, self._who))
        if wanted and not self._ended():
            return
        if wanted == self._sent:
            return
        if wanted:
            # Every width of an object counts as grasped.
            self._task = self._hand.grasp_async(0.0, self._speed, wanted, 0.1, 0.1)
        else:
            self._task = self._hand.stop_async()
        self._due = monotonic() + TRAVEL_M / self._speed + 5.0
        self._sent = wanted

    def _ended(self) -> bool:
        """Whether no motion is under way; one that failed is refused, again and again."""
        if self._task is None:
            return True
        reason = "does not end"
        if self._task.wait(0.0):
            done, reason = False, "was refused"
            try:
                done = self._task.get()
            except Exception as error:
                reason = f"failed: {error}"
            if done:
                self._task, self._held = None, self._sent
                return True
        elif monotonic() < self._due:
            return False
        raise UserError(
            f"{self._who}: the grasp with {self._sent} N {reason}; the grip stays at {self._held} N"
        )
