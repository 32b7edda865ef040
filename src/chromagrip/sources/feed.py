"""Frames of a source as they come, and a refusal when they stop coming."""

import threading
import time
from contextlib import suppress
from queue import Empty, Full, Queue
from typing import Any

from ..errors import UserError
from ..render import Frame
from .source import Source


class Feed:
    """Frames of a source, read in a thread of their own.

    A live camera's newest frame replaces the waiting one: a loop that is slower than the camera
    skips frames, and does not fall behind. No frame of another source is skipped.

    Parameters
    ----------
    source: source of the frames
    limit: time in which the next frame must come [s]
    """

    def __init__(self, source: Source, limit: float) -> None:
        self.source, self.limit = source, limit
        self.given = self.skipped = 0
        #: Time at which the last frame came, by `time.monotonic` [s].
        self.arrived = 0.0
        self._waiting: Queue[tuple[Frame | BaseException | None, float]] = Queue(maxsize=1)
        self._closed = threading.Event()
        threading.Thread(target=self._read, daemon=True).start()

    @property
    def counts(self) -> dict[str, Any]:
        """Values of a summary: frames that the loop skipped, and the delivery of the source."""
        return {"frames_skipped": self.skipped, "delivery": self.source.delivery.counts}

    def next(self) -> Frame | None:
        """Wait for the next frame; None at the end.

        Raises
        ------
        UserError
            When no frame comes in time, or the source fails.
        """
        try:
            found, self.arrived = self._waiting.get(timeout=min(self.limit, threading.TIMEOUT_MAX))
        except Empty:
            raise UserError(
                f"{self.source.name} gave no frame within {self.limit:g} s after "
                f"{self.given} frames"
            ) from None
        if isinstance(found, BaseException):
            raise found
        self.given += found is not None
        return found

    def close(self) -> None:
        """Stop reading."""
        self._closed.set()

    def _read(self) -> None:
        end: BaseException | None = None
        try:
            for frame in self.source.frames():
                self._put(frame)
                if self._closed.is_set():
                    break
        except BaseException as error:
            end = error
        self._put(end, last=True)

    def _put(self, found: Frame | BaseException | None, last: bool = False) -> None:
        came = found, time.monotonic()
        check_s = 0.1  # interval at which a waiting feed checks whether it was closed [s]
        while not self._closed.is_set():
            try:
                self._waiting.put(came, timeout=0.0 if self.source.live else check_s)
                return
            except Full:
                if self.source.live and not last:
                    with suppress(Empty):
                        self._waiting.get_nowait()
                        self.skipped += 1
