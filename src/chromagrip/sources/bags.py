"""Frames of ROS 2 bags: a folder with `metadata.yaml`, an MCAP or an SQLite file."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import UserError, meant
from ..extras import need, require
from ..render import Frame
from ..stored_pictures import Image, check_pixels
from ..strange_files import need_file
from .picture_files import PNG_BEGIN, decoded_picture
from .source import Source, ValueRange, rated

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.rosbag2 import Reader

_RAW, _COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
#: Channels of each encoding of raw pictures, and the part with red, green and blue.
_ENCODINGS = {
    "rgb8": (3, slice(None)),
    "bgr8": (3, slice(None, None, -1)),
    "mono8": (1, slice(None)),
    "rgba8": (4, slice(3)),
    "bgra8": (4, slice(2, None, -1)),
}


def is_bag(path: Path) -> bool:
    """Whether a path is that of a bag: by its suffix, or by what its folder holds."""
    if path.is_dir():
        about = path / "metadata.yaml"
        with suppress(OSError):
            if about.is_file():
                with about.open("rb") as file:
                    return b"rosbag2_bagfile_information" in file.read(10_000)
        return False
    return path.suffix.lower() in (".mcap", ".db3") and path.is_file()


def bag_source(
    name: str,
    path: Path,
    arguments: Mapping[str, Any],
    fps: float | None,
    max_megapixels: float,
    value_range: ValueRange = None,
) -> Source:
    """Source of a bag.

    Parameters
    ----------
    name: that the user gave
    path: folder or file
    arguments: `topic`, needed where several topics have pictures
    fps: rate that overrides the times of the messages [Hz]
    max_megapixels: largest picture that is decoded
    value_range: values of black and white in compressed pictures of more than 8 bits

    Raises
    ------
    UserError
        When the bag cannot be read, or does not have that topic.
    """
    if unknown := [key for key in arguments if key != "topic"]:
        question = meant(unknown[0], ["topic"])
        raise UserError(f"bag {path} has no argument {unknown[0]}{question}; it has topic")
    asked = str(arguments.get("topic", ""))
    with _opened(path) as bag:
        topic = _connections(bag, path, asked)
        first = next(iter(bag.messages(connections=topic)), None)
        lossy = first is not None and (
            first[0].msgtype == _COMPRESSED and PNG_BEGIN not in first[2][:1000]
        )
        count, span = sum(each.msgcount for each in topic), 1e-9 * (bag.duration - 1)
    own = (count - 1) / span if span > 0.0 else 0.0
    rate, rate_from = rated(fps, own, "the bag's own")
    return Source(
        name=name,
        frames=partial(_frames, path, asked, fps, max_megapixels, value_range),
        count=count,
        fps=rate,
        fps_from=rate_from,
        timed=fps is None,
        lossy=lossy,
    )


@contextmanager
def _opened(path: Path) -> "Iterator[Reader]":
    """Open a bag; errors of a damaged one become one sentence."""
    require("ros", purpose="reading a bag")
    bags = need("rosbags.rosbag2", "ros")
    try:
        for each in path.iterdir() if path.is_dir() else [path]:
            need_file(each, f"bag {path}: {each.name}")
        with bags.Reader(path) as bag:
            yield bag
    except UserError:
        raise
    except Exception as error:  # of any kind, as the file is a stranger's
        reason = f"{type(error).__name__}: {error}"
        raise UserError(f"{path} cannot be read as a ROS 2 bag: {reason}") from error


def _connections(bag: "Reader", path: Path, topic: str) -> "list[Connection]":
    """Connections of the topic with pictures; a refusal lists those that there are."""
    pictures = [each for each in bag.connections if each.msgtype in (_RAW, _COMPRESSED)]
    names = sorted({each.topic for each in pictures})
    if not names:
        there = sorted({f"{each.topic} ({each.msgtype})" for each in bag.connections})
        raise UserError(
            f"bag {path} has no pictures ({_RAW} or {_COMPRESSED}); it has "
            f"{', '.join(there) or 'no topics'}"
        )
    if topic and topic not in names:
        raise UserError(
            f"bag {path} has no pictures in topic {topic}{meant(topic, names)}; they are in "
            f"{', '.join(names)}"
        )
    if not topic and len(names) > 1:
        raise UserError(
            f"bag {path} has pictures in {', '.join(names)}; give one of them, such as "
            f"{path}(topic={names[0]})"
        )
    return [each for each in pictures if each.topic == (topic or names[0])]


def _frames(
    path: Path, asked: str, fps: float | None, max_megapixels: float, value_range: ValueRange
) -> Iterator[Frame]:
    """Frames with the time since the first one, or evenly at `fps`."""
    stores = need("rosbags.typesys", "ros")
    store = stores.get_typestore(stores.Stores.ROS2_HUMBLE)
    with _opened(path) as bag:
        topic, begin = _connections(bag, path, asked), 0
        for index, (sent, logged, data) in enumerate(bag.messages(connections=topic)):
            message = store.deserialize_cdr(data, sent.msgtype)
            stamp = message.header.stamp
            instant = 1_000_000_000 * stamp.sec + stamp.nanosec or logged
            begin = instant if index == 0 else begin
            name = f"message {index} of {sent.topic} in {path}"
            image = _picture(message, sent.msgtype, name, max_megapixels, value_range)
            time = 1e-9 * (instant - begin) if fps is None else index / fps
            yield Frame(image=image, time=time)


def _picture(
    message: Any, kind: str, name: str, max_megapixels: float, value_range: ValueRange
) -> Image:
    """Picture of a message."""
    if kind == _COMPRESSED:
        data = message.data.tobytes()
        return decoded_picture(data, name, "jpeg or png", max_megapixels, value_range)
    if message.encoding not in _ENCODINGS:
        raise UserError(
            f"{name} has the encoding {message.encoding}; wanted: {', '.join(_ENCODINGS)}"
        )
    channels, colours = _ENCODINGS[message.encoding]
    height, width, step = message.height, message.width, message.step
    check_pixels(width, height, name, max_megapixels)
    if not 0 < channels * width <= step or len(message.data) != step * height or not height:
        raise UserError(
            f"{name} has {len(message.data)} bytes for {width}×{height} pixels of "
            f"{message.encoding} in rows of {step}"
        )
    rows = message.data.reshape(height, step)[:, : channels * width]
    pixels = rows.reshape(height, width, channels)[..., colours]
    return np.array(np.broadcast_to(pixels, (height, width, 3)))
