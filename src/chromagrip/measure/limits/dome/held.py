"""A contact that is gripped and sheared on a dome, and what each of its unknowns changes of it.

The unknowns are those of the reconstructor `contact`: an object, and its pose in each picture. The
pictures are one of the press, and some on the way of the shear, at equal shares of the load.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ....errors import UserError, located
from ....model import Dome
from ....model.dome import PosedContact, lattice, solid_stiffness
from ....tracking.forces.dome import (
    CURVES,
    FRICTION,
    MOVING,
    PRESS,
    STIFFNESS,
    Changes,
    ContactWay,
    limited_object,
    limited_pose,
    prior_of,
    units_of,
)
from ..body import reserve_of

Array = NDArray[np.float64]

#: Largest error of a force that is held, as a share of the grip, and rounds in which it is found.
_HELD, _ROUNDS = 1e-3, 40
#: Longest step of a round over the silicone's thickness, and where the press starts.
_LONGEST, _START = 0.1, 0.1
#: Normal force of a node that touches, as a share of all.
_TOUCHING = 1e-6
#: Names of `sums`.
SUMS = ("x", "y", "normal", "moment", "pressing", "sliding")


@dataclass(frozen=True, kw_only=True)
class Grip:
    """What is held, and how.

    Attributes
    ----------
    normal, load: forces of the object along the dome's axis, then along the skin [N]
    azimuth: of the load, from the sensor's x [rad]
    friction: of the object
    radius: of the object, a ball [m]; infinite is flat
    young: modulus of the object [Pa]
    shears: pictures of the shear
    """

    normal: float
    load: float
    azimuth: float = 0.0
    friction: float = 0.5
    radius: float = math.inf
    young: float = 200e3
    shears: int = 3


@dataclass(frozen=True, kw_only=True)
class Held:
    """A contact in K pictures, the last of which is asked.

    Attributes
    ----------
    dome, friction: of the contact
    object_, poses: unknowns of the reconstructor `contact`, shapes (8,) and (K, 4)
    linear: forces on the linear skin in each picture [N], shape (K, N, 3)
    changes: of them in each picture by its own pose and the object, over their units, (K, 12, N, 3)
    contact: forces in the last picture
    sums: of it, see `sums_of`, shape (6,)
    slopes: of the sums by its pose and the object, over their units, shape (6, 12)
    """

    dome: Dome
    friction: float
    object_: Array
    poses: Array
    linear: Array
    changes: Array
    contact: PosedContact
    sums: Array
    slopes: Array

    @property
    def touching(self) -> NDArray[np.intp]:
        """Numbers of the nodes in contact."""
        normal = self.contact.normal
        return np.flatnonzero(normal > _TOUCHING * normal.sum())

    @property
    def margin(self) -> float:
        """Γ."""
        return float(1.0 - self.sums[5] / (self.friction * self.sums[4]))


@lru_cache(maxsize=8)
def hold(dome: Dome, grip: Grip) -> Held:
    """Press an object onto a dome and shear it.

    Raises
    ------
    UserError
        When the grip does not hold the load, and when the dome cannot bear it.
    """
    reserve_of(grip.normal, grip.load, grip.friction)
    way, object_ = ContactWay(dome), _object(dome, grip)
    sharpest = float(limited_object(dome, object_)[CURVES][0])
    if object_[CURVES][0] > 1.001 * sharpest:
        raise UserError(
            f"an object of radius {1e3 * grip.radius:g} mm is sharper than a contact on a dome of "
            f"{1e3 * dome.radius:g} mm is described: {1e3 / sharpest:g} mm or more are allowed"
        )
    contact, changes, before = way.untouched(object_), None, np.zeros(MOVING)
    poses, linear, moved = [], [], []
    with located(f"a dome of {1e3 * dome.radius:g} mm cannot hold {grip.normal:g} N"):
        for share in np.linspace(0.0, 1.0, grip.shears + 1):
            pose = _pose(way, contact, object_, before, grip, float(share))
            if (limited_pose(dome, pose) != pose).any():
                raise UserError("it would be pressed deeper than the silicone is described")
            contact, changes = way.step_and_changes(contact, changes, object_, before, pose)
            poses.append(pose)
            linear.append(loads_of(dome, contact).linear)
            moved.append(loads_of(dome, changes.changed).linear - linear[-1])
            before = pose
    assert changes is not None
    sums, ends = sums_of(dome, loads_of(dome, contact)), _ends(dome, changes)
    return Held(
        dome=dome,
        friction=grip.friction,
        object_=object_,
        poses=np.stack(poses),
        linear=np.stack(linear),
        changes=np.stack(moved),
        contact=loads_of(dome, contact),
        sums=sums,
        slopes=ends - sums[:, None],
    )


def loads_of(dome: Dome, contact: PosedContact) -> PosedContact:
    """A contact, or several, on all nodes."""
    return contact.everywhere(len(lattice(dome).ring))


def _ends(dome: Dome, changes: Changes) -> Array:
    """Sums of a contact with each unknown changed by its unit, shape (6, C)."""
    each = [changes.changed.at(k) for k in range(len(changes.changed.place))]
    return np.stack([sums_of(dome, loads_of(dome, one)) for one in each], axis=-1)


def sums_of(dome: Dome, contact: PosedContact) -> Array:
    """Sums of a contact, in the order of SUMS, shape (6,).

    F_x, F_y and the force F_n towards the core [N]; the moment about the dome's axis [N·m], with
    the nodes where they rest, so that a force has the same arm however far the skin has moved; ΣFn
    and ΣFf [N].
    """
    whole, points = contact.forces.sum(axis=0), lattice(dome).points
    moment = points[:, 0] @ contact.forces[:, 1] - points[:, 1] @ contact.forces[:, 0]
    sliding = float(np.linalg.norm(sliding_of(contact)))
    return np.array([whole[0], whole[1], -whole[2], moment, contact.normal.sum(), sliding])


def sliding_of(contact: PosedContact) -> Array:
    """Sum of the friction across the mean normal [N], shape (3,)."""
    axis = (contact.forces - contact.friction).sum(axis=0)
    slides = contact.friction.sum(axis=0)
    return np.asarray(slides - axis * float(slides @ axis) / max(float(axis @ axis), 1e-24))


def _object(dome: Dome, grip: Grip) -> Array:
    """Unknowns of the object, shape (8,)."""
    object_ = prior_of(dome).mean.copy()
    curve = 1.0 / grip.radius
    object_[CURVES] = curve, curve, 0.0
    object_[STIFFNESS] = math.log(solid_stiffness(grip.young))
    object_[FRICTION] = math.log(grip.friction)
    return object_


def _pose(
    way: ContactWay, contact: PosedContact, object_: Array, before: Array, grip: Grip, share: float
) -> Array:
    """Pose at which the object presses with its grip, and pulls with a share of its load.

    Newton's method; steps are shortened where it comes no nearer.
    """
    dome, units = way.dome, units_of(way.dome)[: PRESS + 1]
    load = share * grip.load
    target = np.array([load * math.cos(grip.azimuth), load * math.sin(grip.azimuth), grip.normal])
    pose = before.copy()
    pose[PRESS] = max(pose[PRESS], _START * dome.thickness)
    best, least, step = pose, math.inf, np.zeros(PRESS + 1)
    for _ in range(_ROUNDS):
        reached, changes = way.step_and_changes(
            contact, None, object_, before, pose, tuple(range(PRESS + 1))
        )
        if not reached.forces.any():
            raise UserError("the object touches no node of the skin")
        error = target - sums_of(dome, loads_of(dome, reached))[:3]
        size = float(abs(error).max())
        if size < _HELD * grip.normal:
            return pose
        if size > 2.0 * least:
            step = 0.5 * step
        else:
            if size < least:
                least = size
            best = pose
            ends = _ends(dome, changes)[:3]
            slope = (ends - (target - error)[:, None]) / units
            step = np.asarray(np.linalg.solve(slope, error), np.float64)
            step *= min(1.0, _LONGEST * dome.thickness / float(abs(step).max()))
        pose = best.copy()
        pose[: PRESS + 1] += step
    raise UserError("no pose of the object was found")
