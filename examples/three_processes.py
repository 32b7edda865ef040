"""Camera, reader and controller as three processes: messages over loopback hold Γ = 0.3.

The camera process plays an object of chromatouch-2022 in time, `chromagrip estimate` reads
its pictures and publishes, and the controller process subscribes and commands the grip. Half-way
the reader is killed and started again. The new one does not know the way of the contact: after a
slip it gives no estimate and says so, and the controller grips harder.

    python examples/three_processes.py [SECONDS [SPEED]]

With a speed of 0.5 the object is played at half of its speed, for a slow machine.
"""

import itertools
import math
import os
import socket
import struct
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import replace as replaced
from pathlib import Path

import numpy as np
from msgspec.structs import replace

import chromagrip
from chromagrip.output.png import encode_png
from chromagrip.publish import Subscriber, observation_of
from chromagrip.sources import pipe_bytes

SCENE = chromagrip.load_scene("chromatouch-2022")
LOOPBACK = "127.0.0.1"


def camera(folder: Path, seconds: float, port: int, speed: float) -> None:
    """Play the object under the newest grip that has come; write its pictures into a pipe."""
    grips = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    grips.bind((LOOPBACK, port))
    grips.setblocking(False)
    pipe, grip, log, begin = -1, math.nan, [], time.monotonic()
    with chromagrip.open(replace(SCENE, path="truth", duration_s=seconds)) as rig:
        rig.reset()
        (folder / "rest").mkdir()
        for k, frame in enumerate(rig.sensors[0].rest_frames(8)):
            (folder / "rest" / f"{k}.png").write_bytes(encode_png(frame.image))
        for due in itertools.count(time.monotonic(), rig.scene.period / speed):
            with suppress(BlockingIOError):
                while True:
                    (grip,) = struct.unpack("d", grips.recv(8))
            if not math.isnan(grip):  # until then nothing is gripped, and no time passes
                (folder / "begun").touch()
                rig.step(grip)
                field, friction = rig.truth.field, rig.truth.friction
                log.append((rig.time, field.safety_margin(friction), grip))
            if rig.done:
                break
            time.sleep(max(0.0, due - time.monotonic()))
            shown = replaced(rig.picture(), time=speed * (time.monotonic() - begin))
            try:
                if pipe < 0:  # fails as long as nobody reads
                    pipe = os.open(folder / "frames", os.O_WRONLY | os.O_NONBLOCK)
                    os.set_blocking(pipe, True)
                data = memoryview(pipe_bytes(shown))
                while data:
                    data = data[os.write(pipe, data) :]
            except OSError:  # the reader is gone
                with suppress(OSError):
                    os.close(pipe)
                pipe = -1
    np.save(folder / "log.npy", np.array(log))


def control(readings: int, grips: int) -> None:
    """Command a grip for every message; without one, the last grip stays."""
    line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    controller = SCENE.build_controller()
    with Subscriber(f"udp:{readings}") as messages:
        while True:
            message = messages.next(0.5)
            if message is not None:
                force = controller.command(observation_of(message)).force
                line.sendto(struct.pack("d", force), (LOOPBACK, grips))


def wait_for(path: Path) -> None:
    """Wait until a file is there."""
    while not path.exists():
        time.sleep(0.1)


def free_port() -> int:
    """Find a port that nobody uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        made.bind((LOOPBACK, 0))
        return int(made.getsockname()[1])


def main(seconds: float, speed: float = 1.0) -> None:
    """Run the three processes, and print how well the margin was held."""
    readings, grips = free_port(), free_port()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.mkfifo(folder / "frames")
        role = [sys.executable, __file__]
        read = [
            sys.executable, "-m", "chromagrip", "estimate", str(folder / "rest"),
            f"pipe:{folder / 'frames'}(live=true)", "--calibration", SCENE.sensor,
            "--reconstructor", "contact", "--publish", f"udp:{readings}",
        ]  # fmt: skip
        player = subprocess.Popen([*role, "camera", name, str(seconds), str(grips), str(speed)])
        wait_for(folder / "rest" / "7.png")
        controller = subprocess.Popen([*role, "control", str(readings), str(grips)])
        reader = subprocess.Popen(read)
        wait_for(folder / "begun")
        time.sleep(0.5 * seconds / speed)
        reader.kill()
        reader.wait()
        print(f"reader killed and started again after {0.5 * seconds:g} s", flush=True)
        reader = subprocess.Popen(read)
        player.wait()
        for process in (controller, reader):
            process.terminate()
            process.wait()
        times, margins, grip = np.load(folder / "log.npy").T
    for words, part in (
        ("before", (times > 3.0) & (times < 0.5 * seconds)),
        ("after", times >= 0.5 * seconds),
    ):
        held = abs(margins[part] - 0.3) <= 0.05
        print(
            f"{words} the kill: Γ within 0.3 ± 0.05 in {held.mean():.0%} of the frames, smallest "
            f"{margins[part].min():.2f}, grip {grip[part][-1]:.2f} N"
        )


if __name__ == "__main__":
    if sys.argv[1:2] == ["camera"]:
        camera(Path(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4]), float(sys.argv[5]))
    elif sys.argv[1:2] == ["control"]:
        control(int(sys.argv[2]), int(sys.argv[3]))
    else:
        main(*map(float, sys.argv[1:] or ["60"]))
