"""A log as an MCAP file, for Foxglove, Lichtblick and PlotJuggler."""

import heapq
from collections.abc import Iterator, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from ...extras import need
from ..versions import versions
from .entries import Condition, Log, Pictures, Signal, Wrench, nanoseconds
from .messages import message

#: Time [ns], channel, and bytes of a message.
Sent = tuple[int, int, bytes]


def write_mcap(log: Log, path: Path) -> None:
    """Write a log as an MCAP file; each message has the time of the run as its time.

    The unit and the meaning of a channel are in its metadata, the results of the run in the file's,
    and its scene is attached.
    """
    writer = need("mcap.writer", "ros").Writer
    with path.open("wb") as file:
        into = writer(file)
        into.start(library=f"chromagrip {versions()['chromagrip']}")
        streams = list(_streams(log, _Channels(into)))
        for number, (time, channel, data) in enumerate(heapq.merge(*streams, key=itemgetter(0))):
            into.add_message(channel, log_time=time, publish_time=time, data=data, sequence=number)
        into.add_metadata("chromagrip", {"run": log.name, **log.facts})
        into.add_attachment(0, 0, "scene.toml", "text/plain", log.scene.encode())
        into.finish()


class _Channels:
    """Channels of a file, with one schema for each type of message.

    Parameters
    ----------
    writer: of the file
    """

    def __init__(self, writer: Any) -> None:
        self._writer = writer
        self._schemas: dict[str, int] = {}

    def open(self, topic: str, name: str, **about: str) -> int:
        """Number of a new channel for messages of a type; `about` is its metadata."""
        if name not in self._schemas:
            schema = need("mcap_protobuf.schema", "ros")
            self._schemas[name] = schema.register_schema(self._writer, message(name))
        return int(
            self._writer.register_channel(
                topic=topic,
                message_encoding="protobuf",
                schema_id=self._schemas[name],
                metadata=about,
            )
        )


def _streams(log: Log, channels: _Channels) -> Iterator[Iterator[Sent]]:
    """Messages of each channel, in the order of their times."""
    for pictures in log.pictures:
        name = "foxglove.CompressedImage"
        yield _sent_pictures(
            pictures, channels.open(pictures.topic, name, meaning=pictures.meaning)
        )
    for signal in log.signals:
        name = "chromagrip.Value" if signal.low is None else "chromagrip.Estimate"
        about = {"unit": signal.unit, "meaning": signal.meaning}
        yield _sent_signal(signal, message(name), channels.open(signal.topic, name, **about))
    for wrench in log.wrenches:
        name, about = "ros.geometry_msgs.WrenchStamped", {"unit": "N, N·m"}
        channel = channels.open(wrench.topic, name, meaning=wrench.meaning, **about)
        yield _sent_wrench(wrench, message(name), channel)
    # Topic of the conditions; panels of diagnostics look for them there.
    diagnostics = "/diagnostics"
    if log.conditions:
        name = "ros.diagnostic_msgs.DiagnosticArray"
        yield _sent_conditions(log.conditions, message(name), channels.open(diagnostics, name))


def _stamp(into: Any, time: int) -> None:
    """Set a Timestamp to a time [ns]."""
    into.seconds, into.nanos = divmod(time, 1_000_000_000)


def _sent_pictures(pictures: Pictures, channel: int) -> Iterator[Sent]:
    kind = message("foxglove.CompressedImage")
    for seconds, data in pictures.read():
        time = int(nanoseconds(np.float64(seconds)))
        made = kind(data=data, format=pictures.encoding, frame_id=pictures.topic.strip("/"))
        _stamp(made.timestamp, time)
        yield time, channel, made.SerializeToString()


def _sent_signal(signal: Signal, kind: Any, channel: int) -> Iterator[Sent]:
    columns = {"value": signal.values}
    if signal.low is not None and signal.high is not None:
        columns |= {"low": signal.low, "high": signal.high}
    for k, time in enumerate(nanoseconds(signal.times).tolist()):
        made = kind(**{name: column[k] for name, column in columns.items()})
        _stamp(made.timestamp, time)
        yield time, channel, made.SerializeToString()


def _sent_wrench(wrench: Wrench, kind: Any, channel: int) -> Iterator[Sent]:
    times = nanoseconds(wrench.times).tolist()
    for time, force, torque in zip(times, wrench.force, wrench.torque, strict=True):
        made = kind()
        _stamp(made.header.stamp, time)
        made.header.frame_id = wrench.topic.strip("/").rpartition("wrench")[0] + "fingertip"
        for into, vector in ((made.wrench.force, force), (made.wrench.torque, torque)):
            into.x, into.y, into.z = vector
        yield time, channel, made.SerializeToString()


def _sent_conditions(conditions: Sequence[Condition], kind: Any, channel: int) -> Iterator[Sent]:
    """All conditions of a frame in one message; they have the same times."""
    for k, time in enumerate(nanoseconds(conditions[0].times).tolist()):
        made = kind()
        _stamp(made.header.stamp, time)
        for condition in conditions:
            status = made.status.add(
                level=int(condition.levels[k]),
                name=condition.name,
                message=condition.messages[k],
                hardware_id="chromagrip",
            )
            for key, column in condition.values.items():
                status.values.add(key=key, value=f"{column[k]:g}")
        yield time, channel, made.SerializeToString()
