"""An MCAP file whose messages are written as they are made is of ROS 2, to the last bit."""

import math
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import NonSeekingReader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from chromagrip import UserError
from chromagrip.output.logs.entries import WARNING
from chromagrip.output.logs.mcap_file import McapFile, Status

#: Hashes of definitions as ROS 2 publishes them beside its messages (REP 2011).
PUBLISHED = {
    "std_msgs/msg/Float64": "705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a",
    "geometry_msgs/msg/WrenchStamped": (
        "8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77"
    ),
    "diagnostic_msgs/msg/DiagnosticArray": (
        "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"
    ),
    "sensor_msgs/msg/CompressedImage": (
        "15640771531571185e2efc8a100baf923961a4d15d5569652e6cb6691e8e371a"
    ),
}
FORCE, TORQUE = np.array([0.1, -1e-300, -math.pi]), np.array([0.0, 0.0, 1e-3 / 3.0])
#: A time whose nanoseconds are not whole microseconds [s].
TIME = 1_700_000_000.123456


def write(file: McapFile) -> None:
    """Write a message of every kind."""
    file.number(0.1 + 0.2, "/margin", 0.1 + 0.2, unit="1", meaning="margin")
    file.wrench(1.5, "/first/wrench", FORCE, TORQUE)
    file.picture(2.0, "/camera", b"\x89PNG\x00\xff", "png")
    values = {"late_ms": 2.5}
    file.diagnostics(TIME, [Status("estimate", WARNING, "keine Kraft: µ", values)])


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """File that was closed."""
    with McapFile(tmp_path / "live.mcap") as file:
        write(file)
    return tmp_path / "live.mcap"


def raw(path: Path) -> dict[str, tuple[int, bytes]]:
    """Time [ns] and bytes of the only message of each topic, as they follow in the file."""
    with path.open("rb") as file:
        read = NonSeekingReader(file).iter_messages(log_time_order=False)
        return {channel.topic: (message.log_time, message.data) for _, channel, message in read}


def test_definitions_in_the_file_are_those_that_ros_publishes(path: Path) -> None:
    with AnyReader([path]) as bag:
        assert {one.msgtype for one in bag.connections} == set(PUBLISHED)
        for one in bag.connections:
            types = get_typestore(Stores.EMPTY)
            types.register(get_types_from_msg(one.msgdef.data, one.msgtype))
            assert types.hash_rihs01(one.msgtype) == f"RIHS01_{PUBLISHED[one.msgtype]}"
            for store in (Stores.ROS2_HUMBLE, Stores.LATEST):
                text, _ = get_typestore(store).generate_msgdef(one.msgtype, ros_version=2)
                assert text == one.msgdef.data
            # The profile asks for it. Empty, it is read as none given.
            assert one.ext.offered_qos_profiles == []


def test_bytes_are_those_of_the_encoding(path: Path) -> None:
    """By hand: little endian, strings end with a null, numbers are aligned to their size."""
    little, found = b"\x00\x01\x00\x00", raw(path)
    assert found["/margin"] == (300_000_000, little + struct.pack("<d", 0.1 + 0.2))
    frame = b"first/fingertip\x00"
    text = struct.pack(f"<iII{len(frame)}s", 1, 500_000_000, len(frame), frame)
    text += bytes(-len(text) % 8) + struct.pack("<6d", *FORCE, *TORQUE)
    assert found["/first/wrench"] == (1_500_000_000, little + text)
    text = struct.pack("<iII7sx", 2, 0, 7, b"camera\x00") + struct.pack("<I4sI", 4, b"png\x00", 6)
    assert found["/camera"] == (2_000_000_000, little + text + b"\x89PNG\x00\xff")


def test_a_condition_is_read_as_it_was(path: Path) -> None:
    with AnyReader([path]) as bag:
        (one,) = bag.topics["/diagnostics"].connections
        ((_, time, data),) = bag.messages([one])
        read = bag.deserialize(data, one.msgtype)
    assert time == round(TIME * 1e9)
    assert (read.header.stamp.sec, read.header.stamp.nanosec) == divmod(time, 10**9)
    (status,) = read.status
    assert (status.level, status.name, status.message) == (1, "estimate", "keine Kraft: µ")
    assert [(each.key, each.value) for each in status.values] == [("late_ms", "2.5")]


def test_an_interrupted_file_keeps_its_messages_and_a_killed_one_does_not(tmp_path: Path) -> None:
    def interrupted() -> None:
        with McapFile(tmp_path / "live.mcap") as file:
            write(file)
            (left,) = tmp_path.iterdir()  # what a kill would leave looks like no whole file
            assert left.name.startswith(".part-")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    topics = {"/margin", "/first/wrench", "/camera", "/diagnostics"}
    assert set(raw(tmp_path / "live.mcap")) == topics


def test_a_full_disk_is_one_sentence(small_files: Callable[[int], None], tmp_path: Path) -> None:
    noise = np.random.default_rng(1).bytes(100_000)

    def filled() -> None:
        with McapFile(tmp_path / "live.mcap") as file:
            for k in range(100):
                file.picture(k / 60, "/camera", noise[k:], "png")

    small_files(1_000_000)
    with pytest.raises(UserError, match=r"live\.mcap cannot be written: File too large"):
        filled()
    assert not list(tmp_path.iterdir())
    with pytest.raises(UserError, match="cannot be written: No such file"):
        McapFile(tmp_path / "none" / "live.mcap")
