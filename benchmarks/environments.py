"""Speed of the environments for Gymnasium, and of the loop on frames from outside."""

import math
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from chromagrip.extras import missing
from chromagrip.loop.grasp import grasp
from chromagrip.loop.methods import choose
from chromagrip.output.report import Row, at_least, at_most, reported
from chromagrip.outside.grasp import grasp_outside
from chromagrip.outside.gripper import HeldGripper, SimulatedGripper
from chromagrip.render import Frame
from chromagrip.scene.scene import Scene, load_scene
from chromagrip.sensing.reader import known_sensor
from chromagrip.sensing.sensor import open_camera
from chromagrip.sources import Source
from chromagrip.sources.feed import Feed

#: Scene of all figures of one finger.
SCENE = "camera-100hz"


@dataclass(frozen=True, kw_only=True)
class Timed:
    """An environment that is timed.

    Attributes
    ----------
    case: name of the row after `speed`
    name: of the environment
    observation: that it shows
    grasps: how many are timed
    least: speed that is asked for [1/s]
    """

    case: tuple[str, ...]
    name: str
    observation: str
    grasps: int
    least: float = -math.inf


GRASP, PINCH = "chromagrip.gym:chromagrip/Grasp-v0", "chromagrip.gym:chromagrip/Pinch-v0"
TIMED = (
    Timed(case=("environment", "margin"), name=GRASP, observation="margin", grasps=20, least=1000),
    Timed(case=("environment", "forces"), name=GRASP, observation="forces", grasps=20, least=1000),
    Timed(case=("environment", "image"), name=GRASP, observation="image", grasps=2),
    Timed(case=("environment", "markers"), name=GRASP, observation="markers", grasps=2),
    Timed(case=("pinch", "forces"), name=PINCH, observation="forces", grasps=1, least=75),
    Timed(case=("pinch", "image"), name=PINCH, observation="image", grasps=1, least=30),
)
#: Time between frames of a camera of 60 Hz [ms].
PERIOD_60_HZ = 1e3 / 60.0


def environment_rows(duration_s: float = 2.0, turns: int = 3) -> Iterator[Row]:
    """Speed of the environments with their resets, and time of a frame from outside.

    `Grasp-v0` is of the chain, `Pinch-v0` of two domes with four steps a frame.

    Parameters
    ----------
    duration_s: of each grasp
    turns: the fastest one counts
    """
    problem = missing("rl")
    for timed in TIMED:
        case = ("speed", *timed.case)
        if problem is not None:
            yield reported(case, None, "steps/s", problem)
            continue
        speed, busy = step_times(timed, duration_s, turns)
        yield at_least(case, speed, "steps/s", timed.least)
        yield reported((*case, "cpu"), busy, "ms")
    spent = outside_times(load_scene(SCENE, {"duration_s": duration_s}))
    yield at_most(("speed", "outside", "median"), float(np.median(spent)), "ms", PERIOD_60_HZ)
    yield reported(("speed", "outside", "p95"), float(np.percentile(spent, 95.0)), "ms")


def step_times(timed: Timed, duration_s: float, turns: int) -> tuple[float, float]:
    """Steps in a second and process time of a step [ms], of the fastest of some turns."""
    import gymnasium

    changes = {"duration_s": duration_s}
    env = gymnasium.make(timed.name, observation=timed.observation, changes=changes, most_n=5.0)
    # One finger grips with 2 N. Two hold 200 g with 4 N.
    action = np.array([-0.2 if timed.name == GRASP else 0.6], np.float32)
    best, least = 0.0, math.inf
    env.reset(seed=0)
    for _ in range(turns):
        begin, spent, steps = time.perf_counter(), time.process_time(), 0
        for seed in range(timed.grasps):
            env.reset(seed=seed)
            over = False
            while not over:
                _, _, terminated, truncated, _ = env.step(action)
                steps, over = steps + 1, terminated or truncated
        best = max(best, steps / (time.perf_counter() - begin))
        least = min(least, 1e3 * (time.process_time() - spent) / steps)
    env.close()
    return best, least


def outside_times(scene: Scene) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Time from each frame from outside to the force that answers it [ms], after the first one."""
    scene, methods = choose(scene)
    with closing(open_camera(scene, methods.renderer)) as camera:
        taken = list(grasp(scene, camera, methods=methods))
        frames = camera.expose_rest(taken[0].contact.state, scene.camera.rest_frames)
    frames += [one.frame for one in taken if one.frame is not None]

    def all_frames() -> Iterator[Frame]:
        yield from frames

    source = Source(name="frames", frames=all_frames, count=len(frames), fps=scene.camera.rate_hz)
    gripper = HeldGripper(SimulatedGripper(), "simulated", 60.0)
    times = []
    with closing(Feed(source, 60.0)) as feed:
        for _ in grasp_outside(scene, methods, known_sensor(scene), feed, gripper, 60.0):
            times.append(time.perf_counter())
    return 1e3 * np.diff(times)
