"""The other end of published readings, for controllers and loggers."""

from threading import Condition, Thread
from typing import IO, Any

import msgspec

from ..errors import UserError
from .message import SCHEMA, Message


class Subscriber:
    """Reads published lines of a pipe, and keeps the newest one that has come.

    Parameters
    ----------
    pipe: end of a pipe, such as `sys.stdin.buffer` or the `stdout` of a process; a thread reads it

    Attributes
    ----------
    skipped: number of messages so far that newer ones replaced
    """

    def __init__(self, pipe: IO[bytes]) -> None:
        self.skipped, self._newest, self._changed = 0, b"", Condition()
        self._reader = Thread(target=self._read, args=(pipe,), daemon=True)
        self._reader.start()

    def _read(self, pipe: IO[bytes]) -> None:
        for line in pipe:
            with self._changed:
                self.skipped += bool(self._newest)
                self._newest = line
                self._changed.notify()

    @property
    def ended(self) -> bool:
        """Whether the pipe has ended, and its last message was taken."""
        return not (self._reader.is_alive() or self._newest)

    def next(self, timeout: float) -> Message | None:
        """Wait for a message, and return the newest; None if none comes in time [s].

        Raises
        ------
        UserError
            For a line that is no message of this version.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._newest, timeout)
            line, self._newest = self._newest, b""
        return _decoded(line) if line else None


def _decoded(line: bytes) -> Message:
    try:
        message: Message = msgspec.json.decode(line, type=dict[str, Any])
    except msgspec.DecodeError:
        message = {}
    if (schema := message.get("schema")) != SCHEMA:
        what = "no reading" if schema is None else f"a message of the schema {schema!r}"
        raise UserError(f"the pipe has {what}; wanted: {SCHEMA!r}")
    return message
