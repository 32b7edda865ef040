"""Conversion of nodal forces in the sensor's axes to normal force and friction on an object.

The object is not known. Where it presses, the skin lies on it, indented by fn/k: a circle and a
stiffness k are fitted to the loaded skin, and forces are resolved along that circle's normal. With
the skin's own slope instead, even exact forces on random objects give an RMS error of µ of 0.24.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ....model import Fingertip, ForceField
from .settings import ObjectSettings

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ForcePrior:
    """Assumptions about contact forces before any image, the same for every object.

    Attributes
    ----------
    reach_deg: angle from the apex up to which forces are possible [°]
    knots: number of nodes of the piecewise linear force along that arc
    length: correlation length of the forces along the skin [m]
    amplitude: smallest prior standard deviation of a node's force at 251 nodes [N]
    """

    reach_deg: float = 38.0
    knots: int = 31
    length: float = 0.8e-3
    amplitude: float = 5e-3

    def knot_angles(self) -> Array:
        """Angles of the knots from the apex [rad], shape (knots,)."""
        reach = np.deg2rad(self.reach_deg)
        return np.linspace(-reach, reach, self.knots)


def force_basis(fingertip: Fingertip, prior: ForcePrior) -> tuple[Array, Array]:
    """Nodal forces per unit unknown (N, 2, 2·knots) and the unknowns' prior correlation.

    Unknowns are node forces at 251 nodes, all along x, then all along z; finer chains share them
    among more nodes.
    """
    knots = prior.knot_angles()
    angles = fingertip.angles()
    hats = np.stack([np.interp(angles, knots, row) for row in np.eye(prior.knots)], axis=1)
    hats[np.abs(angles) > knots[-1]] = 0.0
    hats *= fingertip.shares()[:, None]
    basis = np.zeros((fingertip.nodes, 2, 2 * prior.knots))
    basis[:, 0, : prior.knots] = hats
    basis[:, 1, prior.knots :] = hats
    correlation = smoothness(knots * fingertip.radius, prior.length)
    return basis, np.kron(np.eye(2), correlation).astype(np.float64)


def smoothness(places: Array, length: float) -> Array:
    """Correlation matrix of a smooth function at n places along the skin [m], shape (n, n)."""
    distance = (places[:, None] - places) / length
    correlation: Array = np.exp(-0.5 * distance**2) + 1e-6 * np.eye(len(places))
    return correlation


def read_contact(
    fingertip: Fingertip,
    displacement: Array,
    forces: Array,
    force_factor: Array,
    displacement_factor: Array,
    settings: ObjectSettings,
) -> ForceField:
    """Make the force field of an estimate, including the uncertainty of the object's slope.

    Parameters
    ----------
    fingertip: chain
    displacement: displacements of the nodes relative to the rigid part [m], shape (N, 2)
    forces: contact forces on the nodes in sensor axes [N], shape (N, 2)
    force_factor, displacement_factor: factors S of their joint covariance S·Sᵀ, both (N, 2, R)
    settings: tuned parameters
    """
    slope, slope_factor = object_slope(
        fingertip, displacement, forces, force_factor, displacement_factor, settings
    )
    rest, _, threshold = _chain_at_rest(fingertip)
    cos = 1.0 / np.hypot(1.0, slope)
    sin = slope * cos
    normal = sin * forces[:, 0] - cos * forces[:, 1]
    friction = cos * forces[:, 0] + sin * forces[:, 1]
    contact = normal > threshold
    nodes, shared = len(normal), force_factor.shape[2]
    spread = np.zeros((2, nodes, slope_factor.shape[1] + 1))
    s, c = sin[:, None], cos[:, None]
    turn = slope_factor * c**2  # rotation angle due to an error of the slope
    spread[0, :, :-1] = friction[:, None] * turn
    spread[1, :, :-1] = -normal[:, None] * turn
    spread[0, :, :shared] += s * force_factor[:, 0] - c * force_factor[:, 1]
    spread[1, :, :shared] += c * force_factor[:, 0] + s * force_factor[:, 1]
    spread[0, :, -1], spread[1, :, -1] = settings.common * normal, settings.common * friction
    totals = contact.astype(float) @ spread
    return ForceField(
        position=rest + displacement,
        normal=np.maximum(normal, 0.0),
        friction=friction,
        contact=contact,
        totals_covariance=totals @ totals.T,
        spread=spread.reshape(2 * nodes, -1),
    )


def object_slope(
    fingertip: Fingertip,
    displacement: Array,
    forces: Array,
    force_factor: Array,
    displacement_factor: Array,
    settings: ObjectSettings,
) -> tuple[Array, Array]:
    """Slope of the object at every node (N,), and a factor (N, R + 4) of its covariance.

    z = a + b·x + c·(x² + z²)/2 + fn/k about the middle of the loaded skin is an indented circle.
    Parameters are those of `read_contact`.
    """
    rest, share, threshold = _chain_at_rest(fingertip)
    position, normal = rest + displacement, -forces[:, 1]
    mean, deviation = np.array(settings.mean), np.array(settings.deviation)
    unknowns = len(mean)
    slope = np.zeros(len(normal))
    for _ in range(settings.passes):
        pressed = np.flatnonzero(normal > threshold)
        if len(pressed) < unknowns:
            none = np.zeros((len(normal), displacement_factor.shape[2] + unknowns))
            return np.zeros_like(slope), none
        load = normal[pressed] / share[pressed]
        x, z = (position - load @ position[pressed] / load.sum()).T
        at_x, at_z = x[pressed], z[pressed]
        design = np.stack([np.ones_like(at_x), at_x, (at_x**2 + at_z**2) / 2, load], axis=1)
        weighted = design * (load / (load.max() * settings.roughness**2))[:, None]
        covariance = np.linalg.inv(design.T @ weighted + np.diag(deviation**-2))
        gain = covariance @ weighted.T
        _, b, c, softness = mean + gain @ (at_z - design @ mean)
        upright = np.maximum(1.0 - c * z, 0.3)  # beyond the circle's side there is no contact
        slope = (b + c * x) / upright
        normal = (slope * forces[:, 0] - forces[:, 1]) / np.hypot(1.0, slope)
    propagated = gain[1:3] @ displacement_factor[pressed, 1]
    propagated -= (gain[1:3] * (softness / share[pressed])) @ force_factor[pressed, 1]
    tilt, bend = np.concatenate([propagated, np.linalg.cholesky(covariance)[1:3]], axis=1)
    return slope, (tilt + (x / upright)[:, None] * bend) / upright[:, None]


@lru_cache(maxsize=64)
def _chain_at_rest(fingertip: Fingertip) -> tuple[Array, Array, Array]:
    """Positions (N, 2) [m], share in the nodes of 251 (N,) and threshold of contact (N,) [N]."""
    return fingertip.rest_positions(), fingertip.shares(), fingertip.contact_threshold
