"""Random grips of objects on a dome: pressed, then loaded to one margin after another."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ....loop.dome_world import PRESS_DRAG
from ....model import Dome, Motion, Solid
from ....model.dome import solid_stiffness
from ....model.shapes import Shape, ball, box, cylinder, mesh, plane, torus

Array = NDArray[np.float64]

#: Ranges of the objects: Young's modulus [Pa], evenly in the logarithm, and µ.
MODULI, FRICTIONS = (60e3, 1e6), (0.25, 0.9)
#: Radii of balls and rods over that of the dome.
BALLS, RODS = (0.25, 2.0), (0.3, 1.0)
#: Largest tilt of planes and rods [rad].
TILT = math.radians(8.0)
#: Margins that a grip is loaded to one after another, 1 − load/(µ·grip), and how far off they are.
MARGINS, _AROUND = (0.6, 0.3, 0.1), 0.03
#: Times to press, to load to the next margin, and to hold each [s].
_PRESSING, _LOADING, _HOLDING = 0.3, 0.15, 0.1
#: Least and largest turn of an object about the axis [rad].
_TURNS = (math.radians(5.0), math.radians(25.0))
#: Damper of an object along the skin [N·s/m].
_DRAG = 2.0
#: Objects of convex, smooth shape, and others, in turns.
SMOOTH = ("plane", "ball", "rod", "tilted")
UNLIKE = ("bumps", "two", "edge", "beside", "ring")


@dataclass(frozen=True, kw_only=True)
class Grip:
    """An object that is pressed onto a dome and loaded, or turned.

    Attributes
    ----------
    solid: object
    pose: where it is, and its rotation vector, see `Motion`, shape (6,)
    lean: rotation vector of the axes that grip and load act along, shape (3,)
    normal: force that presses it [N]
    azimuth: direction of the load [rad]
    margins: that it is loaded to, 1 − load/(µ·grip) of a flat object; 1 holds it
    turn: about the axis of the dome, from the end of the press to that of the first load [rad]
    """

    solid: Solid
    pose: Array
    lean: Array
    normal: float
    azimuth: float
    margins: tuple[float, ...]
    turn: float = 0.0

    @property
    def ends(self) -> tuple[float, ...]:
        """Ends of the holds: once pressed, and at each margin [s]."""
        return ends_of(self._staged[0])

    @property
    def motion(self) -> Motion:
        """Forces over time, and turns."""
        times, (normal, load) = self._staged[0], self._staged[1].T
        cos, sin = math.cos(self.azimuth), math.sin(self.azimuth)
        forces = np.zeros((len(times), 6))
        forces[:, :3] = Rotation.from_rotvec(self.lean).apply(
            np.stack([load * cos, load * sin, -normal], axis=-1)
        )
        poses = np.tile(self.pose, (len(times), 1))
        if self.turn:
            turned = Rotation.from_rotvec([0.0, 0.0, self.turn])
            poses[3:, 3:] = (turned * Rotation.from_rotvec(self.pose[3:])).as_rotvec()
        return Motion(
            times=times,
            poses=poses,
            free=("x", "y", "z"),
            loads=forces,
            drag=(_DRAG, _DRAG, PRESS_DRAG, 0.0, 0.0, 0.0),
        )

    @property
    def _staged(self) -> tuple[Array, Array]:
        return staged(self.normal, self.solid.friction, self.margins)


def random_grip(rng: np.random.Generator, dome: Dome, kind: str, normal: float) -> Grip:
    """A grip of an object of SMOOTH or UNLIKE with random stiffness, µ, tilt and load.

    Parameters
    ----------
    rng: that it is drawn from
    dome: that it is made for
    kind: of object
    normal: force of the grip [N]
    """
    radius, turn = dome.radius, Rotation.from_rotvec([0.0, 0.0, rng.uniform(0.0, math.pi)])
    axis = rng.uniform(0.0, 2.0 * math.pi)
    lean = rng.uniform(0.0, TILT) * np.array([math.cos(axis), math.sin(axis), 0.0])
    pose = np.zeros(6)
    if kind in ("rod", "tilted"):
        pose[3:] = (Rotation.from_rotvec(lean) * turn).as_rotvec()
    else:
        lean = np.zeros(3)
    shape: Shape
    if kind in ("plane", "tilted"):
        shape = plane()
    elif kind == "ball":
        shape = ball(radius * rng.uniform(*BALLS))
    elif kind == "rod":
        shape = cylinder(radius * rng.uniform(*RODS))
    else:
        shape, pose = unlike_shape(rng, kind, radius)
    return Grip(
        solid=Solid(
            shape=shape,
            stiffness=solid_stiffness(math.exp(rng.uniform(*np.log(MODULI)))),
            friction=rng.uniform(*FRICTIONS),
        ),
        pose=pose,
        lean=lean,
        normal=normal,
        azimuth=rng.uniform(0.0, 2.0 * math.pi),
        margins=random_margins(rng),
    )


def turned(rng: np.random.Generator, grip: Grip) -> Grip:
    """The grip without a load, its object turned back by a random angle."""
    angle = rng.uniform(*_TURNS) * (1.0 if rng.uniform() < 0.5 else -1.0)
    # A rotation vector grows up to half a turn.
    angle = -abs(angle) if grip.pose[5] > 0.0 else angle
    return replace(grip, margins=(1.0,), turn=angle)


def random_margins(rng: np.random.Generator) -> tuple[float, ...]:
    """Margins near MARGINS."""
    return tuple(margin + float(rng.uniform(-_AROUND, _AROUND)) for margin in MARGINS)


def staged(normal: float, friction: float, margins: tuple[float, ...]) -> tuple[Array, Array]:
    """Times [s] and (grip, load) at them [N]: pressed, then loaded to one margin after another.

    Each is held for a while. The margins are 1 − load/(µ·grip).
    """
    times, forces = [0.0], [(0.0, 0.0)]
    for k, margin in enumerate((1.0, *margins)):
        end = _PRESSING + _HOLDING + k * (_LOADING + _HOLDING)
        times += [end - _HOLDING, end]
        forces += 2 * [(normal, friction * normal * (1.0 - margin))]
    return np.array(times), np.array(forces)


def ends_of(times: Array) -> tuple[float, ...]:
    """Ends of the holds of `staged` [s]."""
    return tuple(float(time) for time in times[2::2])


def unlike_shape(rng: np.random.Generator, kind: str, radius: float) -> tuple[Shape, Array]:
    """A shape that is not smooth or not convex, and how it lies."""
    angle, place = rng.uniform(0.0, math.pi), np.zeros(3)
    turn = Rotation.from_rotvec([0.0, 0.0, angle])
    if kind == "bumps":
        shape = mesh(_bumpy(radius), centred=True)
    elif kind == "two":
        shape = mesh(_pair(radius), centred=True)
    elif kind == "ring":
        shape = torus(0.35 * radius, 0.1 * radius)
        turn = Rotation.from_rotvec([math.pi / 2, 0.0, 0.0])
    else:
        shape = box(1.2 * radius, rounding=0.02 * radius)
        if kind == "edge":
            turn *= Rotation.from_rotvec([0.0, math.pi / 4, 0.0])
        else:  # an edge passes beside the middle of the contact
            place[:2] = 0.55 * radius * np.array([math.cos(angle), math.sin(angle)])
    return shape, np.concatenate([place, turn.as_rotvec()])


def _bumpy(radius: float) -> object:
    """A ball with ridges and hollows, as a mesh [m]."""
    import trimesh

    made = trimesh.creation.icosphere(subdivisions=4, radius=0.6 * radius)
    x, y, z = (made.vertices * (16.0 / radius)).T
    made.vertices *= (1.0 + 0.06 * np.cos(x) * np.cos(y) * np.cos(z))[:, None]
    return made


def _pair(radius: float) -> object:
    """Two balls beside each other, as a mesh [m]."""
    import trimesh

    one, other = (trimesh.creation.icosphere(subdivisions=3, radius=0.2 * radius) for _ in "12")
    one.apply_translation([-0.25 * radius, 0.0, 0.0])
    other.apply_translation([0.25 * radius, 0.0, 0.0])
    return trimesh.util.concatenate([one, other])
