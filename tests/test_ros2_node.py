"""The example node of ROS 2, fed by a bag through a stub of rclpy, publishes what it reads."""

import runpy
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from chromagrip import Pose, Reader, TactileSensor
from chromagrip.model import Solid
from chromagrip.model.shapes import ball

NODE = Path(__file__).parents[1] / "examples/ros2_node.py"
TYPES = get_typestore(Stores.ROS2_JAZZY)
MESSAGES = ("sensor_msgs/msg/Image", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
#: Seconds of the first picture, and of one period.
START, DT = 1_700_000_000, 1.0 / 30.0
REST = 4
#: Nanoseconds from each picture until the node reads it.
LATE = 12_300_000


@dataclass
class Rclpy:
    """Stub of rclpy: `spin` plays a bag to the subscriptions, and what is published is kept."""

    bag: Path
    parameters: dict[str, object]
    now: int = 0
    subscriptions: dict[str, Callable[[Any], None]] = field(default_factory=dict)
    published: list[tuple[str, int, Any]] = field(default_factory=list)

    def spin(self, node: Any) -> None:
        with AnyReader([self.bag]) as bag:
            for connection, time, data in bag.messages():
                self.now = time + LATE
                self.subscriptions[connection.topic.strip("/")](
                    bag.deserialize(data, connection.msgtype)
                )

    def modules(self) -> dict[str, ModuleType]:
        """Modules that the node imports."""
        stub = self

        class Node:
            def __init__(self, name: str) -> None:
                self.name = name

            def get_name(self) -> str:
                return self.name

            def declare_parameter(self, name: str, value: object) -> Any:
                return SimpleNamespace(value=stub.parameters.get(name, value))

            def create_publisher(self, kind: Any, topic: str, depth: int) -> Any:
                def publish(message: Any) -> None:
                    assert type(message) is kind
                    name = kind.__msgtype__  # a type that is wrong in a field fails here
                    read = TYPES.deserialize_cdr(TYPES.serialize_cdr(message, name), name)
                    stub.published.append((topic, stub.now - LATE, read))

                return SimpleNamespace(publish=publish)

            def create_subscription(self, kind: Any, topic: str, callback: Any, qos: Any) -> None:
                stub.subscriptions[topic] = callback

            def get_clock(self) -> Any:
                return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=stub.now))

        contents: dict[str, dict[str, object]] = {
            "rclpy": {"init": lambda: None, "spin": self.spin},
            "rclpy.node": {"Node": Node},
            "rclpy.qos": {"qos_profile_sensor_data": object()},
            "rclpy.executors": {"ExternalShutdownException": type("Ends", (Exception,), {})},
        }
        for name in ("diagnostic_msgs", "geometry_msgs", "sensor_msgs", "std_msgs"):
            kinds = {k.split("/")[2]: v for k, v in TYPES.types.items() if k.startswith(f"{name}/")}
            contents |= {name: {}, f"{name}.msg": kinds}
        made = {}
        for name, content in contents.items():
            made[name] = ModuleType(name)
            vars(made[name]).update(content)
        return made


def write_bag(folder: Path, images: list[np.ndarray], encoding: str) -> None:
    """Write pictures as a bag of ROS 2; rows of BGR have some bytes behind them."""
    kind, header, time = (TYPES.types[name] for name in MESSAGES)
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        topic = bag.add_connection("/image_raw", MESSAGES[0], typestore=TYPES)
        for k, image in enumerate(images):
            height, width, _ = image.shape
            rows = image[..., ::-1] if encoding == "bgr8" else image
            rows = np.pad(rows.reshape(height, -1), ((0, 0), (0, 5 * (encoding == "bgr8"))))
            sec, nanosec = divmod(START * 10**9 + round(k * DT * 1e9), 10**9)
            message = kind(
                header=header(stamp=time(sec=sec, nanosec=nanosec), frame_id="camera"),
                height=height, width=width, encoding=encoding, is_bigendian=0,
                step=rows.shape[1], data=rows.ravel(),
            )  # fmt: skip
            data = TYPES.serialize_cdr(message, MESSAGES[0])
            bag.write(topic, sec * 10**9 + nanosec, data)


