"""Speed and memory of many tactile sensors in step: poses in; picture, markers and wrench out."""

import resource
import time
from collections.abc import Iterator

import numpy as np

from chromagrip import TactileSensors
from chromagrip.model import shapes
from chromagrip.output.processes import one_thread
from chromagrip.output.report import Row, at_least, at_most, reported

#: Frames/s of processor time that are asked for, of one sensor of a design.
LEAST = {"dome-2020": 600.0, "chromatouch-next": 300.0}
#: Radius of the ball [m]; it is pressed by 0.7 mm and rolled over the apex.
BALL, RATE_HZ, FRAMES = 8e-3, 60.0, 60


def sensor_rows() -> Iterator[Row]:
    """Speed of one sensor, of two threads and of 16 sensors, and memory of a further one."""
    with one_thread():
        for design, least in LEAST.items():
            busy, _ = frame_times(opened(design, 1))
            yield at_least(("sensors", design, "frames"), 1.0 / busy, "frames/s of CPU", least)
        _, alone = frame_times(opened("dome-2020", 2))
        _, both = frame_times(opened("dome-2020", 2, threads=2))
        yield at_least(("sensors", "dome-2020", "two_threads"), alone / both, "×", 1.85)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        many = opened("dome-2020", 16, threads=2)
        _, spent = frame_times(many)
        after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        yield at_least(("sensors", "dome-2020", "16", "frames"), 1.0 / spent, "frames/s", 1100.0)
        yield at_most(("sensors", "dome-2020", "16", "each"), (after - before) / 16e3, "MB", 5.0)
        nodes = (np.linalg.norm(many.data.node_force, axis=2) > 0.0).sum(axis=1).mean()
        yield reported(("sensors", "dome-2020", "nodes"), float(nodes), "nodes in contact")


def opened(design: str, count: int, threads: int = 1) -> TactileSensors:
    """Sensors with a ball, whose kernels are compiled."""
    sensors = TactileSensors(design, num_envs=count, noise=2.0, threads=threads)
    sensors.attach(shapes.ball(BALL), friction=0.5)
    play(sensors)
    return sensors


def frame_times(sensors: TactileSensors, turns: int = 3) -> tuple[float, float]:
    """Processor time and time of a frame of one sensor [s], of the fastest of some turns."""
    best = np.full(2, np.inf)
    for _ in range(turns):
        begin = time.process_time(), time.perf_counter()
        play(sensors)
        spent = np.subtract((time.process_time(), time.perf_counter()), begin)
        best = np.minimum(best, spent / (FRAMES * sensors.num_envs))
    return float(best[0]), float(best[1])


def play(sensors: TactileSensors) -> None:
    """Press and roll once, and read what a simulator reads."""
    sensors.reset()
    radius = sensors.sensors[0].design.dome.radius
    lean = np.radians(np.linspace(-16.0, 16.0, sensors.num_envs + 1)[:-1])
    for frame in range(FRAMES):
        seconds = frame / RATE_HZ
        away = radius + BALL + 0.3e-3 - 1e-3 * min(1.0, 2.5 * seconds)
        angle = lean + np.radians(20.0) * max(0.0, seconds - 0.4)
        places = away * np.column_stack([np.sin(angle), np.zeros(len(lean)), np.cos(angle)])
        data = sensors.update(places, dt=1.0 / RATE_HZ)
        _ = data.image, data.marker_px, data.marker_visible, data.wrench
