"""Contacts of one dome at prescribed poses, each from a history of its own.

A dome that is stepped (`stepper`) changes its arrays. Here a step makes a new history of an old
one, so that many steps from the same instant can be compared: under other poses, on other objects.
They share the nodes that are looked at and their compliance, and so are cheap.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from ..errors import ConvergenceError
from ..kernels.compliance_kernels import displace, fill_block
from ..kernels.krylov_kernels import System, new_system
from ..kernels.newton_kernels import Contact, Outcome, solve_contact
from ..kernels.touch_kernels import Pose
from ..shapes import distances
from .compliance import compliance_scale, compliance_table
from .dome import Dome, lattice
from .solid import Solid, touched
from .stepper import ENOUGH, ROUNDS
from .stiffening import stiffening_of

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: Nodes so near to an object, and to nodes that touch it, are looked at [pitches].
_NEAR, _BESIDE = 0.3, 1.6
#: Times that a step is halved.
_HALVINGS = 3
#: Relative change of the forces at which a step is solved: small beside what is differentiated.
TOLERANCE = 1e-4
#: No axis of a pose is free, and so none has inertia.
_HELD, _NO_INERTIA = np.zeros(6, np.bool_), np.zeros((6, 6))


@dataclass(frozen=True, kw_only=True)
class PosedContact:
    """A dome and an object at a pose, with what the next step needs of the way there.

    Attributes
    ----------
    rotation, place: of the object, as of `DomeState`
    displacement: of the nodes [m], shape (N, 3); right for those that were looked at
    linear: forces that the linear skin carries [N], shape (N, 3)
    forces: of the object on the nodes [N], shape (N, 3)
    friction: the part of `forces` in the object's tangent planes [N], shape (N, 3)
    normals: of the object at the nodes that touch it, zero elsewhere, shape (N, 3)
    """

    rotation: Array
    place: Array
    displacement: Array
    linear: Array
    forces: Array
    friction: Array
    normals: Array

    @property
    def normal(self) -> Array:
        """Normal force of each node [N], shape (N,)."""
        return np.asarray(np.einsum("ij,ij->i", self.forces, self.normals))


class PosedContacts:
    """Steps of contacts on one dome.

    Parameters
    ----------
    dome: elastic, without viscosity
    """

    def __init__(self, dome: Dome) -> None:
        self.dome = dome
        self._lattice = lattice(dome)
        self._radial = self._lattice.points / dome.radius
        self._tree = KDTree(self._lattice.points)
        self._table, self._scale = compliance_table(dome), compliance_scale(dome)
        self._room = 0
        self._compliance = np.zeros((0, 0), np.float32)
        self._own = np.zeros((0, 3, 3))
        self._system: System = new_system(0)
        self.near: Index = np.zeros(0, np.int64)

    def untouched(self, rotation: Array, place: Array) -> PosedContact:
        """A dome at rest, and an object that does not touch it."""
        zeros = np.zeros_like(self._radial)
        return PosedContact(
            rotation=rotation, place=place, displacement=zeros, linear=zeros, forces=zeros,
            friction=zeros, normals=zeros,
        )  # fmt: skip

    def look(self, last: PosedContact, solid: Solid, rotation: Array, place: Array) -> PosedContact:
        """Look at the nodes that an object may touch in the next step, and at no others.

        Returns
        -------
        The last contact, with the displacement of all of them.
        """
        points = self._lattice.points
        gap, _ = distances(solid.shape, (points + last.displacement - place) @ rotation)
        wanted = gap < _NEAR * self.dome.spacing
        held = np.flatnonzero(last.linear.any(axis=1))
        if len(held):
            beside = self._tree.query_ball_point(points[held], _BESIDE * self.dome.spacing)
            wanted[np.unique(np.concatenate([np.asarray(b, np.int64) for b in beside]))] = True
        inside = wanted[self.near]
        if inside.sum() == wanted.sum() and len(self.near) < 1.4 * wanted.sum() + 20:
            return last
        stay = self.near[inside]
        kept = len(stay) if len(stay) == len(self.near) else 0
        wanted[stay] = False
        new = np.flatnonzero(wanted)
        self._take(np.concatenate([stay, new]), kept)
        displacement = last.displacement.copy()
        nodes = self._lattice
        displace(
            self._table, len(nodes.angles), nodes.ring, nodes.azimuth, self._scale, held,
            last.linear, new, displacement,
        )  # fmt: skip
        return replace(last, displacement=displacement)

    def step(self, last: PosedContact, solid: Solid, rotation: Array, place: Array) -> PosedContact:
        """Contact after the object has moved to a pose.

        Raises
        ------
        ConvergenceError
            When the contact has no solution near the one before.
        """
        return self._halved(last, solid, rotation, place, _HALVINGS)

    def _halved(
        self, last: PosedContact, solid: Solid, rotation: Array, place: Array, left: int
    ) -> PosedContact:
        after, error = self._solve(last, solid, rotation, place)
        if error < TOLERANCE or (not left and error < ENOUGH):
            return after
        if not left:
            raise ConvergenceError("the contact does not converge")
        turn = Rotation.from_matrix(rotation @ last.rotation.T).as_rotvec()
        half = Rotation.from_rotvec(0.5 * turn).as_matrix() @ last.rotation
        middle = self._halved(last, solid, half, 0.5 * (last.place + place), left - 1)
        return self._halved(middle, solid, rotation, place, left - 1)

    def _solve(
        self, last: PosedContact, solid: Solid, rotation: Array, place: Array
    ) -> tuple[PosedContact, float]:
        near, nodes = self.near, self._lattice
        rest, areas = nodes.points[near], nodes.areas[near]
        contact = Contact(
            rest, self._radial[near], areas, rest + last.displacement[near],
            np.zeros((len(near), 3)), last.friction[near], self._compliance, self._own,
        )  # fmt: skip
        shape = (len(near), 3)
        outcome = Outcome(
            last.linear[near], np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape),
            np.zeros(6),
        )  # fmt: skip
        pose = Pose(last.rotation, last.place, rotation, place)
        stiff = stiffening_of(
            self.dome, solid.friction, areas, last.forces[near], last.friction[near]
        )
        error, _, _, _ = solve_contact(
            contact, touched(solid), pose, stiff, 1.0, _HELD, _NO_INERTIA, np.zeros(6), TOLERANCE,
            ROUNDS, self._system, outcome,
        )  # fmt: skip
        outcome.normal[~np.asarray(outcome.true.any(axis=1))] = 0.0
        count = len(self._radial)
        after = PosedContact(
            rotation=rotation,
            place=place,
            displacement=_spread(last.displacement.copy(), near, outcome.displacement),
            linear=_spread(np.zeros((count, 3)), near, outcome.linear),
            forces=_spread(np.zeros((count, 3)), near, outcome.true),
            friction=_spread(np.zeros((count, 3)), near, outcome.tangential),
            normals=_spread(np.zeros((count, 3)), near, outcome.normal),
        )
        return after, error

    def _take(self, near: Index, kept: int) -> None:
        """Make the equations those of `near`; the compliance of the first `kept` is there."""
        nodes = self._lattice
        if len(near) > self._room:
            self._room = len(near) + 32
            room = np.zeros((3 * self._room, 3 * self._room), np.float32)
            room[: 3 * kept, : 3 * kept] = self._compliance[: 3 * kept, : 3 * kept]
            self._compliance, self._system = room, new_system(self._room)
        self._system.gathered[0] = -1
        self.near = near
        fill_block(
            self._table, len(nodes.angles), nodes.ring, nodes.azimuth, self._scale, near, kept,
            self._compliance,
        )  # fmt: skip
        each, blocks = np.arange(len(near)), self._compliance.reshape(self._room, 3, -1, 3)
        self._own = np.ascontiguousarray(blocks[each, :, each], np.float64)


def _spread(whole: Array, near: Index, values: Array) -> Array:
    """All nodes' values, with those of the nodes near the object put among them."""
    whole[near] = values
    return whole
