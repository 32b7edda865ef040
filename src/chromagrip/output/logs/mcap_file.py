"""A log as an MCAP file of ROS 2 messages, for ros2, Foxglove, Lichtblick, PlotJuggler and Rerun.

Its profile is `ros2`: messages are encoded as CDR, and their schemas are ROS 2's own definitions.
"""

import heapq
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache, partial
from itertools import count
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...errors import UserError
from ...extras import need
from ...folders import GrowingFile, disk_errors
from ..versions import versions
from .entries import Array, Condition, Encoding, Log, Pictures, Signal, Wrench, nanoseconds

#: Time [s] of a message, and the function that writes it.
Sent = tuple[float, Callable[[], None]]


class Status(NamedTuple):
    """Condition at one instant.

    Attributes
    ----------
    name: name of the condition, such as `markers`
    level: OK, WARNING or ERROR
    message: the condition in words
    values: further numbers by their names, with the unit in the name
    """

    name: str
    level: int
    message: str
    values: Mapping[str, float]


class McapFile(GrowingFile):
    """MCAP file whose messages are written as they are made, in the order of their times.

    Each message has the time of its frame as its time. A topic begins with its first message; the
    keywords of a method then become metadata of the topic, such as `unit` and `meaning`.

    Parameters
    ----------
    path: path of the file; it gets that name when it is closed

    Raises
    ------
    UserError
        When it cannot be written, such as on a full disk; nothing of it is left. When the extra
        `ros` is missing.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        writer = need("mcap.writer", "ros").Writer
        _types()
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._numbers = count()
        with disk_errors(path):
            self._file = self._part.open("wb")
        self._writer = writer(self._file)
        with self._written():
            self._writer.start("ros2", f"chromagrip {versions()['chromagrip']}")

    def number(self, time: float, topic: str, value: float, **about: str) -> None:
        """Write a number as `std_msgs/msg/Float64`; `time` is in seconds."""
        self._send(time, topic, "std_msgs/msg/Float64", about, data=float(value))

    def wrench(self, time: float, topic: str, force: Array, torque: Array, **about: str) -> None:
        """Write a wrench as `geometry_msgs/msg/WrenchStamped`.

        Parameters
        ----------
        time: instant [s]
        topic: topic; what stands before `wrench` in it is the finger
        force: along x, y, z [N]
        torque: about x, y, z [N·m]
        about: metadata of the topic
        """
        vector = partial(_made, "geometry_msgs/msg/Vector3")
        pair = {
            name: vector(**dict(zip("xyz", map(float, values), strict=True)))
            for name, values in (("force", force), ("torque", torque))
        }
        frame = topic.strip("/").rpartition("wrench")[0] + "fingertip"
        made = _made("geometry_msgs/msg/Wrench", **pair)
        kind = "geometry_msgs/msg/WrenchStamped"
        self._send(time, topic, kind, about, header=_header(time, frame), wrench=made)

    def picture(
        self, time: float, topic: str, data: bytes, encoding: Encoding, **about: str
    ) -> None:
        """Write a picture as `sensor_msgs/msg/CompressedImage`; `time` is in seconds."""
        header, kind = _header(time, topic.strip("/")), "sensor_msgs/msg/CompressedImage"
        pixels = np.frombuffer(data, np.uint8)
        self._send(time, topic, kind, about, header=header, format=encoding, data=pixels)

    def diagnostics(self, time: float, statuses: Sequence[Status]) -> None:
        """Write all conditions of an instant [s] as `diagnostic_msgs/msg/DiagnosticArray`.

        Panels of diagnostics look for them in the topic `/diagnostics`.
        """
        pair, status = "diagnostic_msgs/msg/KeyValue", "diagnostic_msgs/msg/DiagnosticStatus"
        made = [
            _made(
                status,
                level=each.level,
                name=each.name,
                message=each.message,
                hardware_id="chromagrip",
                values=[_made(pair, key=key, value=f"{v:g}") for key, v in each.values.items()],
            )
            for each in statuses
        ]
        kind = "diagnostic_msgs/msg/DiagnosticArray"
        self._send(time, "/diagnostics", kind, {}, header=_header(time, ""), status=made)

    def facts(self, facts: Mapping[str, str]) -> None:
        """Write metadata of the file."""
        with self._written():
            self._writer.add_metadata("chromagrip", dict(facts))

    def attach(self, name: str, text: str) -> None:
        """Attach a text file."""
        with self._written():
            self._writer.add_attachment(0, 0, name, "text/plain", text.encode())

    def discard(self) -> None:
        """Remove the file; it gets no name."""
        with suppress(OSError):
            self._file.close()
        with suppress(OSError):
            self._part.unlink()

    def _send(
        self, time: float, topic: str, kind: str, about: Mapping[str, str], **fields: object
    ) -> None:
        data = _types().serialize_cdr(_made(kind, **fields), kind)
        with self._written():
            if topic not in self._channels:
                self._channels[topic] = self._open(topic, kind, about)
            stamp, number = _stamp(time), next(self._numbers)
            self._writer.add_message(self._channels[topic], stamp, bytes(data), stamp, number)

    def _open(self, topic: str, kind: str, about: Mapping[str, str]) -> int:
        """Open a channel for messages of a type; returns its number."""
        if kind not in self._schemas:
            text, _ = _types().generate_msgdef(kind, ros_version=2)
            self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", text.encode())
        # The profile requires this key; if it is empty, `ros2 bag play` offers its own default.
        metadata = {"offered_qos_profiles": "", **about}
        return int(self._writer.register_channel(topic, "cdr", self._schemas[kind], metadata))

    @contextmanager
    def _written(self) -> Iterator[None]:
        """Turn a disk error into one sentence, and remove the file."""
        try:
            with disk_errors(self._path):
                yield
        except UserError:
            self.discard()
            raise

    def _finish(self) -> None:
        try:
            self._writer.finish()
        finally:
            self._file.close()


def write_mcap(log: Log, path: Path) -> None:
    """Write a log as an MCAP file, which is whole or not there.

    The unit and the meaning of a topic are in its metadata, the results of the run in the file's,
    and its scene is attached.

    Raises
    ------
    UserError
        When it cannot be written, such as on a full disk.
    """
    with McapFile(path) as file:
        try:
            for _, send in heapq.merge(*_streams(log, file), key=itemgetter(0)):
                send()
            file.facts({"run": log.name, **log.facts})
            file.attach("scene.toml", log.scene)
        except BaseException:
            file.discard()
            raise


def _streams(log: Log, file: McapFile) -> Iterator[Iterator[Sent]]:
    """Messages of each topic, in the order of their times."""
    for pictures in log.pictures:
        yield _sent_pictures(pictures, file)
    for signal in log.signals:
        ends = {"": signal.values, "/low": signal.low, "/high": signal.high}
        for end, values in ends.items():
            if values is not None:
                yield _sent_numbers(signal, end, values, file)
    for wrench in log.wrenches:
        yield _sent_wrenches(wrench, file)
    if log.conditions:
        yield _sent_conditions(log.conditions, file)


def _sent_pictures(pictures: Pictures, file: McapFile) -> Iterator[Sent]:
    send = partial(file.picture, meaning=pictures.meaning)
    for time, data in pictures.read():
        yield time, partial(send, time, pictures.topic, data, pictures.encoding)


def _sent_numbers(signal: Signal, end: str, values: Array, file: McapFile) -> Iterator[Sent]:
    """Finite numbers of a signal, or of the lower or upper end of its interval."""
    meaning = signal.meaning + (f", {end[1:]} end of the 90 % interval" if end else "")
    send = partial(file.number, unit=signal.unit, meaning=meaning)
    known = np.isfinite(values)
    for time, value in zip(signal.times[known].tolist(), values[known].tolist(), strict=True):
        yield time, partial(send, time, signal.topic + end, value)


def _sent_wrenches(wrench: Wrench, file: McapFile) -> Iterator[Sent]:
    send = partial(file.wrench, unit="N, N·m", meaning=wrench.meaning)
    for time, force, torque in zip(wrench.times.tolist(), wrench.force, wrench.torque, strict=True):
        yield time, partial(send, time, wrench.topic, force, torque)


def _sent_conditions(conditions: Sequence[Condition], file: McapFile) -> Iterator[Sent]:
    """All conditions of a frame in one message; they have the same times."""
    for k, time in enumerate(conditions[0].times.tolist()):
        statuses = [
            Status(
                name=each.name,
                level=int(each.levels[k]),
                message=each.messages[k],
                values={key: column[k] for key, column in each.values.items()},
            )
            for each in conditions
        ]
        yield time, partial(file.diagnostics, time, statuses)


@cache
def _types() -> Any:
    """Types of ROS 2 Jazzy; those that are used are the same in every release from Humble on."""
    typesys = need("rosbags.typesys", "ros")
    return typesys.get_typestore(typesys.Stores.ROS2_JAZZY)


def _made(kind: str, **fields: object) -> Any:
    """Message of a type."""
    return _types().types[kind](**fields)


def _stamp(time: float) -> int:
    """Time [ns] of a time [s]."""
    return int(nanoseconds(np.float64(time)))


def _header(time: float, frame: str) -> Any:
    """Header of a message at a time [s]."""
    seconds, rest = divmod(_stamp(time), 1_000_000_000)
    stamp = _made("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
    return _made("std_msgs/msg/Header", stamp=stamp, frame_id=frame)
