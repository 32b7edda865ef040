"""A ROS 2 node: pictures of a fingertip in; wrench, margin, friction and diagnostics out.

    python3 ros2_node.py --ros-args -p calibration:=mine.json -r image_raw:=/camera/image_raw

Nothing may touch the fingertip during the first `rest_frames` pictures. A value that is not known
is not published. It was tried with a stub of rclpy that plays a bag, not under ROS 2 itself.
"""

import math

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Vector3, Wrench, WrenchStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image
from std_msgs.msg import Float64, Header

import chromagrip.tracking

NUMBERS = ("margin", "margin_low", "margin_high", "friction")
METHODS = {"tracker": "fit", "reconstructor": "auto", "noise": 2.0}


class Fingertip(Node):
    """Node of one fingertip."""

    def __init__(self):
        super().__init__("chromagrip")
        named = self.declare_parameter("calibration", "dome-2022").value
        self.calibration = chromagrip.tracking.load_calibration(named)
        self.options = {n: self.declare_parameter(n, value).value for n, value in METHODS.items()}
        self.rest_frames = self.declare_parameter("rest_frames", 16).value
        self.rest, self.reader = [], None
        self.wrench = self.create_publisher(WrenchStamped, "wrench", 10)
        self.numbers = {name: self.create_publisher(Float64, name, 10) for name in NUMBERS}
        self.diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_subscription(Image, "image_raw", self.read, qos_profile_sensor_data)

    def read(self, message):
        """Read a picture, and publish what is known from it."""
        stamp = message.header.stamp
        try:
            image = pixels(message)
            if self.reader is not None:
                self.show(stamp, self.reader.update(image, stamp.sec + 1e-9 * stamp.nanosec))
                return
            self.rest.append(image)
            self.tell(stamp, DiagnosticStatus.WARN, "pictures at rest are taken")
            if len(self.rest) >= self.rest_frames:
                rest, self.rest = self.rest, []
                self.reader = chromagrip.Reader(self.calibration, rest, **self.options)
        except chromagrip.UserError as error:
            self.tell(stamp, DiagnosticStatus.ERROR, str(error))

    def show(self, stamp, reading):
        """Publish a reading."""
        x, y, z, turn = reading.wrench.tolist()
        if math.isfinite(z):
            pair = Wrench(force=Vector3(x=x, y=y, z=z), torque=Vector3(x=0.0, y=0.0, z=turn))
            header = Header(stamp=stamp, frame_id="fingertip")
            self.wrench.publish(WrenchStamped(header=header, wrench=pair))
        values = (reading.margin, *reading.margin_interval, reading.friction)
        for name, value in zip(NUMBERS, map(float, values), strict=True):
            if math.isfinite(value):
                self.numbers[name].publish(Float64(data=value))
        level = DiagnosticStatus.OK if reading.ok else DiagnosticStatus.WARN
        text = reading.no_estimate or "forces are estimated"
        self.tell(stamp, level, text, read_ms=1e3 * reading.seconds)

    def tell(self, stamp, level, message, **values):
        """Publish a diagnosis, with how late it is after the picture."""
        late = self.get_clock().now().nanoseconds - stamp.sec * 10**9 - stamp.nanosec
        values["late_ms"] = 1e-6 * late
        pairs = [KeyValue(key=key, value=f"{value:.1f}") for key, value in values.items()]
        named = {"name": f"{self.get_name()}: estimate", "hardware_id": self.calibration.name}
        status = DiagnosticStatus(level=level, message=message, values=pairs, **named)
        header = Header(stamp=stamp, frame_id="")
        self.diagnostics.publish(DiagnosticArray(header=header, status=[status]))


def pixels(message):
    if message.encoding not in ("rgb8", "bgr8"):
        raise chromagrip.UserError(f"image_raw is {message.encoding}; allowed are rgb8 and bgr8")
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    image = rows[:, : 3 * message.width].reshape(message.height, message.width, 3)
    return np.ascontiguousarray(image[..., ::-1] if message.encoding == "bgr8" else image)


if __name__ == "__main__":
    rclpy.init()
    try:
        rclpy.spin(Fingertip())
    except chromagrip.UserError as error:
        raise SystemExit(f"chromagrip: {error}") from None
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
