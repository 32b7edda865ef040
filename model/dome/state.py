"""State from which a dome's step starts, and counts of a step."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ..shapes import distances
from .dome import SoftBody, lattice
from .motion import Motion
from .placing import rotation_of, touching_place
from .solid import Solid

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class DomeState:
    """Everything that a step of a dome starts from.

    Attributes
    ----------
    time: time of the state [s]
    place, rotation: position [m] and rotation matrix of the object in the sensor's frame, shapes
        (3,) and (3, 3)
    velocity: velocity [m/s] and angular velocity [rad/s] of the object, shape (6,)
    displacement: displacements of the nodes [m], shape (N, 3); valid only for those in `near`, see
        `displacements`
    linear: forces that the linear skin carries [N], shape (N, 3)
    memory: low-pass filtered `linear` of a viscous skin, which displaces it [N], shape (N, 3)
    forces: forces of the object on the nodes [N], shape (N, 3)
    friction: part of `forces` in the object's tangent planes [N], shape (N, 3)
    normals: unit normals of the object at the nodes that touch it, zero elsewhere, shape (N, 3)
    near: indices of the active nodes, in the order of a step's equations, shape (n,)
    """

    time: float
    place: Array
    rotation: Array
    velocity: Array
    displacement: Array
    linear: Array
    memory: Array
    forces: Array
    friction: Array
    normals: Array
    near: Index

    @property
    def carried(self) -> Array:
        """Input of the membrane map: forces on the linear skin [N], (N, 3)."""
        return self.memory if self.memory.any() else self.linear


class StepCount(NamedTuple):
    """Effort and result of a step, in numbers.

    Attributes
    ----------
    rounds: number of rounds of Newton's method
    products: number of products with the compliance matrix
    touching: number of nodes that touch at the end
    halvings: number of halvings of the step or its parts
    error: relative change of the forces in the last round
    unconverged: number of parts of the step that were accepted although they did not converge
    """

    rounds: int
    products: int
    touching: int
    halvings: int
    error: float
    unconverged: int = 0


def resting(dome: SoftBody, solid: Solid, motion: Motion) -> DomeState:
    """State at the start of a motion, without contact.

    Raises
    ------
    UserError: when the object is in the silicone at the start.
    """
    rotation = rotation_of(motion.poses[0])
    place = touching_place(dome, solid, rotation) + motion.poses[0, :3]
    gap, _ = distances(solid.shape, (lattice(dome).points - place) @ rotation)
    if gap.min() < -1e-9:
        raise UserError(
            f"the object {solid.shape.name} is {-1e3 * gap.min():.3g} mm inside the skin at the "
            "start; the first pose must not be below the one that just touches, which is all zeros"
        )
    return untouched(dome, place, rotation)


def untouched(dome: SoftBody, place: Array, rotation: Array) -> DomeState:
    """State of an undeformed skin with the object at a pose (3,) [m] and (3, 3)."""
    count = len(lattice(dome).ring)

    def zeros() -> Array:
        return np.zeros((count, 3))

    return DomeState(
        time=0.0, place=place, rotation=rotation, velocity=np.zeros(6), displacement=zeros(),
        linear=zeros(), memory=zeros(), forces=zeros(), friction=zeros(), normals=zeros(),
        near=np.zeros(0, np.int64),
    )  # fmt: skip


def check_state(dome: SoftBody, state: DomeState) -> None:
    """Refuse a state of another dome.

    Raises
    ------
    UserError
    """
    own, count = len(lattice(dome).ring), len(state.linear)
    if count != own:
        raise UserError(f"the state is of a dome with {count} nodes, and this dome has {own}")
