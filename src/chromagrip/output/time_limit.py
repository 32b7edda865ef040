"""Calls of what may never answer: a user's controller, a camera, a gripper."""

import math
import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Any


class NoAnswerError(TimeoutError):
    """What was called did not answer in time; it is left behind, still at work."""


class TimeLimit:
    """Calls functions one after another in a thread of its own, and waits for each so long.

    A thread cannot be ended from outside. One that does not answer is left behind, and does not
    keep the process from ending.

    Parameters
    ----------
    seconds: to wait for an answer; infinite calls in the caller's thread, without a limit
    """

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._asked: SimpleQueue[tuple[Callable[..., Any], tuple[Any, ...]]] = SimpleQueue()
        self._answers: SimpleQueue[tuple[Any, BaseException | None]] = SimpleQueue()
        self._thread: threading.Thread | None = None
        self._late = False

    def call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """What the function returns, or raises.

        Raises
        ------
        NoAnswerError
            When it does not answer in time, or one before it did not.
        """
        if self.seconds == math.inf:
            return function(*arguments)
        if self._late:
            raise NoAnswerError
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, daemon=True)
            self._thread.start()
        self._asked.put((function, arguments))
        try:
            answer, error = self._answers.get(timeout=self.seconds)
        except Empty:
            self._late = True
            raise NoAnswerError from None
        if error is not None:
            raise error
        return answer

    def _work(self) -> None:
        while True:
            function, arguments = self._asked.get()
            try:
                self._answers.put((function(*arguments), None))
            except BaseException as error:
                self._answers.put((None, error))
