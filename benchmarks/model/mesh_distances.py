"""Whether the dome's contact converges on ten meshes: pressed, sheared, twisted and rolled."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.model.dome import over_cone
from benchmarks.model.meshes import MESHES
from chromagrip.extras import missing
from chromagrip.model import Dome, ModelError, Motion, Solid
from chromagrip.model.dome import contact_steps
from chromagrip.model.shapes import Shape, mesh
from chromagrip.output.report import Row, at_most, reported

Array = NDArray[np.float64]

_DOME = Dome(pitch=0.4e-3, reach=math.radians(79.0))
_STIFFNESSES = (1e9, 1e11)
#: Depth and shift [m], twist and roll [rad], and the arm at which a turn counts as a path [m].
_DEPTH, _SHIFT, _TWIST, _ROLL, _ARM = 0.5e-3, (0.5e-3, 0.2e-3), 0.3, 0.2, 2e-3
#: Path of a step in press, shear, twist and roll [m].
_STEPS = ((20e-6, 5e-6, 20e-6, 50e-6), (50e-6, 50e-6, 5e-6, 20e-6))
_DT = 1e-3
#: Meshes that lie down, so that a thread or teeth touch.
_LYING = ("gear", "screw")
_QUICK = ("pencil", "corner", "gear", "screw")
_STATES = 10


class _Count(NamedTuple):
    """What a run took.

    Attributes
    ----------
    steps, rounds, unconverged, halvings: sums of those of `StepCount`
    out: largest friction of a node over its cone, less one
    """

    steps: int
    rounds: int
    unconverged: int
    halvings: int
    out: float


def bench_meshes(quick: bool) -> Iterator[Row]:
    """Rows of the meshes on the dome; they need the extra `mesh`."""
    absent = missing("mesh", purpose="the contact of meshes")
    if absent is not None:
        yield Row(("dome", "meshes"), "unconverged", None, "%", note=absent)
        return
    counts = []
    for name in _QUICK if quick else MESHES:
        lying = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
        turn = lying if name in _LYING else None
        shape = mesh(MESHES[name](), scale=1e-3, rotation=turn, centred=True)
        for stiffness in _STIFFNESSES:
            for paths in _STEPS[:1] if quick else _STEPS:
                solid = Solid(shape=shape, stiffness=stiffness)
                counts.append(_run(solid, _motion(shape, paths)))
    steps = sum(count.steps for count in counts)
    unconverged = 100 * sum(count.unconverged for count in counts) / steps
    halvings = 100 * sum(count.halvings for count in counts) / steps
    yield reported(("dome", "meshes", "steps"), steps, "")
    yield at_most(("dome", "meshes", "unconverged"), unconverged, "%", 0.5)
    yield at_most(("dome", "meshes", "rounds"), sum(c.rounds for c in counts) / steps, "", 6)
    yield reported(("dome", "meshes", "halvings"), halvings, "%")
    yield at_most(("dome", "meshes", "out_of_cone"), max(c.out for c in counts), "", 1e-9)


def _run(solid: Solid, motion: Motion) -> _Count:
    """Counts of a run; where it breaks off, no step that is left has converged."""
    steps = round(motion.duration / _DT)
    done, rounds, unconverged, halvings, out = 0, 0, 0, 0, 0.0
    try:
        for stepper, count in contact_steps(_DOME, solid, motion, _DT):
            done += 1
            rounds += count.rounds
            unconverged += count.unconverged
            halvings += count.halvings
            if done % _STATES == 0:
                out = max(out, over_cone(solid, stepper.state()))
    except ModelError:
        unconverged += max(1, steps - done)
    return _Count(max(done, steps), rounds, unconverged, halvings, out)


def _motion(shape: Shape, paths: tuple[float, float, float, float]) -> Motion:
    """Press, shear, twist and roll about y on what touches the apex, then lift."""
    arm = np.array([0.0, 0.0, shape.reach_down()])
    pressed = np.array([0.0, 0.0, -_DEPTH])
    shifted = np.array([*_SHIFT, -_DEPTH])
    knots = [(np.zeros(3), np.zeros(3)), (pressed, np.zeros(3)), (shifted, np.zeros(3))]
    steps = [_DEPTH / paths[0], math.hypot(*_SHIFT) / paths[1]]
    for k in range(1, 5):
        knots.append((shifted, np.array([0.0, 0.0, _TWIST * k / 4])))
        steps.append(_TWIST / 4 * _ARM / paths[2])
    twisted = Rotation.from_rotvec(knots[-1][1])
    for k in range(1, 5):
        roll = Rotation.from_rotvec([0.0, _ROLL * k / 4, 0.0])
        knots.append((shifted + roll.apply(arm) - arm, (roll * twisted).as_rotvec()))
        steps.append(_ROLL / 4 * _ARM / paths[3])
    place, turn = knots[-1]
    knots.append((place - 1.5 * pressed, turn))
    steps.append(1.5 * _DEPTH / paths[0])
    times = np.concatenate([[0.0], np.cumsum(np.ceil(np.round(steps, 6)) * _DT)])
    return Motion(times=times, poses=np.array([np.concatenate(knot) for knot in knots]))
