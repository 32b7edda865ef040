"""Speed of the environments for Gymnasium, and of the loop on frames from outside."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import closing

import numpy as np

from ..extras import missing
from ..loop.camera import open_camera
from ..loop.grasp import grasp
from ..loop.methods import choose
from ..loop.observers import known_sensor
from ..output.pictures import Source
from ..output.report import Row, at_least, at_most, reported
from ..render import Frame
from ..rig.feed import Feed
from ..rig.gripper import HeldGripper, SimulatedGripper
from ..rig.outside import grasp_outside
from ..scene.scene import Scene, load_scene

#: Scene of all figures.
SCENE = "camera-100hz"
#: Observations with the number of grasps that are timed, and the speed that is asked for [1/s].
OBSERVATIONS = {
    "margin": (20, 1000.0),
    "forces": (20, 1000.0),
    "image": (2, -math.inf),
    "markers": (2, -math.inf),
}
#: Time between frames of a camera of 60 Hz [ms].
PERIOD_60_HZ = 1e3 / 60.0


def environment_rows(
    progress: Callable[[str], None], duration_s: float = 2.0, turns: int = 3
) -> Iterator[Row]:
    """Speed of `Grasp-v0` on the chain with its resets, and time of a frame from outside.

    Parameters
    ----------
    progress: called with the name of each part
    duration_s: of each grasp
    turns: the fastest one counts
    """
    problem = missing("rl")
    for observation, (grasps, least) in OBSERVATIONS.items():
        case = ("speed", "environment", observation)
        if problem is not None:
            yield reported(case, None, "steps/s", problem)
            continue
        progress(f"environment, {observation}")
        speed = steps_per_second(observation, grasps, duration_s, turns)
        yield at_least(case, speed, "steps/s", least)
    progress("frames from outside")
    spent = outside_times(load_scene(SCENE, {"duration_s": duration_s}))
    yield at_most(("speed", "outside", "median"), float(np.median(spent)), "ms", PERIOD_60_HZ)
    yield reported(("speed", "outside", "p95"), float(np.percentile(spent, 95.0)), "ms")


def steps_per_second(observation: str, grasps: int, duration_s: float, turns: int) -> float:
    """Speed of an environment, of the fastest of some turns."""
    import gymnasium

    changes = {"duration_s": duration_s}
    env = gymnasium.make("chromagrip/Grasp-v0", observation=observation, changes=changes)
    action = np.array([-0.2], np.float32)  # 2 N
    best = 0.0
    env.reset(seed=0)
    for _ in range(turns):
        begin, steps = time.perf_counter(), 0
        for seed in range(grasps):
            env.reset(seed=seed)
            over = False
            while not over:
                _, _, terminated, truncated, _ = env.step(action)
                steps, over = steps + 1, terminated or truncated
        best = max(best, steps / (time.perf_counter() - begin))
    env.close()
    return best


def outside_times(scene: Scene) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Time from each frame from outside to the force that answers it [ms], after the first one."""
    scene, methods = choose(scene)
    with closing(open_camera(scene, methods)) as camera:
        taken = list(grasp(scene, camera, methods=methods))
        frames = camera.expose_rest(taken[0].truth.state, scene.camera.rest_frames)
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
