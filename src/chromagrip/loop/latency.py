"""The controller's side of the loop: frames reach it late or never, and its answer sets the grip.

With a latency of L frames the command at frame k answers frame k − L. Before frame L, and while no
frame arrives, the grip holds: at first at the controller's answer to the first frame.
"""

import math
from collections.abc import Iterable
from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..by_name import blaming
from ..control import Controller, GripObservation
from ..errors import UserError
from ..output.time_limit import NoAnswerError, TimeLimit
from ..scene.scene import Scene


def arrivals(scene: Scene) -> NDArray[np.intp]:
    """Draw for each frame the number of the frame at which it arrives; −1 for a dropped frame.

    Numbers are drawn from the scene's seed, shape (frames,). The first frame, which starts the
    grip, is never dropped.
    """
    # Number of the random stream of lost and late frames; lower numbers are for defects.
    stream = 20
    rng = np.random.default_rng([scene.seed, stream])
    lost, late = rng.random((scene.frames, 2)).T
    due = np.arange(scene.frames) + scene.camera.latency_frames + (late < scene.camera.late)
    due[1:][lost[1:] < scene.camera.dropped] = -1
    return due


@dataclass(frozen=True)
class Arrived:
    """Observation that reaches the controller.

    Attributes
    ----------
    index: number of the observed frame
    observation: observation whose margin is the one to hold
    """

    index: int
    observation: GripObservation


class Delivery:
    """Observations on their way from the camera to the controller, in the order of their frames.

    Parameters
    ----------
    due: frame at which each frame's observation arrives; see `arrivals`
    """

    def __init__(self, due: NDArray[np.intp]) -> None:
        self.due = due
        self._waiting: tuple[Arrived, ...] = ()

    def send(self, index: int, observation: GripObservation) -> None:
        """Send the observation of a frame; observations that arrived before it are forgotten."""
        self._waiting = (*self._later(index - 1), Arrived(index, observation))

    def arrived(self, index: int) -> tuple[Arrived, ...]:
        """Observations that arrive at a frame."""
        waiting = self._later(index - 1)
        return waiting[: len(waiting) - len(self._later(index))]

    def copied(self) -> "Delivery":
        """Copy that continues independently."""
        return copy(self)

    def _later(self, index: int) -> tuple[Arrived, ...]:
        """Observations that arrive after a frame; they stay in order."""
        gone = sum(1 for one in self._waiting if self.due[one.index] <= index)
        return self._waiting[gone:]


class HoldingController:
    """A controller whose answers are checked, and held until the next one.

    Parameters
    ----------
    controller: controller that answers
    name: name of the controller in messages
    limit: time in which it must answer (default: no limit) [s]
    """

    def __init__(self, controller: Controller, name: str, limit: float = math.inf) -> None:
        self._controller = controller
        self._name = name
        self._limit = TimeLimit(limit)
        self._grip = math.nan
        self._reset()

    def start(self, observation: GripObservation) -> None:
        """Hold the answer to the first frame, which the controller forgets.

        Raises
        ------
        UserError
            When the controller raises, does not answer in time, or its answer is not a finite force
            of at least 0; the message gives the force at which the grip stays.
        """
        self._grip = self._answer(Arrived(0, observation))
        self._reset()

    def command(self, arrived: Iterable[Arrived]) -> float:
        """Force commanded from now on [N]: the answer to the last observation that arrived.

        Raises
        ------
        UserError
            As in `start`.
        """
        for one in arrived:
            self._grip = self._answer(one)
        return self._grip

    def _reset(self) -> None:
        failure = f"controller {self._name} failed before the first sample"
        with blaming(failure, Exception, SystemExit):
            self._limit.call(self._controller.reset)

    def _answer(self, arrived: Arrived) -> float:
        """Ask the controller for a force [N] for an observation."""
        try:
            return self._checked(arrived)
        except UserError as error:
            if math.isnan(self._grip):
                raise
            raise UserError(f"{error}; the grip stays at {self._grip:.4g} N") from error.__cause__

    def _checked(self, arrived: Arrived) -> float:
        who = f"controller {self._name}"
        place = f"at t = {arrived.observation.time:.4g} s, sample {arrived.index}"
        late, answer, force = False, None, None
        with blaming(f"{who} failed {place}", Exception, SystemExit):
            try:
                answer = self._limit.call(self._controller.command, arrived.observation)
                force = float(answer.force) if hasattr(answer, "force") else None
            except NoAnswerError:
                late = True
        if late:
            raise UserError(f"{who} did not answer within {self._limit.seconds:g} s {place}")
        if force is None:
            raise UserError(
                f"{who} answered {answer!r} {place}; expected a GripCommand with a force in N"
            )
        return checked_force(force, f"{who} commanded", place)


def checked_force(force: float, who: str, place: str = "") -> float:
    """Check a grip force [N]; `who` and `place` begin and end the message.

    Raises
    ------
    UserError
        When it is not finite, or negative.
    """
    force = float(force)
    if math.isfinite(force) and force >= 0.0:
        return force
    where = f" {place}" if place else ""
    raise UserError(f"{who} {force!r} N{where}; a grip force is finite and not negative")
