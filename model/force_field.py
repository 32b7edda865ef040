"""Contact forces on the nodes: one type for the truth and for every estimate."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import UserError
from .chain.assembly import chain, contact
from .chain.fingertip import CONTACT_THRESHOLD, Fingertip
from .chain.plant import History
from .chain.state import State
from .kernels.contact import contact_frames, frictions_at
from .kernels.slip_kernels import touch
from .objects import ContactObject

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class FrictionReading:
    """Estimate of the friction coefficient from one image.

    Attributes
    ----------
    value: µ
    deviation: standard deviation of µ
    observable: whether µ can be estimated from the image; from a pure press it cannot (E7)
    totals_covariance: covariance of µ with (ΣFn, ΣFf) [N], shape (2,)
    margin_deviation: standard deviation of Γ with this µ, if it was learned; NaN if it follows from
        those of µ and the sums
    logarithmic: whether the error is one of ln µ, with standard deviation `deviation` / µ; it then
        includes prior knowledge, also if µ is not observable
    """

    value: float
    deviation: float
    observable: bool
    totals_covariance: tuple[float, float] = (0.0, 0.0)
    margin_deviation: float = math.nan
    logarithmic: bool = False


@dataclass(frozen=True, kw_only=True)
class LoadPlane:
    """Plane through the sensor's axis in which an estimate found the load, and motion out of it.

    Attributes
    ----------
    azimuth: azimuth of the plane's +x, from the sensor's [rad]
    out_of_plane: share of the shear that is across the plane
    twist: turn of the skin at the apex about the sensor's axis [rad]
    """

    azimuth: float
    out_of_plane: float
    twist: float


@dataclass(frozen=True, kw_only=True)
class ForceField:
    """Normal and friction force of each node, along the object's normal and tangent there.

    Attributes
    ----------
    position: deformed node positions (x, z) of a chain, or (x, y, z) of a dome, in the sensor frame
        [m], shape (N, 2) or (N, 3)
    normal: normal force, positive in compression [N], shape (N,)
    friction: friction on the node [N]; for a chain signed along the object's tangent, +x on a flat
        one, shape (N,); for a dome a vector, shape (N, 3)
    contact: nodes in contact, shape (N,)
    totals_covariance: covariance of (ΣFn, ΣFf) of an estimate [N²], shape (2, 2); zero for truth
    friction_reading: estimate of µ from the image, if there is one
    plane: plane of the forces, if it was estimated; None: the sensor's x–z plane
    directions: directions of a dome's normal forces, away from the object, shape (N, 3); None for a
        chain
    wrench_covariance: covariance of (F_x, F_y, F_z) [N] and the torque M_z about the sensor's axis
        [N·m], see `wrench`, shape (4, 4); zero for truth, None if it is unknown
    """

    position: Array
    normal: Array
    friction: Array
    contact: NDArray[np.bool_]
    totals_covariance: Array
    friction_reading: FrictionReading | None = None
    plane: LoadPlane | None = None
    directions: Array | None = None
    wrench_covariance: Array | None = None

    @cached_property
    def total_normal(self) -> float:
        """ΣFn over the nodes in contact [N]."""
        return float(self.normal[self.contact].sum())

    @cached_property
    def net_friction(self) -> Array:
        """Σ Ff,i over the nodes in contact [N], shape (1,) along a chain or (3,) on a dome.

        On a round object a dome's friction is inclined, and a press alone leaves a sum along the
        mean normal. Nothing slips by it, so only the sum across that normal counts.
        """
        whole = np.atleast_1d(self.friction[self.contact].sum(axis=0))
        if self.directions is not None:
            axis = self.normal[self.contact] @ self.directions[self.contact]
            length = np.linalg.norm(axis)
            if length > 0.0:
                whole = whole - axis * (whole @ axis) / length**2
        return whole

    @cached_property
    def total_friction(self) -> float:
        """ΣFf = |ΣFf,i|, see `net_friction` [N]: a pure press has none."""
        return float(np.linalg.norm(self.net_friction))

    @property
    def friction_sizes(self) -> Array:
        """|Ff,i| of each node [N], shape (N,)."""
        return (
            abs(self.friction) if self.directions is None else np.linalg.norm(self.friction, axis=1)
        )

    @property
    def total_force(self) -> Array:
        """Force of the object on a dome [N], shape (3,).

        Raises
        ------
        UserError: for a chain, whose forces are along normals that it does not carry.
        """
        return self._vectors().sum(axis=0)

    def torque(self, axis: ArrayLike, through: ArrayLike = (0.0, 0.0, 0.0)) -> float:
        """Torque of the object on a dome about an axis through a point [N·m].

        Raises
        ------
        UserError: for a chain.
        """
        direction = np.asarray(axis, float) / np.linalg.norm(axis)
        arms = self.position - np.asarray(through, float)
        return float(np.cross(arms, self._vectors()).sum(axis=0) @ direction)

    @cached_property
    def wrench(self) -> Array:
        """Force of the object on a dome along x, y, z [N], and its torque about z [N·m], (4,).

        Raises
        ------
        UserError: for a chain.
        """
        return np.append(self.total_force, self.torque((0.0, 0.0, 1.0)))

    def _vectors(self) -> Array:
        if self.directions is None:
            raise UserError("a chain's forces have no third dimension; take those of a dome")
        return self.normal[:, None] * self.directions + self.friction

    def safety_margin(self, mu: float) -> float:
        """Γ = 1 − ΣFf/(µ ΣFn) (thesis Eq. 7); NaN with nothing in contact, and without a µ."""
        normal = self.total_normal
        if not (normal > 0.0 and mu > 0.0):
            return float("nan")
        return 1.0 - self.total_friction / (mu * normal)


def contact_forces(fingertip: Fingertip, obj: ContactObject, state: State) -> ForceField:
    """Contact forces of a state of the node model: the truth against which estimates are scored."""
    deformation = state.deformation
    ch = chain(fingertip)
    ground = ch.rest + deformation.nodes
    gap, _ = contact_frames(contact(fingertip, obj), ground, deformation.object_position)
    normal = obj.stiffness * ch.share * np.maximum(0.0, -gap)
    return ForceField(
        position=ground - np.array([0.0, deformation.rigid_part]),
        normal=normal,
        friction=state.friction,
        contact=normal > CONTACT_THRESHOLD * ch.share,
        totals_covariance=np.zeros((2, 2)),
    )


def touching(fingertip: Fingertip, obj: ContactObject, run: History) -> NDArray[np.bool_]:
    """Nodes in contact at each instant of a run, as `contact_forces` says, shape (R, N)."""
    ch, ct = chain(fingertip), contact(fingertip, obj)
    contact_nodes: NDArray[np.bool_] = touch(
        ch.rest, ch.share, ct, run.nodes, run.pose[:, 1], CONTACT_THRESHOLD
    )
    return contact_nodes


def node_friction(fingertip: Fingertip, obj: ContactObject, state: State) -> Array:
    """µ of the object's surface at each node of a state, shape (N,)."""
    deformation = state.deformation
    places = chain(fingertip).rest[:, 0] + deformation.nodes[:, 0] - deformation.object_position
    return frictions_at(contact(fingertip, obj), places)


def whole_friction(
    fingertip: Fingertip, obj: ContactObject, state: State, field: ForceField
) -> float:
    """µ of the contact as a whole, Σµᵢ·Fn,i/ΣFn: with it Γ = 1 − ΣFf/Σ(µᵢ·Fn,i).

    Where µ is one everywhere it is that; elsewhere it is NaN with nothing in contact.
    """
    if not obj.patches:
        return obj.friction
    normal = np.where(field.contact, field.normal, 0.0)
    if not normal.any():
        return float("nan")
    return float(node_friction(fingertip, obj, state) @ normal / normal.sum())
