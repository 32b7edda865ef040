"""Rigid body between two fingertips, and its motion over a step.

Momentum and angular momentum about the centre of mass are integrated by BDF2 with variable steps.
For a value y at the ends of the last steps,

    h·ẏ₁ = a₀·y₁ − a₁·y₀ + a₂·y₋₁,    a₀ = (1 + 2r)/(1 + r),  a₁ = 1 + r,  a₂ = r²/(1 + r)

with r = step/previous step; r = 0 is backward Euler, the first step. A swing of angular frequency ω
loses the share (ω·h)⁴/4 of its amplitude per step; faster oscillations are damped at once.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ..checks import finite, within
from ..kernels.dome.turn_kernels import rotation_vector, turned

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class RigidBody:
    """Mass properties of an object.

    Attributes
    ----------
    mass: mass [kg]
    inertia: moments of inertia about the centre of mass, along the object's own axes [kg·m²], (3,)
    centre: centre of mass in the object's own frame [m], shape (3,)
    """

    mass: float
    inertia: tuple[float, float, float]
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        finite("mass of the object", self.mass, "kg", above=0.0)
        if len(self.inertia) != 3 or len(self.centre) != 3:
            raise UserError("a body has 3 moments of inertia and 3 coordinates of its centre")
        for value in self.inertia:
            finite("moment of inertia", value, "kg·m²", above=0.0)
        for value in self.centre:
            finite("centre of mass", value, "m", above=-1.0, below=1.0)


@dataclass(frozen=True, kw_only=True)
class Filling:
    """Mass that is added to a body over time: linear between knots, constant outside.

    It is added at the centre of mass, without momentum of its own: momentum changes by forces only.
    The moments of inertia grow in proportion to the mass.

    Attributes
    ----------
    times: times of the knots, increasing [s]
    masses: total added mass at each knot [kg]
    """

    times: tuple[float, ...]
    masses: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.times or len(self.times) != len(self.masses):
            raise UserError(
                f"a filling has {len(self.times)} times and {len(self.masses)} masses; both need "
                "the same number, at least one"
            )
        if not (np.diff(self.times) > 0.0).all() or not np.isfinite(self.times).all():
            raise UserError(f"times of a filling must increase, got {list(self.times)}")
        for mass in self.masses:
            within("mass that is added", mass, "kg", 0.0, 1e3)

    def at(self, time: float) -> float:
        """Mass that has been added at a time [kg]."""
        return float(np.interp(time, self.times, self.masses))


def box_body(
    mass: float,
    size: tuple[float, float, float],
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> RigidBody:
    """Make a body with the moments of inertia of a homogeneous box about its centre of mass.

    Parameters
    ----------
    mass: mass [kg]
    size: edge lengths of the box [m]
    centre: centre of mass in the object's own frame [m]
    """
    x, y, z = (edge**2 for edge in size)
    inertia = (mass * (y + z) / 12, mass * (x + z) / 12, mass * (x + y) / 12)
    return RigidBody(mass=mass, inertia=inertia, centre=centre)


@dataclass(frozen=True, kw_only=True)
class Moving:
    """State of motion of a rigid body in the world's frame, now and one step before.

    Attributes
    ----------
    place: position of the centre of mass [m], shape (3,)
    rotation: rotation matrix from the body's own frame to the world's, shape (3, 3)
    momentum: momentum [N·s], shape (3,)
    spin: angular momentum about the centre of mass [N·m·s], shape (3,)
    place_before, momentum_before, spin_before: values one step before, shape (3,)
    turn_before: rotation vector of the last step [rad], shape (3,)
    step_before: length of the last step [s]; 0: the next step is a first one
    """

    place: Array
    rotation: Array
    momentum: Array
    spin: Array
    place_before: Array
    momentum_before: Array
    spin_before: Array
    turn_before: Array
    step_before: float


def at_rest(place: Array, rotation: Array) -> Moving:
    """Make the state of a body at rest."""
    none = np.zeros(3)
    return Moving(
        place=place, rotation=rotation, momentum=none, spin=none, place_before=place,
        momentum_before=none, spin_before=none, turn_before=none, step_before=0.0,
    )  # fmt: skip


class Scheme(NamedTuple):
    """BDF2 coefficients of a step: h·ẏ₁ = now·y₁ − last·y₀ + before·y₋₁, with h = `step` [s]."""

    now: float
    last: float
    before: float
    step: float


def scheme(moving: Moving, step: float) -> Scheme:
    """BDF2 coefficients of a body's next step [s]."""
    r = step / moving.step_before if moving.step_before > 0.0 else 0.0
    return Scheme((1.0 + 2.0 * r) / (1.0 + r), 1.0 + r, r * r / (1.0 + r), step)


class Wanted(NamedTuple):
    """Inertial force and torque of a body at a guess of its pose, and their derivatives.

    Attributes
    ----------
    force, torque: inertial force [N] and torque [N·m] at the guess: minus the rates of momentum and
        angular momentum, shape (3,)
    mass: increase of the opposing force per displacement from the guess [N/m]
    inertia: increase of the opposing torque per rotation from the guess [N·m], shape (3, 3)
    """

    force: Array
    torque: Array
    mass: float
    inertia: Array


def wanted(body: RigidBody, moving: Moving, s: Scheme, place: Array, rotation: Array) -> Wanted:
    """Inertial force and torque of a step that ends near a guess of the pose in the world."""
    momentum = body.mass * _rate(s, place, moving.place, moving.place_before)
    tensor = rotation @ np.diag(body.inertia) @ rotation.T
    spin = tensor @ _turning(s, moving, rotation)
    square = (s.now / s.step) ** 2
    return Wanted(
        -_rate(s, momentum, moving.momentum, moving.momentum_before),
        -_rate(s, spin, moving.spin, moving.spin_before),
        square * body.mass,
        square * tensor,
    )


def carried(
    moving: Moving, s: Scheme, place: Array, rotation: Array, force: Array, torque: Array
) -> Moving:
    """Update a body by a step to a pose, under a force and a torque about the centre of mass.

    Momentum and angular momentum follow from force and torque.
    """
    turn = rotation_vector(rotation @ moving.rotation.T)
    return Moving(
        place=place,
        rotation=rotation,
        momentum=(s.last * moving.momentum - s.before * moving.momentum_before + s.step * force)
        / s.now,
        spin=(s.last * moving.spin - s.before * moving.spin_before + s.step * torque) / s.now,
        place_before=moving.place,
        momentum_before=moving.momentum,
        spin_before=moving.spin,
        turn_before=turn,
        step_before=s.step,
    )


def _rate(s: Scheme, now: Array, last: Array, before: Array) -> Array:
    """Time derivative at the end of a step, from values at its ends and one step before."""
    return (s.now * now - s.last * last + s.before * before) / s.step


def _turning(s: Scheme, moving: Moving, rotation: Array) -> Array:
    """Angular velocity at the end of a step [rad/s], as the rate of the step's rotation vector.

    The difference between the two is of second order in the step.
    """
    turn = rotation_vector(rotation @ moving.rotation.T)
    return np.asarray((s.now * turn - s.before * moving.turn_before) / s.step)


def rotation_by(vector: Array) -> Array:
    """Rotation matrix (3, 3) of a rotation vector [rad]."""
    return np.asarray(turned(np.eye(3), np.ascontiguousarray(vector, float)))
