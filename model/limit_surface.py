"""Friction and torsion together against what a contact can bear: the limit surface."""

import numpy as np
from numpy.typing import NDArray

from .force_field import ForceField
from .kernels.slip_kernels import least_work

Array = NDArray[np.float64]


def margin_within(field: ForceField, mu: float) -> float:
    """Margin 1 − 1/λ, λ the factor by which friction and torsion may grow; NaN with no contact.

    By the maximum-work inequality a friction wrench can be borne if no motion (v, ω) of the object
    in the contact's plane takes more work from it than µ·ΣFn,i·|v_i| (Goyal 1991). λ is the least
    ratio of the two over all motions. Each node's motion is taken in its own tangent plane.

    Parameters
    ----------
    field: of a dome
    mu: friction coefficient
    """
    on = field.contact
    normal = field.normal[on]
    whole = normal.sum()
    if not (whole > 0.0 and mu > 0.0) or field.directions is None:
        return float("nan")
    directions, friction = field.directions[on], field.friction[on]
    axis, centre = _axis_and_centre(field)
    first = np.cross(axis, [1.0, 0.0, 0.0] if abs(axis[0]) < 0.9 else [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    arms = field.position[on] - centre
    size = np.sqrt((normal * (arms**2).sum(axis=1)).sum() / whole) + 1e-12
    # Velocities of the nodes for unit motions: along two axes, and about the normal
    moves = np.stack(
        [np.broadcast_to(first, arms.shape), np.broadcast_to(second, arms.shape),
         np.cross(axis, arms) / size], axis=1,
    )  # fmt: skip
    moves = moves - np.einsum("ijk,ik->ij", moves, directions)[:, :, None] * directions[:, None]
    load = np.einsum("ijk,ik->j", moves, friction)
    if np.linalg.norm(load) < 1e-12 * mu * whole:
        return 1.0
    rounds = 200  # rounds of the search for the motion that needs the least
    least = least_work(np.ascontiguousarray(moves), normal, mu, load, rounds)
    return 1.0 - 1.0 / least


def torsion(field: ForceField) -> tuple[float, Array, float]:
    """Torsion of a dome's contact, how it follows from the wrench, and what friction bears of it.

    It is the torque of the friction about the mean normal, through the centre of pressure. A
    contact of Hertz bears 3π/16·µ·ΣFn·a of it, where nothing pulls.

    Parameters
    ----------
    field: of a dome, with something in contact

    Returns
    -------
    torsion [N·m]
    slope: of it by (F_x, F_y, F_z) [m] and the torque about the sensor's axis, shape (4,), where
        the mean normal is that axis
    bound: torsion that is borne without a pull, over µ [N·m]
    """
    on = field.contact
    axis, centre = _axis_and_centre(field)
    turned = np.cross(axis, field.position[on] - centre)
    twist = float((turned * field.friction[on]).sum())
    bound = float(field.normal[on] @ np.linalg.norm(turned, axis=1))
    return twist, np.array([centre[1], -centre[0], 0.0, 1.0]), bound


def _axis_and_centre(field: ForceField) -> tuple[Array, Array]:
    """Mean normal of a dome's contact, and its centre of pressure."""
    assert field.directions is not None
    on = field.contact
    normal = field.normal[on]
    axis = (normal[:, None] * field.directions[on]).sum(axis=0)
    centre = (normal[:, None] * field.position[on]).sum(axis=0) / normal.sum()
    return axis / np.linalg.norm(axis), centre
