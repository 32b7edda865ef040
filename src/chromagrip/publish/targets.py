"""Targets of readings: lines of JSON, and MCAP.

jsonl:-  jsonl:FILE  mcap:FILE
"""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np

from ..errors import UserError
from ..folders import disk_errors
from ..output.logs.entries import OK, WARNING
from ..output.logs.mcap_file import McapFile, Status
from ..render import Frame
from .message import Message

#: Keys of a message that are numbers of an MCAP file; `_low` and `_high` become subtopics.
_NUMBERS = ("margin", "margin_low", "margin_high", "mu", "normal_n", "friction_n", "late_s")
#: Sends a message, with the picture that it is of.
Send = Callable[[Message, Frame], None]


def check_targets(targets: Sequence[str]) -> None:
    """Refuse targets that cannot be used, before anything is opened.

    Raises
    ------
    UserError
    """
    for target in targets:
        _parsed(target)


def _parsed(target: str) -> tuple[Callable[[Path, ExitStack], Send], Path]:
    """Function that opens a target, and its file."""
    kind, _, place = target.partition(":")
    if kind not in ("jsonl", "mcap") or not place:
        raise UserError(f"--publish {target}: allowed are jsonl:-, jsonl:FILE and mcap:FILE")
    if kind == "mcap" and Path(place).exists():
        raise UserError(f"{place} exists already; give target {target!r} another name")
    return {"jsonl": _json_lines, "mcap": _mcap}[kind], Path(place)


@contextmanager
def publishing(targets: Sequence[str]) -> Iterator[list[Send]]:
    """Open targets; a context, which gives the function of each that sends a message.

    Raises
    ------
    UserError
        For a target that cannot be used.
    """
    with ExitStack() as stack:
        yield [open_target(path, stack) for open_target, path in map(_parsed, targets)]


def _json_lines(path: Path, stack: ExitStack) -> Send:
    """Lines of JSON into a file, or into the standard output for `-`."""
    with disk_errors(path):
        output: Any = nullcontext(sys.stdout.buffer) if str(path) == "-" else path.open("ab", 0)
    file = stack.enter_context(output)

    def send(message: Message, _: Frame) -> None:
        with disk_errors(path):
            file.write(msgspec.json.encode(message) + b"\n")
            file.flush()

    return send


def _mcap(path: Path, stack: ExitStack) -> Send:
    """An MCAP file of ROS 2 messages: wrench, margins, friction, diagnostics and pictures."""
    file = McapFile(path)
    stack.callback(file.close)

    def send(message: Message, frame: Frame) -> None:
        data = cv2.imencode(".jpg", frame.image[..., ::-1])[1].tobytes()
        file.picture(frame.time, "/image", data, "jpeg")
        for key in _NUMBERS:
            if message.get(key) is not None:
                topic = "/" + key.replace("_low", "/low").replace("_high", "/high")
                file.number(frame.time, topic, message[key])
        if message.get("force_x_n") is not None:
            force = np.array([message[f"force_{axis}_n"] for axis in "xyz"])
            torque = np.array([0.0, 0.0, 1e-3 * message["torque_nmm"]])
            file.wrench(frame.time, "/wrench", force, torque)
        concern = message["no_estimate"] or message["doubt"]
        level = WARNING if concern else OK
        file.diagnostics(frame.time, [Status("estimate", level, concern or "estimated", {})])

    return send
