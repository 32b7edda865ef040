"""Figures of a pinch's steps: what they take of a swing, momentum, and their speed."""

import math
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from chromagrip.loop.pinch.world import PinchPlant
from chromagrip.model import Dome, Solid
from chromagrip.model.pinch import Pinch, PinchRun, box_body, pinch_rest, simulate_pinch
from chromagrip.model.shapes import box
from chromagrip.output.report import Row, at_most, reported, within
from chromagrip.scene.fingers import build_pinch
from chromagrip.scene.scene import load_scene

Array = NDArray[np.float64]

#: Steps whose loss is measured [s].
STEPS = (2.5e-3, 5e-3, 10e-3)
#: Frequency of the free swing [Hz], and how many of its periods are measured.
FREQUENCY, PERIODS = 3.5, 10
#: Scenes that are timed, with a grip that holds each [N].
SCENES = {"pinch-lift": 4.0, "pinch-offcentre": 12.0}
#: What is simulated of a scene in a quick run [s]: until the hand has begun to lift.
_QUICK_S = 1.0


def pinch_rows(quick: bool) -> Iterator[Row]:
    """Rows of a pinch's steps."""
    for step in STEPS:
        found, told = swing_loss(step), predicted_loss(step)
        name = ("pinch", "swing", f"{1e3 * step:g}ms")
        yield reported((*name, "loss"), 100 * found, "%")
        yield reported((*name, "predicted"), 100 * told, "%")
        yield within((*name, "loss_over_predicted"), found / told, "", 0.98, 1.02)
        yield reported((*name, "backward_euler"), 100 * euler_loss(step), "%")
    for scene, grip in SCENES.items():
        momentum, place = momentum_lacks(scene, grip, quick)
        yield at_most(("pinch", scene, "momentum"), momentum, "", 1e-9)
        yield at_most(("pinch", scene, "place"), place, "", 1e-2)
        yield reported(("pinch", scene, "steps"), steps_per_second(scene, grip, quick), "1/s")


def predicted_loss(step: float) -> float:
    """Share of the amplitude that steps [s] of the formula take in a period.

    A swing exp(iωt) is multiplied by z in each step, with (3/2 − i·ω·h)·z² − 2·z + 1/2 = 0. For
    short steps that is a share (ω·h)⁴/4.
    """
    angle = 2.0 * math.pi * FREQUENCY * step
    roots = abs(np.roots([1.5 - 1j * angle, -2.0, 0.5]))
    return 1.0 - float(roots.max()) ** (2.0 * math.pi / angle)


def euler_loss(step: float) -> float:
    """The same of backward Euler, which divides by √(1 + (ω·h)²) in each step."""
    angle = 2.0 * math.pi * FREQUENCY * step
    return 1.0 - (1.0 + angle**2) ** (-math.pi / angle)


def swing_loss(step: float) -> float:
    """Share of the amplitude that a free swing loses in a period with steps of that length [s].

    No finger touches the body. It bobs on the spring of its table, in a gravity that gives it the
    frequency: nothing but the step takes energy.
    """
    omega = 2.0 * math.pi * FREQUENCY
    size = (20e-3, 20e-3, 16e-3)
    free = Pinch(
        first=Dome(pitch=0.8e-3),
        second=Dome(pitch=0.8e-3),
        solid=Solid(shape=box(size)),
        body=box_body(1.0, size),
    )
    gives = free.body.mass * abs(free.gravity[0]) / free.table_stiffness
    free = replace(free, gravity=(omega**2 * gives, 0.0, 0.0))
    start = pinch_rest(free)
    level = start.moving.place[0]
    pushed = np.array([0.5 * free.body.mass * omega * gives, 0.0, 0.0])
    start = replace(start, moving=replace(start.moving, momentum=pushed))
    run = simulate_pinch(free, (PERIODS + 2) / FREQUENCY, lambda _: -3.0, step, start)
    assert not run.forces.any()
    place = np.array([each.place[0] for each in run.moving]) - level
    speed = np.array([each.momentum[0] for each in run.moving]) / free.body.mass
    size_of = np.hypot(place, speed / omega)
    # The first steps start the formula.
    first = int(np.searchsorted(run.times, 1.0 / FREQUENCY))
    periods = FREQUENCY * (run.times[-1] - run.times[first])
    return 1.0 - float(size_of[-1] / size_of[first]) ** (1.0 / periods)


def momentum_lacks(scene: str, grip: float, quick: bool) -> tuple[float, float]:
    """Change of momentum in a step that the stored forces lack, and what its place lacks of it.

    Both are the largest, over what the weight gives in a step. Steps that were halved, and the two
    after, are left out: what they started from is not kept.
    """
    run, pinch, step = _lift(scene, grip, quick)
    momentum = np.array([each.momentum for each in run.moving])
    force = pinch.body.mass * np.array(pinch.gravity) - run.forces.sum(axis=1)
    force -= run.supports[:, None] * pinch.down
    place = np.array([each.place for each in run.moving])
    lacks = _change(momentum) - step * force[2:]
    behind = pinch.body.mass / step * _change(place) - momentum[2:]
    halved = np.array([count.halvings > 0 for count in run.counts])
    whole = ~(halved[2:] | halved[1:-1] | halved[:-2])
    given = pinch.body.mass * float(np.linalg.norm(pinch.gravity)) * step
    largest = [float(np.linalg.norm(one[whole], axis=1).max()) / given for one in (lacks, behind)]
    return largest[0], largest[1]


def _change(values: Array) -> Array:
    """Rate of what steps of one length gave by the formula of second order, times the step."""
    return np.asarray(1.5 * values[2:] - 2.0 * values[1:-1] + 0.5 * values[:-2])


def _lift(name: str, grip: float, quick: bool) -> tuple[PinchRun, Pinch, float]:
    """A scene under a constant grip [N], its pinch, and the length of its steps [s]."""
    scene = load_scene(name)
    assert not scene.pinch.hand_turns_deg  # so that the hand's axes are the world's
    pinch, step = build_pinch(scene), 1e-3 * scene.fingertip.step_ms
    until = _QUICK_S if quick else scene.duration_s
    return simulate_pinch(pinch, until, lambda _: grip, step), pinch, step


def steps_per_second(name: str, grip: float, quick: bool) -> float:
    """Steps of a scene in a second of process time under a constant grip [N], as a run takes them.

    With the forces, slips and outcome that a run keeps of each.
    """
    plant = PinchPlant(load_scene(name))
    world, begin = plant.rest(), 0.0
    frames = round((_QUICK_S if quick else plant.scene.duration_s) / plant.clock.frame)
    for index in range(frames):
        if index == 1:  # the first one compiles
            begin = time.process_time()
        world = plant.next_frame(world, grip, index)
    return (frames - 1) * plant.clock.steps / (time.process_time() - begin)
