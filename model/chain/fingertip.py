"""Fingertip Model and Sensor Model of the thesis: nodes on tissue and membrane springs."""

from dataclasses import dataclass
from typing import Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ..checks import finite, within

Array = NDArray[np.float64]
#: Name of a law of spring forces, see `Fingertip.law` (thesis Eqs. 3, 17 and 14).
SpringLaw = Literal["split", "inverse-poisson", "axial"]

#: Number of nodes for which the thesis gives its per-node constants.
REFERENCE_NODES = 251
#: Normal force above which one of 251 nodes is in contact [N] (thesis section 5.2).
CONTACT_THRESHOLD = 0.005


@dataclass(frozen=True, kw_only=True)
class Fingertip:
    """Parameters of the soft fingertip. Per-node values hold at 251 nodes; others are scaled.

    Attributes
    ----------
    nodes: number of nodes; odd if evenly spaced, so that one sits at the apex
    radius: radius of the half circle [m]
    tissue_stiffness: stiffness of the spring from the rigid part to a node, 25 kPa·π·r/2 (thesis
        Table 1) [N/m]
    membrane_stiffness: stiffness of the spring between neighbours (thesis Table 1) [N/m]
    poisson_tissue, poisson_membrane: Poisson factors ν of the two springs; unused by `axial`
    damping_node, damping_rigid: dampers from a node and the rigid part to ground (thesis Table 1)
        [N·s/m]
    law: law of spring forces: `split` is the Fingertip Model (thesis Eq. 3 with E6),
        `inverse-poisson` its variant (Eq. 17), `axial` the Sensor Model (Eq. 14)
    stations: places of the nodes as shares of the arc length, from 0 to 1; None: evenly spaced
    """

    nodes: int = REFERENCE_NODES
    radius: float = 8e-3
    tissue_stiffness: float = 25e3 * np.pi * 8e-3 / 2
    membrane_stiffness: float = 1544.0
    poisson_tissue: float = 0.4
    poisson_membrane: float = 0.004
    damping_node: float = 0.1
    damping_rigid: float = 0.1
    law: SpringLaw = "split"
    stations: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if self.stations is None and (self.nodes < 11 or self.nodes % 2 == 0):
            raise UserError(f"fingertip nodes must be odd and at least 11, got {self.nodes!r}")
        finite("fingertip radius", self.radius, "m", above=0.0)
        finite("tissue stiffness", self.tissue_stiffness, "N/m", above=0.0)
        finite("membrane stiffness", self.membrane_stiffness, "N/m", above=0.0)
        finite("node damping", self.damping_node, "N·s/m", above=0.0)
        finite("rigid-part damping", self.damping_rigid, "N·s/m", above=0.0)
        within("tissue Poisson factor", self.poisson_tissue, "", 0.0, 0.5)
        within("membrane Poisson factor", self.poisson_membrane, "", 0.0, 0.5)
        if self.law not in get_args(SpringLaw):
            allowed = ", ".join(get_args(SpringLaw))
            raise UserError(f"fingertip law must be one of {allowed}, got {self.law!r}")
        if self.stations is not None:
            _check_stations(self.stations, self.nodes)

    @classmethod
    def of_radius(cls, radius: float, *, nodes: int, law: SpringLaw) -> Self:
        """Make a half circle of another radius from the thesis's materials (thesis Table 1).

        At a larger radius the tissue, 25 kPa·π·r/2, is stiffer, and the membrane, E·w·t over pitch,
        softer.
        """
        share = radius / cls.radius
        return cls(
            nodes=nodes,
            radius=radius,
            tissue_stiffness=cls.tissue_stiffness * share,
            membrane_stiffness=cls.membrane_stiffness / share,
            law=law,
        )

    @classmethod
    def graded(
        cls, nodes: int = 99, core: float = 7.4e-3, *, radius: float = 8e-3, **parameters: float
    ) -> Self:
        """Make a half circle with the spacing of 251 nodes near the apex, coarser towards the rim.

        Parameters
        ----------
        nodes: number of nodes, odd
        core: arc length around the apex with the fine spacing [m]
        radius: radius of the half circle [m]
        parameters: other attributes of a Fingertip

        Raises
        ------
        ValueError
            When the core alone needs more nodes than given.
        """
        stations = _graded_stations(nodes, core, np.pi * radius)
        return cls(nodes=nodes, radius=radius, stations=stations, **parameters)  # type: ignore[arg-type]

    @property
    def pitch(self) -> float:
        """Arc length between the nodes next to the apex [m]."""
        s = self.arc_lengths()
        middle = int(np.searchsorted(s, s[-1] / 2))
        return float(s[middle] - s[middle - 1])

    def arc_lengths(self) -> Array:
        """Place of each node along the dome, from the left rim [m], shape (N,)."""
        length = np.pi * self.radius
        if self.stations is None:
            return np.linspace(0.0, length, self.nodes)
        return length * np.array(self.stations)

    def shares(self) -> Array:
        """Arc length represented by each node, over that at 251 even nodes, shape (N,)."""
        s = self.arc_lengths()
        return np.gradient(s, edge_order=1) * (REFERENCE_NODES - 1) / s[-1]

    @property
    def contact_threshold(self) -> Array:
        """Normal force above which a node counts as in contact [N], shape (N,)."""
        return CONTACT_THRESHOLD * self.shares()

    def angles(self) -> Array:
        """Signed angle of each node from the apex, arc length over radius [rad], shape (N,)."""
        s = self.arc_lengths()
        return (s / s[-1] - 0.5) * np.pi

    def rest_positions(self) -> Array:
        """Node positions (x, z) without load [m], shape (N, 2)."""
        angle = self.angles()
        rest = self.radius * np.column_stack([np.sin(angle), np.cos(angle)])
        rest[abs(rest) < 1e-12 * self.radius] = 0.0
        return rest

    def poisson_signs(self) -> Array:
        """Sign of the Poisson cross term (E6): −1 left, 0 centre, +1 right, shape (N,)."""
        x = self.rest_positions()[:, 0]
        return np.where(abs(x) < 1e-9 * abs(x).max(), 0.0, np.sign(x))


