"""Motion of an object: a pose over time, forces on free axes, or a free rigid body."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import UserError
from ..checks import finite
from ..kernels.dome.turn_kernels import turned

Array = NDArray[np.float64]

#: Axes of a pose: translations [m] and rotations [rad] in the sensor's axes.
AXES = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Path of an object over time, in the axes of the sensor; linear between its K knots.

    A pose is a translation, and a rotation vector about the object's own origin. With a pose of
    zeros the object just touches the apex.

    Attributes
    ----------
    times: times of the knots, increasing from 0 [s], shape (K,)
    poses: (x, y, z) [m] and rotation vector [rad] at each knot, shape (K, 6); −z presses
    free: axes, of `AXES`, that are not prescribed but moved by forces; after the first knot their
        entries in `poses` are not used
    loads: force [N] and torque [N·m] on the free axes at each knot, shape (K, 6); None: no load
    mass: mass of the object [kg]
    inertia: moments of inertia about its own axes through its origin [kg·m²], shape (3,)
    drag: damper of each axis to ground [N·s/m, N·m·s], shape (6,)
    gravity: acceleration of gravity [m/s²], shape (3,)
    """

    times: Array
    poses: Array
    free: tuple[str, ...] = ()
    loads: Array | None = None
    mass: float = 0.0
    inertia: tuple[float, float, float] = (0.0, 0.0, 0.0)
    drag: tuple[float, ...] = (0.0,) * 6
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    _free: NDArray[np.bool_] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        times = np.asarray(self.times, float)
        poses = np.asarray(self.poses, float)
        loads = np.zeros((len(times), 6)) if self.loads is None else np.asarray(self.loads, float)
        if times.ndim != 1 or len(times) < 2 or times[0] != 0.0 or not (np.diff(times) > 0.0).all():
            raise UserError("times of a motion must be two or more, increasing from 0")
        for name, values in (("poses", poses), ("loads", loads)):
            if values.shape != (len(times), 6):
                raise UserError(
                    f"{name} of a motion must have the shape ({len(times)}, 6), got {values.shape}"
                )
            if not np.isfinite(values).all():
                row = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
                raise UserError(
                    f"{name} of a motion must be finite, not {values[row]} at knot {row}"
                )
        unknown = [axis for axis in self.free if axis not in AXES]
        if unknown:
            raise UserError(f"free axes of a motion are of {', '.join(AXES)}, got {unknown[0]!r}")
        if len(self.drag) != 6 or len(self.inertia) != 3 or len(self.gravity) != 3:
            raise UserError("a motion has 6 dampers, 3 inertias and 3 components of gravity")
        finite("mass of the object", self.mass, "kg", above=-math.ulp(0.0))
        for name, numbers in (("inertia", self.inertia), ("drag", self.drag)):
            if not all(math.isfinite(value) and value >= 0.0 for value in numbers):
                raise UserError(
                    f"{name} of a motion must be finite and not negative, got {numbers}"
                )
        free = np.array([axis in self.free for axis in AXES])
        for k in np.flatnonzero(free):
            held = self.mass if k < 3 else self.inertia[k - 3]
            if held == 0.0 and self.drag[k] == 0.0:
                what = "mass" if k < 3 else "inertia"
                raise UserError(f"axis {AXES[k]} is free: it needs {what} or drag above 0")
        for name, values in (("times", times), ("poses", poses), ("loads", loads), ("_free", free)):
            values = values.copy()
            values.setflags(write=False)
            object.__setattr__(self, name, values)

    @property
    def duration(self) -> float:
        """Time of the last knot [s]."""
        return float(self.times[-1])

    @property
    def moves_free(self) -> NDArray[np.bool_]:
        """Whether each axis is free, shape (6,)."""
        return self._free

    def pose_at(self, time: float) -> Array:
        """Prescribed pose [m, rad], shape (6,)."""
        return _between(self.times, self.poses, time)

    def load_at(self, time: float) -> Array:
        """Load on the free axes, without gravity [N, N·m], shape (6,)."""
        assert self.loads is not None
        return _between(self.times, self.loads, time)


@dataclass(frozen=True, slots=True)
class Way:
    """Straight way of an object from a pose to another, in place of a `Motion`.

    Attributes
    ----------
    begin, end: times of both poses [s]
    place, rotation: first place [m] and rotation matrix, shapes (3,) and (3, 3)
    shift, turn: translation [m] and rotation vector [rad] to the other pose, each of shape (3,)
    """

    begin: float
    end: float
    place: Array
    rotation: Array
    shift: Array
    turn: Array

    @property
    def moves_free(self) -> NDArray[np.bool_]:
        """Whether each axis is free, shape (6,): none."""
        return _NONE

    def at(self, time: float) -> tuple[Array, Array]:
        """Rotation matrix and place [m] at a time [s]."""
        share = (time - self.begin) / (self.end - self.begin)
        return turned(self.rotation, share * self.turn), self.place + share * self.shift


_NONE = np.zeros(len(AXES), np.bool_)
_NONE.setflags(write=False)


def _between(times: Array, values: Array, time: float) -> Array:
    """Interpolate values at the knots linearly; constant outside."""
    k = min(max(int(np.searchsorted(times, time, side="right")) - 1, 0), len(times) - 2)
    share = min(max((time - times[k]) / (times[k + 1] - times[k]), 0.0), 1.0)
    return values[k] + share * (values[k + 1] - values[k])


def press_and_move(
    depth: float,
    *,
    shift: tuple[float, float] = (0.0, 0.0),
    twist: float = 0.0,
    tilt: tuple[float, float] = (0.0, 0.0),
    press_s: float = 0.1,
    move_s: float = 0.1,
) -> Motion:
    """Make the motion of most measurements: press to a depth, then shift and twist.

    Parameters
    ----------
    depth: depth of the press [m]
    shift: shift along x and y, after the press [m]
    twist: twist about z, after the press [rad]
    tilt: tilt about x and y, before the touch [rad]
    press_s, move_s: durations of press and of shift and twist [s]

    Raises
    ------
    UserError: for a depth that is not above 0
    """
    finite("depth of a press", depth, "m", above=0.0)
    tilted = np.array([*tilt, 0.0])
    start = np.concatenate([np.zeros(3), tilted])
    pressed = start + np.array([0.0, 0.0, -depth, 0.0, 0.0, 0.0])
    knots = [start, pressed]
    times = [0.0, press_s]
    if any(shift) or twist:
        steps = max(1, math.ceil(abs(twist) / 0.05)) if any(tilt) else 1
        for k in range(1, steps + 1):
            share = k / steps
            turn = _composed(np.array([0.0, 0.0, share * twist]), tilted)
            knots.append(np.array([share * shift[0], share * shift[1], -depth, *turn]))
            times.append(press_s + share * move_s)
    return Motion(times=np.array(times), poses=np.array(knots))


def _composed(second: ArrayLike, first: ArrayLike) -> Array:
    """Rotation vector of rotation `first`, followed by `second`."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_rotvec(np.asarray(second)) * Rotation.from_rotvec(np.asarray(first))
    return turn.as_rotvec()
