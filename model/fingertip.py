"""Fingertip Model of the thesis: a half circle of nodes on tissue and membrane springs."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .checks import finite, within

#: Node count at which the thesis prints its per-node constants.
REFERENCE_NODES = 251
#: A node is in contact above this normal force [N] at 251 nodes (thesis section 5.2).
CONTACT_THRESHOLD = 0.005


@dataclass(frozen=True, kw_only=True)
class Fingertip:
    """Parameters of the soft fingertip; per-node values hold at 251 nodes, scaled to `nodes`.

    Attributes
    ----------
    nodes: number of nodes, odd, so that one sits at the apex
    radius: radius of the half circle [m]
    tissue_stiffness: spring from the rigid part to a node, 25 kPa·π·r/2 (thesis Table 1) [N/m]
    membrane_stiffness: spring between neighbours (thesis Table 1) [N/m]
    poisson_tissue, poisson_membrane: Poisson factors ν of the two springs
    damping_node, damping_rigid: dampers to ground (thesis Table 1) [N·s/m]
    """

    nodes: int = REFERENCE_NODES
    radius: float = 8e-3
    tissue_stiffness: float = 25e3 * np.pi * 8e-3 / 2
    membrane_stiffness: float = 1544.0
    poisson_tissue: float = 0.4
    poisson_membrane: float = 0.004
    damping_node: float = 0.1
    damping_rigid: float = 0.1

    def __post_init__(self) -> None:
        if self.nodes < 11 or self.nodes % 2 == 0:
            raise ValueError(f"fingertip nodes must be odd and at least 11, got {self.nodes!r}")
        finite("fingertip radius", self.radius, "m", above=0.0)
        finite("tissue stiffness", self.tissue_stiffness, "N/m", above=0.0)
        finite("membrane stiffness", self.membrane_stiffness, "N/m", above=0.0)
        finite("node damping", self.damping_node, "N·s/m", above=0.0)
        finite("rigid-part damping", self.damping_rigid, "N·s/m", above=0.0)
        within("tissue Poisson factor", self.poisson_tissue, "", 0.0, 0.5)
        within("membrane Poisson factor", self.poisson_membrane, "", 0.0, 0.5)

    @property
    def spacing_ratio(self) -> float:
        """Node spacing over that of 251 nodes; per-node stiffness and damping scale with it."""
        return (REFERENCE_NODES - 1) / (self.nodes - 1)

    @property
    def pitch(self) -> float:
        """Arc length between nodes [m]."""
        return np.pi * self.radius / (self.nodes - 1)

    @property
    def contact_threshold(self) -> float:
        """Normal force above which a node counts as in contact [N]."""
        return CONTACT_THRESHOLD * REFERENCE_NODES / self.nodes

    def angles(self) -> NDArray[np.float64]:
        """Signed angle of each node from the apex [rad], shape (N,)."""
        return np.linspace(-np.pi / 2, np.pi / 2, self.nodes)

    def rest_positions(self) -> NDArray[np.float64]:
        """Node positions (x, z) without load [m], shape (N, 2)."""
        angle = self.angles()
        return self.radius * np.column_stack([np.sin(angle), np.cos(angle)])

    def poisson_signs(self) -> NDArray[np.float64]:
        """Hard-coded sign of the Poisson cross term: −1 left, 0 centre, +1 right (E6), (N,)."""
        return np.sign(np.arange(self.nodes) - (self.nodes - 1) / 2)
