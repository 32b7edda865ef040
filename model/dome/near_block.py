"""Compliance of the active nodes, with preallocated work arrays."""

import numpy as np
from numpy.typing import NDArray

from ..kernels.dome.compliance_kernels import displace, fill_block
from ..kernels.dome.krylov_kernels import System, new_system
from .compliance import skin_compliance
from .dome import SoftBody

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class NearBlock:
    """Compliance matrix of the n active nodes of a body, which change as the object moves.

    Parameters
    ----------
    dome: body

    Attributes
    ----------
    near: indices of the active nodes, shape (n,)
    compliance: compliance among them [m/N], shape (3n, 3n) or larger
    own: compliance of each node for its own force [m/N], shape (n, 3, 3)
    system: work arrays of their equations
    """

    def __init__(self, dome: SoftBody) -> None:
        self._skin = skin_compliance(dome)
        self._room = 0
        self.near: Index = np.zeros(0, np.int64)
        self.compliance = np.zeros((0, 0), np.float32)
        self.own: Array = np.zeros((0, 3, 3))
        self.system: System = new_system(0)

    def take(self, near: Index, kept: int) -> None:
        """Make `near` the active nodes; compliances among the first `kept` are already computed."""
        spare = 32  # nodes that room is made for beyond those that are asked for
        if len(near) > self._room:
            self._room = len(near) + spare
            room = np.zeros((3 * self._room, 3 * self._room), np.float32)
            room[: 3 * kept, : 3 * kept] = self.compliance[: 3 * kept, : 3 * kept]
            self.compliance, self.system = room, new_system(self._room)
        self.system.gathered[0] = -1  # whatever it held
        self.near = near
        fill_block(self._skin, near, kept, self.compliance)
        each, blocks = np.arange(len(near)), self.compliance.reshape(self._room, 3, -1, 3)
        self.own = np.ascontiguousarray(blocks[each, :, each], np.float64)

    def displace(self, loaded: Index, forces: Array, nodes: Index, out: Array) -> None:
        """Displacements of nodes [m] by forces (N, 3) [N] on the loaded ones, into `out` (N, 3)."""
        displace(self._skin, loaded, forces, nodes, out)
