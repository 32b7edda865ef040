"""State arrays of a body's skin near an object, with its active nodes, as steps use them."""

import math

import numpy as np
from numpy.typing import NDArray

from ..errors import PiercedError
from ..kernels.dome.near_kernels import find_near, node_groups
from ..kernels.dome.node_kernels import Contact, Outcome
from ..kernels.dome.posed_kernels import stiffening_by
from ..kernels.dome.touch_kernels import Pose, Stiffening
from .dome import Lattice, SoftBody, lattice
from .near_block import NearBlock
from .solid import Solid, touched
from .state import DomeState, check_state

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: Distance at which a node is taken into a step's unknowns, in pitches, …
MARGIN = 0.25
#: Part of the thickness beyond which the silicone is not described.
DEEPEST = 0.8


class Skin:
    """State arrays of a body's skin, which the owner's steps change."""

    def __init__(self, dome: SoftBody, solid: Solid, state: DomeState) -> None:
        self.dome, self.solid = dome, solid
        self.thing = touched(solid)
        self.lattice: Lattice = lattice(dome)
        self.radial = self.lattice.outwards
        self.groups = node_groups(self.lattice.points)
        self.block = NearBlock(dome)
        self.is_near = np.zeros(len(self.radial), np.bool_)
        self.flags = np.zeros(len(self.radial), np.bool_)
        self.restore(state)

    @property
    def near(self) -> Index:
        """Indices of the active nodes, shape (n,)."""
        return self.block.near

    def touch(self, solid: Solid) -> None:
        """Change the material of the object, whose shape stays."""
        self.solid, self.thing = solid, touched(solid)

    def restore(self, state: DomeState) -> None:
        """Set all arrays from a state.

        Raises
        ------
        UserError: for a state of another dome.
        """
        check_state(self.dome, state)
        self.time = state.time
        self.place, self.rotation = state.place.copy(), state.rotation.copy()
        self.velocity = state.velocity.copy()
        self.displacement = state.displacement.copy()
        self.linear, self.memory = state.linear.copy(), state.memory.copy()
        self.forces, self.friction = state.forces.copy(), state.friction.copy()
        self.normals = state.normals.copy()
        if not np.array_equal(self.near, state.near):
            self._take(state.near.copy(), 0)

    def state(self) -> DomeState:
        """Copy everything that the next step starts from."""
        return DomeState(
            time=self.time,
            place=self.place.copy(),
            rotation=self.rotation.copy(),
            velocity=self.velocity.copy(),
            displacement=self.displacement.copy(),
            linear=self.linear.copy(),
            memory=self.memory.copy(),
            forces=self.forces.copy(),
            friction=self.friction.copy(),
            normals=self.normals.copy(),
            near=self.near.copy(),
        )

    def contact(self, lag: float) -> Contact:
        """Active nodes at the start of a step, as the kernels take them.

        Parameters
        ----------
        lag: time constant of the viscosity over the step length
        """
        near = self.near
        offset = np.zeros((len(near), 3))
        if lag:
            size, share = 3 * len(near), 1.0 / (1.0 + lag)
            offset.ravel()[:] = self.block.compliance[:size, :size] @ (
                lag * share * self.memory[near].ravel()
            )
        return Contact(
            self.lattice.points[near],
            self.radial[near],
            self.lattice.areas[near],
            self.lattice.points[near] + self.displacement[near],
            offset,
            self.friction[near],
            self.block.compliance,
            self.block.own,
        )

    def stiffening(self) -> Stiffening:
        """Law of stiffening in the next step, from the present contact."""
        near = self.near
        share, power = stiffening_by(
            law_of(self.dome), self.solid.friction, self.lattice.areas[near], self.forces[near],
            self.friction[near],
        )  # fmt: skip
        return Stiffening(share, power, self.dome.thickness)

    def take_over(self, near: Index, outcome: Outcome, lag: float) -> None:
        """Set the state of the active nodes from the outcome of a step."""
        self.linear[near] = outcome.linear
        self.forces[near], self.friction[near] = outcome.true, outcome.tangential
        on = np.asarray(outcome.true.any(axis=1))
        self.normals[near] = np.where(on[:, None], outcome.normal, 0.0)
        self.displacement[near] = outcome.displacement
        forgotten = 1e-9  # forces that viscosity remembers below this are forgotten [N]
        if lag:
            share = 1.0 / (1.0 + lag)
            self.memory[near] = share * (outcome.linear + lag * self.memory[near])
            self.memory[abs(self.memory) < forgotten] = 0.0

    def find(self, rotation: Array, place: Array) -> None:
        """Choose the active nodes again if the object comes near an inactive one."""
        margin = MARGIN * self.dome.spacing
        pose = Pose(rotation, place, rotation, place)
        count = self._flag(pose, margin)
        near = self.near
        if count and not (self.flags & ~self.is_near).any() and len(near) <= 1.5 * count + 20:
            return
        if not count and not len(near):
            return
        wider = 2.2  # those that come with it are this much further
        self._flag(pose, wider * margin)
        stay = near[self.flags[near]]
        new = np.flatnonzero(self.flags & ~self.is_near)
        kept = len(stay) if len(stay) == len(near) else 0
        self._take(np.concatenate([stay, new]), kept)
        if len(new):
            source = self.memory if self.memory.any() else self.linear
            loaded = np.flatnonzero(source.any(axis=1))
            self.block.displace(loaded, source, new, self.displacement)

    def missed(self, rotation: Array, place: Array) -> bool:
        """Whether the object reached inactive nodes; if so, activate them."""
        self._flag(Pose(rotation, place, rotation, place), 0.0)
        if not (self.flags & ~self.is_near).any():
            return False
        self.find(rotation, place)
        return True

    def check_depth(self) -> None:
        """Refuse a press that is deeper than the model describes.

        Raises
        ------
        PiercedError
        """
        near = self.near
        if not len(near):
            return
        depth = -np.einsum("ij,ij->i", self.displacement[near], self.radial[near])
        deepest = depth.max() / self.dome.thickness
        if deepest > DEEPEST:
            raise PiercedError(
                f"at {self.time:.6g} s the object is pressed to {deepest:.0%} of the silicone of "
                f"{1e3 * self.dome.thickness:.3g} mm; it is described to {DEEPEST:.0%}"
            )

    def _flag(self, pose: Pose, margin: float) -> int:
        """Set `flags` of the nodes within a margin [m] of the object; return their number."""
        return find_near(
            self.thing, pose, margin, self.lattice.points, self.displacement, self.linear,
            self.memory, self.near, self.groups, self.flags,
        )  # fmt: skip

    def _take(self, near: Index, kept: int) -> None:
        """Activate `near`; compliances among the first `kept` are already computed."""
        self.block.take(near, kept)
        self.is_near[:] = False
        self.is_near[near] = True


def law_of(dome: SoftBody) -> Array:
    """Constants of the law of stiffening, as `stiffening_by` takes them, shape (9,).

    They are the thickness [m], 0 without stiffening; then, without friction, the widest contact in
    thicknesses, a factor, its power, and p; then, for a sticking contact, the widest contact, its
    factor c, its power, and p.
    """
    if not dome.stiffening:
        return np.zeros(9)
    # A wide contact squeezes the silicone, which gives way by its bulk: more so, the less it is
    # compressible.
    bulk = 2.0 * (1.0 + dome.poisson) / (3.0 * (1.0 - 2.0 * dome.poisson))  # over the shear modulus
    slipping = [0.402 * math.sqrt(bulk), 3.103 * dome.slenderness**-0.184, 0.511, 1.536]
    return np.array([dome.thickness, *slipping, 0.807, 2.556, 2.347, 1.425])
