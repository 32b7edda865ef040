"""Where the time of a frame of the closed loop goes: its stages, done again by themselves."""

import time
from collections.abc import Iterator
from contextlib import closing, contextmanager

import cv2
from msgspec.structs import replace
from threadpoolctl import threadpool_limits

from ...loop.grasp import grasp, known_sensor, open_camera
from ...loop.observers import ForceObserver
from ...render import add_noise
from ...scene.scene import Scene
from ...tracking import Palette, load_tracker

#: Of the camera path; the rest is the node model, the controller, and what goes around them.
STAGES = ("picture", "noise", "tracking", "forces", "the rest")


def frame_parts(scene: Scene) -> dict[str, float]:
    """Mean time of each stage of a frame [ms], in a run of a scene through the camera.

    A second tracker, estimator and camera do what those of the run did, frame after frame.
    """
    spent = dict.fromkeys(STAGES, 0.0)

    @contextmanager
    def clock(stage: str) -> Iterator[None]:
        begin = time.perf_counter()
        yield
        spent[stage] += time.perf_counter() - begin

    known, noise = known_sensor(scene), scene.camera.noise_levels
    tracker = load_tracker(scene.tracker)(Palette.of_sensor(known.sensor), noise)
    window = scene.safety_margin.friction_window_s
    with threadpool_limits(1):
        cv2.setNumThreads(1)
        with closing(open_camera(scene)) as camera:
            samples = grasp(scene, camera)
            state = next(samples).state
            rest = tracker.reset(camera.expose_rest(state, scene.camera.rest_frames))
            forces = ForceObserver(known, rest, scene.reconstructor, window)
            states = [state]
            while True:
                with clock("the rest"):
                    sample = next(samples, None)
                if sample is None:
                    break
                if sample.frame is None:
                    continue  # it was dropped
                states.append(sample.state)
                with clock("tracking"):
                    tracks = tracker.update(sample.frame)
                with clock("forces"):
                    forces.observe(sample.state.time, tracks)
        # Afterwards: a renderer may not share the machine with a second one.
        quiet = replace(scene, camera=replace(scene.camera, noise_levels=0.0))
        with closing(open_camera(quiet)) as camera:
            camera.expose(states[0], 0)
            for index, state in enumerate(states[1:]):
                with clock("picture"):
                    frame = camera.expose(state, index)
                with clock("noise"):
                    add_noise(frame.image, noise, scene.seed, index)
    # So far the rest is the whole.
    spent["the rest"] -= sum(spent[stage] for stage in STAGES[:-1])
    return {stage: 1e3 * seconds / (scene.frames - 1) for stage, seconds in spent.items()}
