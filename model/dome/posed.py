"""Contacts of one dome at prescribed poses, as immutable values.

A `Stepper` changes its arrays. Here a step makes a new contact from an old one, so that many steps
from the same instant can be compared. `changed` gives the effect of other poses and other objects
on a step to first order, by one linear system for all of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import sgesv
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from ..errors import ConvergenceError
from ..kernels.dome.posed_kernels import linear_system, posed_forces, solve_posed
from ..shapes import distances
from .dome import Dome, lattice
from .near_block import NearBlock
from .skin import law_of
from .solid import Solid, touched
from .stepper import STEP

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class PosedContact:
    """Contact of a dome and an object at a pose, with everything that the next step needs.

    Several contacts on the same nodes form one value, with a leading axis in every array.

    Attributes
    ----------
    nodes: indices of the n active nodes, shape (n,)
    rotation, place: rotation matrix and position of the object, as in `DomeState`
    displacement: displacements of the nodes [m], shape (n, 3)
    linear: forces that the linear skin carries [N], shape (n, 3)
    forces: forces of the object on the nodes [N], shape (n, 3)
    friction: part of `forces` in the object's tangent planes [N], shape (n, 3)
    normals: unit normals of the object at the nodes that touch it, zero elsewhere, shape (n, 3)
    """

    nodes: Index
    rotation: Array
    place: Array
    displacement: Array
    linear: Array
    forces: Array
    friction: Array
    normals: Array

    @property
    def normal(self) -> Array:
        """Normal force of each node [N], shape (n,)."""
        return np.asarray(np.einsum("...ij,...ij->...i", self.forces, self.normals))

    def at(self, k: int | slice) -> "PosedContact":
        """Select contact k of several."""
        return self._made(lambda name: getattr(self, name)[k])

    def everywhere(self, count: int) -> "PosedContact":
        """Expand to all `count` nodes, with zeros on inactive ones."""

        def spread(name: str) -> Array:
            values: Array = getattr(self, name)
            if name in ("rotation", "place"):
                return values
            out = np.zeros((*values.shape[:-2], count, 3))
            out[..., self.nodes, :] = values
            return out

        return replace(self._made(spread), nodes=np.arange(count))

    def _made(self, of: Any) -> "PosedContact":
        """Copy with every array except `nodes` made by `of`, from its name."""
        values = {each.name: of(each.name) for each in fields(self) if each.name != "nodes"}
        return replace(self, **values)


def together(contacts: Sequence[PosedContact]) -> PosedContact:
    """Stack contacts on the same nodes into one value."""
    return contacts[0]._made(lambda name: np.stack([getattr(each, name) for each in contacts]))


class PosedContacts:
    """Solver for steps of contacts on one dome.

    Parameters
    ----------
    dome: elastic dome, without viscosity
    """

    #: Relative change of the forces at which a step is solved.
    tolerance = 1e-4

    def __init__(self, dome: Dome) -> None:
        self.dome = dome
        self._lattice = nodes = lattice(dome)
        near = 1.6 * dome.spacing  # nodes so near to nodes that touch an object are looked at
        beside: Any = KDTree(nodes.points).query_ball_point(nodes.points, near)
        most = max(len(each) for each in beside)
        self._beside = np.array(
            [[*each, *[k] * (most - len(each))] for k, each in enumerate(beside)]
        )
        self._law = law_of(dome)
        self._block = NearBlock(dome)

    @property
    def near(self) -> Index:
        """Indices of the active nodes, shape (n,)."""
        return self._block.near

    def untouched(self, rotation: Array, place: Array) -> PosedContact:
        """Make a contact of a dome at rest with an object that does not touch it."""
        none = np.zeros((0, 3))
        return PosedContact(
            nodes=np.zeros(0, np.int64), rotation=rotation, place=place, displacement=none,
            linear=none, forces=none, friction=none, normals=none,
        )  # fmt: skip

    def look(self, last: PosedContact, solid: Solid, rotation: Array, place: Array) -> PosedContact:
        """Activate the nodes that an object may touch in the next step.

        Returns
        -------
        Last contact on the active nodes, with the displacement of all of them.
        """
        places = self._lattice.points - place
        places[last.nodes] += last.displacement
        gap, _ = distances(solid.shape, places @ rotation)
        wanted = gap < 0.3 * self.dome.spacing
        held = last.nodes[last.linear.any(axis=1)]
        wanted[self._beside[held]] = True
        near = self.near
        inside = wanted[near]
        # Nodes that are looked at without need: so many times the needed ones, and so many more.
        wide, more = 1.5, 40
        if inside.sum() < wanted.sum() or len(near) > wide * wanted.sum() + more:
            stay = near[inside]
            kept = len(stay) if len(stay) == len(near) else 0
            wanted[stay] = False
            self._block.take(np.concatenate([stay, np.flatnonzero(wanted)]), kept)
        if last.nodes is self.near:
            return last
        new = np.flatnonzero(~np.isin(self.near, last.nodes))
        out = self.onto(last)
        if len(held) and len(new):
            every = np.zeros((2, *places.shape))
            every[0, last.nodes] = last.linear
            self._block.displace(held, every[0], self.near[new], every[1])
            out.displacement[new] = every[1, self.near[new]]
        return out

    def onto(self, last: PosedContact) -> PosedContact:
        """Transfer a contact, or several, to the active nodes; zero on new ones."""
        if last.nodes is self.near:
            return last
        place = np.full(len(self._lattice.points), len(last.nodes))
        place[last.nodes] = np.arange(len(last.nodes))
        source = place[self.near]

        def moved(name: str) -> Array:
            values: Array = getattr(last, name)
            if name in ("rotation", "place"):
                return values
            return np.concatenate([values, np.zeros_like(values[..., :1, :])], axis=-2)[
                ..., source, :
            ]

        if not len(last.nodes):
            zeros = np.zeros((*last.linear.shape[:-2], len(source), 3))
            return replace(
                last, nodes=self.near, displacement=zeros.copy(), linear=zeros, forces=zeros,
                friction=zeros, normals=zeros,
            )  # fmt: skip
        return replace(last._made(moved), nodes=self.near)

    def known(self, contact: PosedContact) -> PosedContact | None:
        """Transfer a contact to the active nodes; None unless it includes all of them."""
        if contact.nodes is not self.near and not np.isin(self.near, contact.nodes).all():
            return None
        return self.onto(contact)

    def step(
        self,
        last: PosedContact,
        solid: Solid,
        rotation: Array,
        place: Array,
        alike: PosedContact | None = None,
    ) -> PosedContact:
        """Solve for the contact after the object has moved to a pose.

        Parameters
        ----------
        last: contact before the step, on the active nodes
        alike: similar contact on any nodes, as a guess that shortens the iteration

        Raises
        ------
        ConvergenceError
            When the contact has no solution near the one before.
        """
        if alike is not None:
            guess = self.onto(alike).linear
            after, error = self._solve(last, solid, rotation, place, guess, warm=True)
            if error < self.tolerance:
                return after
        return self._halved(last, solid, rotation, place, left=3)

    def changed(
        self,
        last: PosedContact,
        after: PosedContact,
        solids: Sequence[Solid],
        rotation: Array,
        place: Array,
        times: float,
    ) -> PosedContact:
        """Contacts after a step for changed objects, poses and histories, to first order.

        Parameters
        ----------
        last: 1 + C contacts before a step, on the active nodes: a first one, and C with small
            changes
        after: first contact after the step
        solids: 1 + C objects of one kind of shape
        rotation, place: pose of each object after the step, shapes (1 + C, 3, 3) and (1 + C, 3)
        times: factor by which the returned changes are larger than the given ones

        Returns
        -------
        C contacts.
        """
        count = len(solids)
        moved = np.repeat(after.displacement[None], count, axis=0)
        forces, slopes = self._forces(last, solids, rotation, place, moved, tangent=True)
        change = times * (forces[0, 1:] - forces[0, 0])
        active = np.flatnonzero(after.linear.any(axis=-1))
        linear = np.zeros_like(change)
        if len(active):
            block = self._block.compliance
            matrix = np.empty((3 * len(active),) * 2, np.float32)
            linear_system(block, self._block.own, active, slopes, change, matrix)
            right = change[:, active].reshape(count - 1, -1).T.astype(np.float32, order="F")
            _, _, solved, _ = sgesv(matrix, right, overwrite_b=1)
            linear[:, active] = solved.T.reshape(count - 1, -1, 3)
            columns = (3 * active[:, None] + np.arange(3)).ravel()
            size = moved[0].size
            moved[1:] += (solved.T @ block[columns, :size] / times).reshape(count - 1, -1, 3)
        ends, _ = self._forces(last, solids, rotation, place, moved, tangent=False)
        on = times * (ends[1:, 1:] - ends[1:, :1])
        return PosedContact(
            nodes=after.nodes,
            rotation=after.rotation + times * (rotation[1:] - rotation[0]),
            place=after.place + times * (place[1:] - place[0]),
            displacement=after.displacement + times * (moved[1:] - moved[0]),
            linear=after.linear + linear,
            forces=after.forces + on[0],
            friction=after.friction + on[1],
            normals=after.normals + on[2],
        )

    def _forces(
        self,
        last: PosedContact,
        solids: Sequence[Solid],
        rotation: Array,
        place: Array,
        moved: Array,
        *,
        tangent: bool,
    ) -> tuple[Array, Array]:
        """Results of `posed_forces` for C contacts, (4, C, n, 3), and its slopes, (n, 3, 3)."""
        near, nodes = self.near, self._lattice
        results = np.empty((4, *moved.shape))
        slopes = np.empty((len(near) if tangent else 0, 3, 3))
        numbers = np.stack([each.shape.numbers for each in solids])
        numbers.setflags(write=False)  # as a shape's own are: of another type is another kernel
        materials = [
            (each.stiffness, each.friction, each.dahl_stiffness, each.dahl_exponent)
            for each in solids
        ]
        posed_forces(
            nodes.points[near], nodes.outwards[near], nodes.areas[near], self._law,
            touched(solids[0]), numbers, np.array(materials, float),
            np.stack([last.rotation, rotation], axis=1), np.stack([last.place, place], axis=1),
            last.displacement, last.forces, last.friction, moved, results, slopes,
        )  # fmt: skip
        return results, slopes

    def _halved(
        self, last: PosedContact, solid: Solid, rotation: Array, place: Array, left: int
    ) -> PosedContact:
        """Solve for a step, in halves as long as it does not converge, `left` times at most."""
        after, error = self._solve(last, solid, rotation, place, last.linear)
        if error < self.tolerance or (not left and error < STEP.enough):
            return after
        if not left:
            raise ConvergenceError("the contact does not converge")
        turn = Rotation.from_matrix(rotation @ last.rotation.T).as_rotvec()
        half = Rotation.from_rotvec(0.5 * turn).as_matrix() @ last.rotation
        middle = self._halved(last, solid, half, 0.5 * (last.place + place), left - 1)
        return self._halved(middle, solid, rotation, place, left - 1)

    def _solve(
        self,
        last: PosedContact,
        solid: Solid,
        rotation: Array,
        place: Array,
        guess: Array,
        warm: bool = False,
    ) -> tuple[PosedContact, float]:
        """Solve for one step from a guess of `linear`; return contact and relative error."""
        near, nodes, block = self.near, self._lattice, self._block
        results = np.zeros((5, *last.linear.shape))
        results[1] = guess
        error = solve_posed(
            nodes.points[near], nodes.outwards[near], nodes.areas[near], block.compliance,
            block.own, self._law, touched(solid), np.stack([last.rotation, rotation]),
            np.stack([last.place, place]), last.displacement, last.forces, last.friction,
            self.tolerance, STEP.rounds, warm, block.system, results,
        )  # fmt: skip
        results[4][~results[2].any(axis=-1)] = 0.0
        after = PosedContact(
            nodes=near,
            rotation=rotation,
            place=place,
            displacement=results[0],
            linear=results[1],
            forces=results[2],
            friction=results[3],
            normals=results[4],
        )
        return after, error
