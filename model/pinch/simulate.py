"""Simulation of a pinch over time: motion of the object, and all forces on it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..checks import finite
from ..dome.state import StepCount
from .body import Moving
from .pinch import Pinch
from .state import PinchState, pinch_rest
from .stepper import PinchStepper

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class PinchRun:
    """Record of a pinch, at the end of each of K steps.

    Attributes
    ----------
    times: time at the end of each step [s], shape (K,)
    places, rotations: poses of the object in the hand, shapes (K, 3) [m] and (K, 3, 3)
    forces: forces of the object on both fingertips, in the hand's axes [N], shape (K, 2, 3)
    supports: force of the table [N], shape (K,)
    moving: state of motion of the object in the world
    counts: counts of each step
    end: last state
    """

    times: Array
    places: Array
    rotations: Array
    forces: Array
    supports: Array
    moving: tuple[Moving, ...]
    counts: tuple[StepCount, ...]
    end: PinchState

    @property
    def turns(self) -> Array:
        """Turn of the object about the axis of the pinch [rad], shape (K,)."""
        return np.unwrap(np.arctan2(self.rotations[:, 1, 0], self.rotations[:, 0, 0]))


def simulate_pinch(
    pinch: Pinch,
    duration: float,
    grip: Callable[[float], float],
    dt: float = 5e-3,
    start: PinchState | None = None,
) -> PinchRun:
    """Simulate two fingertips that close on an object, and a hand that moves.

    Parameters
    ----------
    pinch: fingertips, object and hand
    duration: time at the end [s]
    grip: function that returns the force of the drive [N] at a time [s]
    dt: longest step [s]
    start: state to start from; None: rest

    Raises
    ------
    UserError: for a step without solution, and too deep a press
    """
    finite("time step", dt, "s", above=0.0)
    stepper = PinchStepper(pinch, start or pinch_rest(pinch))
    finite("duration of a pinch", duration, "s", above=stepper.time)
    count = max(1, int(np.ceil(duration / dt - 1e-9)))
    times = duration * np.arange(1, count + 1) / count
    times = times[times > stepper.time + 1e-12]
    counts, rows, moving = [], [], []
    for time in times:
        counts.append(stepper.advance(float(time), grip(float(time))))
        place, rotation = stepper.pose()
        moving.append(stepper.moving)
        rows.append((place, rotation, both_forces(stepper), stepper.support))
    parts = [np.array(part) for part in zip(*rows, strict=True)]
    return PinchRun(
        times=times, places=parts[0], rotations=parts[1], forces=parts[2], supports=parts[3],
        moving=tuple(moving), counts=tuple(counts), end=stepper.state(),
    )  # fmt: skip


def both_forces(stepper: PinchStepper) -> Array:
    """Force of the object on both fingertips, in the hand's axes [N], shape (2, 3)."""
    first, second = stepper.skins
    return np.stack(
        [
            first.forces[first.near].sum(axis=0),
            second.forces[second.near].sum(axis=0) * np.array([1.0, -1.0, -1.0]),
        ]
    )
