"""The other end of published readings, for controllers and loggers."""

import select
import socket
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

from ..errors import UserError
from ..extras import need
from .message import Message, decoded
from .targets import address

#: Longest datagram [bytes].
_LONGEST = 65535


class Subscriber:
    """Takes the newest message that has come; older ones that wait are left out. A context.

    Parameters
    ----------
    source: `udp:PORT`, `udp:HOST:PORT`, `zmq:PORT` or `zmq:HOST:PORT` of `estimate --publish`

    Attributes
    ----------
    skipped: number of messages that were left out so far

    Raises
    ------
    UserError
        For a source of another kind, and a port that is in use.
    """

    def __init__(self, source: str) -> None:
        self._source, self.skipped = source, 0
        host, port = address(source)
        self._wait: Callable[[float], bool]
        self._take: Callable[[], bytes]
        self._close: Callable[[], Any] | None
        if source.startswith("udp:"):
            made = socket.socket(
                socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM
            )
            try:
                made.bind((host, port))
            except OSError as error:
                made.close()
                raise UserError(f"{source} cannot be listened to: {error.strerror}") from None
            made.setblocking(False)
            self._wait = lambda left: bool(select.select([made], [], [], left)[0])
            self._take = lambda: made.recv(_LONGEST)
            self._close = made.close
        elif source.startswith("zmq:"):
            zmq = need("zmq", "zmq")
            context = zmq.Context()
            made = context.socket(zmq.SUB)
            made.setsockopt(zmq.SUBSCRIBE, b"")
            made.setsockopt(zmq.LINGER, 0)
            made.connect(f"tcp://{host}:{port}")
            self._wait = lambda left: bool(made.poll(1e3 * left))
            self._take = lambda: made.recv(zmq.NOBLOCK)
            self._close = lambda: (made.close(), context.term())
        else:
            raise UserError(f"{source!r} is no source of messages; allowed are udp: and zmq:")

    def next(self, timeout: float) -> Message | None:
        """Wait for a message, and return the newest; None if none comes in time [s].

        Raises
        ------
        UserError
            For a message of another version, or that is none.
        """
        end = time.monotonic() + timeout
        if not self._wait(max(0.0, end - time.monotonic())):
            return None
        data = self._take()
        while self._wait(0.0):
            data = self._take()
            self.skipped += 1
        return decoded(data, self._source)

    def close(self) -> None:
        """Close the connection; closing it again does nothing."""
        close, self._close = self._close, None
        if close is not None:
            close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
