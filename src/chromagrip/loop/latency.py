"""The controller's side of the loop: frames reach it late or never, and its answer is the grip.

With a latency of L frames the command at frame k answers frame k − L. Before frame L, and while no
frame arrives, the grip holds: at first at the controller's answer to the first frame.
"""

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from ..by_name import blaming
from ..control import Controller, GripObservation
from ..errors import UserError
from ..scene.scene import Scene

#: Stream of random numbers that lost and late frames are drawn from; those below are defects'.
DELIVERY_STREAM = 20


def arrivals(scene: Scene) -> NDArray[np.intp]:
    """Number of the frame at whose instant each frame reaches the controller, −1 for dropped ones.

    Drawn from the scene's seed; the first frame, which starts the grip, is never dropped.
    """
    rng = np.random.default_rng([scene.seed, DELIVERY_STREAM])
    lost, late = rng.random((scene.frames, 2)).T
    due = np.arange(scene.frames) + scene.camera.latency_frames + (late < scene.camera.late)
    due[1:][lost[1:] < scene.camera.dropped] = -1
    return due


class DelayedController:
    """A controller that is given each frame's observation after the latency.

    Parameters
    ----------
    controller: that answers
    name: of the controller, for messages
    due: frame at which each frame's observation arrives; see `arrivals`
    """

    def __init__(self, controller: Controller, name: str, due: NDArray[np.intp]) -> None:
        self._controller = controller
        self._name = name
        self._due = due
        self._waiting: deque[tuple[int, GripObservation]] = deque()
        self._grip = math.nan
        self._reset()

    def command(self, index: int, observation: GripObservation | None) -> float:
        """Force commanded from frame `index` on [N].

        Parameters
        ----------
        index: of the frame
        observation: of the frame; None of a dropped one

        Raises
        ------
        UserError
            When the controller raises, or its answer is not a finite force of at least 0.
        """
        if observation is not None:
            self._waiting.append((index, observation))
            if index == 0:
                self._grip = self._answer(index, observation)
                self._reset()
        while self._waiting and self._due[self._waiting[0][0]] <= index:
            self._grip = self._answer(*self._waiting.popleft())
        return self._grip

    def _reset(self) -> None:
        failure = f"controller {self._name} failed before the first sample"
        with blaming(failure, Exception, SystemExit):
            self._controller.reset()

    def _answer(self, index: int, observation: GripObservation) -> float:
        """Force that the controller commands for the observation of frame `index` [N]."""
        place = f"at t = {observation.time:.4g} s, sample {index}"
        with blaming(f"controller {self._name} failed {place}", Exception, SystemExit):
            force = float(self._controller.command(observation).force)
        if math.isfinite(force) and force >= 0.0:
            return force
        raise UserError(
            f"controller {self._name} commanded {force!r} N {place}; a grip force is finite and "
            "not negative"
        )
