"""Camera, reader and controller as three processes: lines of JSON in pipes hold Γ = 0.3.

The camera process plays an object of chromatouch-2022 in time, `chromagrip estimate` reads
its pictures and publishes, and the controller process subscribes and commands the grip. Of every
pipe the newest line is taken. Half-way the reader is killed and started again. The new one does not
know the way of the contact: after a slip it gives no estimate and says so, and the controller grips
harder.

    python examples/three_processes.py [SECONDS [SPEED]]

With a speed of 0.5 the object is played at half of its speed, for a slow machine.
"""

import itertools
import json
import math
import os
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


def camera(folder: Path, seconds: float, speed: float) -> None:
    """Play the object under the newest grip that has come; write its pictures into a pipe."""
    os.set_blocking(sys.stdin.fileno(), False)
    pipe, grip, log, begin = -1, math.nan, [], time.monotonic()
    with chromagrip.open(replace(SCENE, path="truth", duration_s=seconds)) as rig:
        rig.reset()
        (folder / "rest").mkdir()
        for k, frame in enumerate(rig.sensors[0].rest_frames(8)):
            (folder / "rest" / f"{k}.png").write_bytes(encode_png(frame.image))
        for due in itertools.count(time.monotonic(), rig.scene.period / speed):
            with suppress(BlockingIOError):
                grip = json.loads(os.read(sys.stdin.fileno(), 65536).splitlines()[-1])["grip_n"]
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


def control() -> None:
    """Command a grip for every message; without one, the last grip stays."""
    controller = SCENE.build_controller()
    readings = Subscriber(sys.stdin.buffer)
    while not readings.ended:
        message = readings.next(0.5)
        if message is not None:
            force = controller.command(observation_of(message)).force
            print(json.dumps({"grip_n": force}), flush=True)


def wait_for(path: Path) -> None:
    """Wait until a file is there."""
    while not path.exists():
        time.sleep(0.1)


def main(seconds: float, speed: float = 1.0) -> None:
    """Run the three processes, and print how well the margin was held."""
    # This process keeps both ends of each pipe: a pipe does not end with the reader.
    (readings, published), (grips, commanded) = os.pipe(), os.pipe()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.mkfifo(folder / "frames")
        role = [sys.executable, __file__]
        read = [
            sys.executable, "-m", "chromagrip", "estimate", str(folder / "rest"),
            f"pipe:{folder / 'frames'}(live=true)", "--calibration", SCENE.sensor,
            "--reconstructor", "contact", "--publish", "jsonl:-",
        ]  # fmt: skip
        player = subprocess.Popen([*role, "camera", name, str(seconds), str(speed)], stdin=grips)
        wait_for(folder / "rest" / "7.png")
        controller = subprocess.Popen([*role, "control"], stdin=readings, stdout=commanded)
        reader = subprocess.Popen(read, stdout=published)
        wait_for(folder / "begun")
        time.sleep(0.5 * seconds / speed)
        reader.kill()
        reader.wait()
        print(f"reader killed and started again after {0.5 * seconds:g} s", flush=True)
        reader = subprocess.Popen(read, stdout=published)
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
        camera(Path(sys.argv[2]), float(sys.argv[3]), float(sys.argv[4]))
    elif sys.argv[1:2] == ["control"]:
        control()
    else:
        main(*map(float, sys.argv[1:] or ["60"]))
