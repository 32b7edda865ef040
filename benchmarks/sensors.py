"""Speed and memory of many tactile sensors in step: poses in; picture, markers and wrench out."""

import resource
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from chromagrip import TactileSensor, stacked, update_all
from chromagrip.model import Solid, shapes
from chromagrip.output.processes import one_thread
from chromagrip.output.report import Row, at_least, at_most, reported

#: Frames/s of processor time that are asked for, of one sensor of a design.
LEAST = {"dome-2020": 600.0, "chromatouch-next": 300.0}
#: Radius of the ball [m]; it is pressed by 0.7 mm and rolled over the apex.
BALL, RATE_HZ, FRAMES = 8e-3, 60.0, 60


def sensor_rows() -> Iterator[Row]:
    """Speed of one sensor, of two threads and of 16 sensors, and memory of a further one."""
    with one_thread(), ThreadPoolExecutor(2) as pool:
        for design, least in LEAST.items():
            busy, _ = frame_times(opened(design, 1))
            yield at_least(("sensors", design, "frames"), 1.0 / busy, "frames/s of CPU", least)
        _, alone = frame_times(opened("dome-2020", 2))
        _, both = frame_times(opened("dome-2020", 2), pool.map)
        yield at_least(("sensors", "dome-2020", "two_threads"), alone / both, "×", 1.85)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        many = opened("dome-2020", 16)
        _, spent = frame_times(many, pool.map)
        after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        yield at_least(("sensors", "dome-2020", "16", "frames"), 1.0 / spent, "frames/s", 1100.0)
        yield at_most(("sensors", "dome-2020", "16", "each"), (after - before) / 16e3, "MB", 5.0)
        nodes = (np.linalg.norm(stacked(many, "node_force"), axis=2) > 0.0).sum(axis=1).mean()
        yield reported(("sensors", "dome-2020", "nodes"), float(nodes), "nodes in contact")


def opened(design: str, count: int) -> list[TactileSensor]:
    """Sensors with a ball, whose kernels are compiled."""
    sensors = [TactileSensor(design, noise=2.0, seed=k) for k in range(count)]
    for sensor in sensors:
        sensor.attach(Solid(shape=shapes.ball(BALL), friction=0.5))
    play(sensors)
    return sensors


def frame_times(
    sensors: list[TactileSensor], each: Callable[..., Any] = map, turns: int = 3
) -> tuple[float, float]:
    """Processor time and time of a frame of one sensor [s], of the fastest of some turns."""
    best = np.full(2, np.inf)
    for _ in range(turns):
        begin = time.process_time(), time.perf_counter()
        play(sensors, each)
        spent = np.subtract((time.process_time(), time.perf_counter()), begin)
        best = np.minimum(best, spent / (FRAMES * len(sensors)))
    return float(best[0]), float(best[1])


def play(sensors: list[TactileSensor], each: Callable[..., Any] = map) -> None:
    """Press and roll once, and read what a simulator reads."""
    for sensor in sensors:
        sensor.reset()
    radius = sensors[0].design.dome.radius
    lean = np.radians(np.linspace(-16.0, 16.0, len(sensors) + 1)[:-1])
    for frame in range(FRAMES):
        seconds = frame / RATE_HZ
        away = radius + BALL + 0.3e-3 - 1e-3 * min(1.0, 2.5 * seconds)
        angle = lean + np.radians(20.0) * max(0.0, seconds - 0.4)
        places = away * np.column_stack([np.sin(angle), np.zeros(len(lean)), np.cos(angle)])
        update_all(sensors, places, dt=1.0 / RATE_HZ, each=each)
        for name in ("image", "marker_px", "marker_visible", "wrench"):
            stacked(sensors, name, each)