def play(
    monkeypatch: pytest.MonkeyPatch, bag: Path, **parameters: object
) -> list[tuple[str, int, Any]]:
    """Run the example on a bag; topic, time [ns] of the picture and message of each publication."""
    stub = Rclpy(bag, parameters)
    for name, module in stub.modules().items():
        monkeypatch.setitem(sys.modules, name, module)
    runpy.run_path(str(NODE), run_name="__main__")
    assert len(NODE.read_text(encoding="utf-8").splitlines()) < 100
    return stub.published


@pytest.mark.loops
def test_the_node_publishes_what_a_reader_gives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sensor = TactileSensor("dome-2022", noise=1.0, seed=5)
    sensor.attach(Solid(shape=ball(8e-3), friction=0.6))
    images, top = [frame.image for frame in sensor.rest_frames(REST)], sensor.design.shape.radius
    for k in range(6):
        place = (0.06e-3 * max(k - 3, 0), 0.0, top + 8e-3 - 0.16e-3 * min(k, 3))
        images.append(sensor.update(Pose(place=place), dt=DT).image)
    sensor.close()
    write_bag(tmp_path / "bag", images, "bgr8")
    published = play(monkeypatch, tmp_path / "bag", rest_frames=REST, noise=1.0)

    reader = Reader("dome-2022", images[:REST], noise=1.0)
    wanted: dict[tuple[str, int], list[float]] = {}
    for k, image in enumerate(images[REST:], REST):
        time = START * 10**9 + round(k * DT * 1e9)
        reading = reader.update(image, time // 10**9 + 1e-9 * (time % 10**9))
        names = ("margin", "margin_low", "margin_high", "friction")
        values = (reading.margin, *reading.margin_interval, reading.friction)
        numbers = {"wrench": reading.wrench.tolist()} | {
            name: [value] for name, value in zip(names, values, strict=True)
        }
        wanted |= {(name, time): each for name, each in numbers.items() if np.isfinite(each).all()}
    counts = Counter(topic for topic, _ in wanted)
    assert counts["wrench"] == 6
    assert 0 < counts["margin"] < 6  # nothing touches at first

    found = {(topic, time): message for topic, time, message in published}
    told = [message for topic, _, message in published if topic == "/diagnostics"]
    for (topic, time), values in wanted.items():
        message = found[topic, time]
        if topic == "wrench":
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time
            force, torque = message.wrench.force, message.wrench.torque
            assert [force.x, force.y, force.z, torque.z] == values
        else:
            assert message.data == values[0]
    assert len(published) == len(wanted) + len(told)
    statuses = [message.status[0] for message in told]
    assert [status.level for status in statuses] == [1] * REST + [0] * 6
    assert {status.hardware_id for status in statuses} == {"dome-2022"}
    assert all(status.values[-1].value == "12.3" for status in statuses)


def test_what_the_node_cannot_read_is_a_diagnosis(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    grey = [np.full((48, 64, 3), 128, np.uint8)] * 2
    for encoding, first, sentence in (
        ("mono8", 2, "image_raw is mono8; allowed are rgb8 and bgr8"), ("rgb8", 1, "")
    ):  # fmt: skip
        write_bag(tmp_path / encoding, grey, encoding)
        told = play(monkeypatch, tmp_path / encoding, rest_frames=2)
        statuses = [message.status[0] for topic, _, message in told if topic == "/diagnostics"]
        assert (statuses[0].level, statuses[-1].level) == (first, 2)
        assert sentence in statuses[-1].message != ""
    with pytest.raises(SystemExit, match=r"chromagrip: .*none-such"):
        play(monkeypatch, tmp_path / "mono8", calibration="none-such")
