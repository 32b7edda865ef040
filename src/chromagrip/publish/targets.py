"""Readings that leave while they are made: lines of JSON, UDP, ZeroMQ, MCAP.

    jsonl:-  jsonl:FILE  udp:HOST:PORT  udp:PORT  zmq:HOST:PORT  zmq:PORT  mcap:FILE

The host is this machine unless another is named.
"""

import socket
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self

import cv2
import numpy as np

from ..errors import UserError
from ..extras import need
from ..folders import disk_errors
from ..output.logs.entries import OK, WARNING
from ..output.logs.mcap_file import McapFile, Status
from ..render import Frame
from .message import Message, encoded

#: The host that is meant where none is named.
LOOPBACK = "127.0.0.1"
#: Allowed targets, for messages.
TARGETS = "jsonl:-, jsonl:FILE, udp:PORT, udp:HOST:PORT, zmq:PORT, zmq:HOST:PORT, mcap:FILE"


class Publisher(Protocol):
    """Sends each message on."""

    def send(self, message: Message, frame: Frame) -> None:
        """Send a message, with the picture that it is of."""

    def close(self) -> None:
        """End the file or connection."""


class Publishers:
    """Publishers of some targets, which are closed together; a context.

    Parameters
    ----------
    targets: see above

    Raises
    ------
    UserError
        For a target that cannot be used, as a port that is in use.
    """

    def __init__(self, targets: Sequence[str]) -> None:
        self._stack = ExitStack()
        self._all: list[Publisher] = []
        try:
            for target in targets:
                made = _opened(target)
                self._all.append(made)
                self._stack.callback(made.close)
        except BaseException:
            self._stack.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def __bool__(self) -> bool:
        return bool(self._all)

    def send(self, message: Message, frame: Frame) -> None:
        """Send a message to every target."""
        for one in self._all:
            one.send(message, frame)


def check_targets(targets: Sequence[str]) -> None:
    """Refuse targets that cannot be used, before anything is opened.

    Raises
    ------
    UserError
    """
    for target in targets:
        kind, place = _split(target)
        if kind in ("udp", "zmq"):
            address(target)
        elif not place:
            raise UserError(f"target {target!r} names no file; allowed are {TARGETS}")


def address(target: str) -> tuple[str, int]:
    """Host and port of a target or a source of messages, such as udp:PORT or zmq:HOST:PORT.

    Raises
    ------
    UserError
        For a port that is none.
    """
    host, _, port = target.partition(":")[2].rpartition(":")
    if not port.isdecimal() or not 0 < int(port) < 65536:
        raise UserError(f"target {target!r} has no port from 1 to 65535; allowed are {TARGETS}")
    return host.strip("[]") or LOOPBACK, int(port)


def _split(target: str) -> tuple[str, str]:
    kind, _, place = target.partition(":")
    if kind not in _KINDS:
        raise UserError(f"target {target!r} is of no known kind; allowed are {TARGETS}")
    return kind, place


def _opened(target: str) -> Publisher:
    check_targets([target])
    return _KINDS[_split(target)[0]](target)


class JsonLines:
    """Lines of JSON into a file or the standard output."""

    def __init__(self, target: str) -> None:
        self._path = Path(target.removeprefix("jsonl:"))
        self._own = str(self._path) != "-"
        with disk_errors(self._path):
            self._file: Any = self._path.open("ab", 0) if self._own else sys.stdout.buffer

    def send(self, message: Message, frame: Frame) -> None:
        """Append a line."""
        with disk_errors(self._path):
            self._file.write(encoded(message) + b"\n")
            self._file.flush()

    def close(self) -> None:
        """Close the file."""
        if self._own:
            self._file.close()


class Udp:
    """A datagram of JSON for each message; nobody need listen."""

    def __init__(self, target: str) -> None:
        host, port = address(target)
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        except OSError as error:
            raise UserError(f"target {target!r}: host {host} is not known: {error}") from None
        self._to, self._socket = found[4], socket.socket(*found[:3])
        self._socket.setblocking(False)
        self._target = target

    def send(self, message: Message, frame: Frame) -> None:
        """Send a datagram; one that finds the line full is lost, as datagrams may be."""
        try:
            self._socket.sendto(encoded(message), self._to)
        except (BlockingIOError, ConnectionRefusedError):
            return
        except OSError as error:
            raise UserError(f"target {self._target!r} failed: {error.strerror}") from None

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class Zmq:
    """A PUB socket of ZeroMQ, to which any number of SUB sockets connect."""

    def __init__(self, target: str) -> None:
        zmq = need("zmq", "zmq")
        host, port = address(target)
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.PUB)
        self._socket.setsockopt(zmq.LINGER, 200)  # how long a close waits for the last one [ms]
        try:
            self._socket.bind(f"tcp://{host}:{port}")
        except zmq.ZMQError as error:
            self.close()
            raise UserError(f"target {target!r} cannot be used: {error.strerror}") from None

    def send(self, message: Message, frame: Frame) -> None:
        """Send a message to those who are connected."""
        self._socket.send(encoded(message))

    def close(self) -> None:
        """Close socket and context."""
        self._socket.close()
        self._context.term()


class Mcap:
    """An MCAP file of ROS 2 messages: wrench, margins, friction, diagnostics and pictures."""

    #: Topics of numbers, by the key of a message.
    _topics: ClassVar[Mapping[str, str]] = {
        "margin": "/margin",
        "margin_low": "/margin/low",
        "margin_high": "/margin/high",
        "mu": "/mu",
        "normal_n": "/normal_n",
        "friction_n": "/friction_n",
        "late_s": "/late_s",
    }

    def __init__(self, target: str) -> None:
        path = Path(target.removeprefix("mcap:"))
        if path.exists():
            raise UserError(f"{path} exists already; give target {target!r} another name")
        self._file = McapFile(path)

    def send(self, message: Message, frame: Frame) -> None:
        """Append the messages of a frame."""
        time = frame.time
        data = cv2.imencode(".jpg", frame.image[..., ::-1])[1].tobytes()
        self._file.picture(time, "/image", data, "jpeg")
        for key, topic in self._topics.items():
            if message.get(key) is not None:
                self._file.number(time, topic, message[key])
        if message.get("force_x_n") is not None:
            force = np.array([message[f"force_{axis}_n"] for axis in "xyz"])
            torque = np.array([0.0, 0.0, 1e-3 * message["torque_nmm"]])
            self._file.wrench(time, "/wrench", force, torque)
        reason = message["no_estimate"]
        level = WARNING if reason or message["doubt"] else OK
        words = reason or message["doubt"] or "estimated"
        self._file.diagnostics(time, [Status("estimate", level, words, {})])

    def close(self) -> None:
        """Give the file its name."""
        self._file.close()


_KINDS: dict[str, Callable[[str], Publisher]] = {
    "jsonl": JsonLines,
    "udp": Udp,
    "zmq": Zmq,
    "mcap": Mcap,
}
