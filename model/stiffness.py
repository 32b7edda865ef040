"""The chain's elasticity as seen from the rigid part: nodal forces F(u) = K(u)·u and their tangent.

The outer nodes are held to the rigid part, so that in the sensor frame only inner nodes move.
"""

import numpy as np
from numpy.typing import NDArray

from .fingertip import Fingertip
from .kernels import chain_tangent, solve_block_tridiagonal
from .objects import ContactObject
from .plant import coefficients

Array = NDArray[np.float64]


def _tangent(fingertip: Fingertip, seen: Array, blunt: float) -> tuple[Array, Array, Array, Array]:
    n = fingertip.nodes
    forces = np.empty((n, 2))
    lower, diagonal, upper = (np.zeros((n - 2, 2, 2)) for _ in range(3))
    # The springs know nothing of the object; any one fills the unused coefficients.
    c = coefficients(fingertip, ContactObject())
    chain_tangent(c, seen, blunt, forces, lower, diagonal, upper)
    return forces, lower, diagonal, upper


def chain_forces(fingertip: Fingertip, seen: Array) -> Array:
    """Forces that hold the chain at displacements `seen`, K(u)·u (thesis Eq. 3 with E6) [N].

    Parameters
    ----------
    fingertip: the chain
    seen: node displacements (x, z) relative to the rigid part [m], shape (N, 2)

    Returns
    -------
    Force on each node, the reactions of the rigid part on the outer ones included, shape (N, 2).
    """
    return _tangent(fingertip, seen, 0.0)[0]


def chain_compliance(fingertip: Fingertip, seen: Array, forces: Array, blunt: float = 0.0) -> Array:
    """Displacements that small nodal forces add at displacements `seen`.

    The turning of the springs is part of the tangent: iterating K(u)·u = f with the springs frozen
    does not converge on stiff or sharp contacts.

    Parameters
    ----------
    fingertip: the chain
    seen: node displacements (x, z) relative to the rigid part [m], shape (N, 2)
    forces: added nodal forces, several load cases at once [N], shape (N, 2, cases); those on the
        two outer nodes act on the rigid part and move nothing
    blunt: slope below which the jump of the derivative, where a spring turns through an axis, is
        smoothed; on a flat contact most of the membrane lies at that jump, and Newton steps with
        the exact derivative hop over it for ever

    Returns
    -------
    Added displacements relative to the rigid part [m], shape (N, 2, cases).
    """
    _, lower, diagonal, upper = _tangent(fingertip, seen, blunt)
    inner = forces[1:-1].copy()  # solved in place
    solve_block_tridiagonal(lower, diagonal, upper, inner)
    out = np.zeros_like(forces)
    out[1:-1] = inner
    return out