def _check_stations(stations: tuple[float, ...], nodes: int) -> None:
    if len(stations) != nodes or nodes < 11:
        raise UserError(
            f"fingertip stations must be as many as nodes and at least 11, "
            f"got {len(stations)} stations and {nodes} nodes"
        )
    if not (stations[0] == 0.0 and stations[-1] == 1.0 and (np.diff(stations) > 0.0).all()):
        raise UserError("fingertip stations must increase from 0 to 1")


def _graded_stations(nodes: int, core: float, length: float) -> tuple[float, ...]:
    """Stations of `Fingertip.graded`, as shares of the arc length [m]."""
    fine = length / (REFERENCE_NODES - 1)
    inner = round(core / 2 / fine)
    outer = (nodes - 1) // 2 - inner
    wanted = (REFERENCE_NODES - 1) // 2 - inner
    if nodes % 2 == 0 or outer < 4 or wanted < outer:
        raise UserError(
            f"graded fingertip nodes must be odd and in {2 * inner + 9}…{REFERENCE_NODES} for a "
            f"core of {core:g} m, got {nodes!r}"
        )
    # Spacings grow geometrically, fine·q, fine·q², …, and end exactly at the rim.
    low, high = 1.0, 4.0
    for _ in range(100):
        q = (low + high) / 2
        low, high = (q, high) if (q ** np.arange(1, outer + 1)).sum() < wanted else (low, q)
    half = np.concatenate([np.arange(inner + 1.0), inner + np.cumsum(q ** np.arange(1, outer + 1))])
    half *= 0.5 / half[-1]
    half[-1] = 0.5
    return (*(0.5 - half[:0:-1]).tolist(), *(0.5 + half).tolist())
