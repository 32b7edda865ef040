"""Elasticity of the chain relative to the rigid part: nodal forces F(u) = K(u)·u and their tangent.

The outer nodes are fixed to the rigid part, so that only inner nodes move in the sensor frame.
"""

from dataclasses import replace
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from ..kernels.blocks import solve_block_tridiagonal
from ..kernels.elastic_kernels import chain_tangent
from ..kernels.springs import spring
from .assembly import chain
from .fingertip import Fingertip, SpringLaw

Array = NDArray[np.float64]


def _tangent(fingertip: Fingertip, seen: Array, blunt: float) -> tuple[Array, Array, Array, Array]:
    """Nodal forces, and lower, diagonal and upper blocks of their derivative by inner nodes."""
    n = fingertip.nodes
    forces = np.empty((n, 2))
    lower, diagonal, upper = (np.zeros((n - 2, 2, 2)) for _ in range(3))
    chain_tangent(chain(fingertip), seen, blunt, forces, lower, diagonal, upper)
    return forces, lower, diagonal, upper


def chain_forces(fingertip: Fingertip, seen: Array) -> Array:
    """Nodal forces that hold the chain at displacements `seen`, K(u)·u (thesis Eq. 3, E6) [N].

    Parameters
    ----------
    fingertip: the chain
    seen: node displacements (x, z) relative to the rigid part [m], shape (N, 2)

    Returns
    -------
    Force on each node, including reactions of the rigid part on the outer ones, shape (N, 2).
    """
    return _tangent(fingertip, seen, 0.0)[0]


def chain_compliance(fingertip: Fingertip, seen: Array, forces: Array, blunt: float = 0.0) -> Array:
    """Displacements that small additional nodal forces cause at displacements `seen`.

    The tangent includes the rotation of springs: iterating K(u)·u = f with fixed directions does
    not converge on stiff or sharp contacts.

    Parameters
    ----------
    fingertip: the chain
    seen: node displacements (x, z) relative to the rigid part [m], shape (N, 2)
    forces: additional nodal forces of one or more load cases [N], shape (N, 2, cases); forces on
        the two outer nodes act on the rigid part and move nothing
    blunt: slope of a spring below which the jump of the derivative at an axis is smoothed. On a
        flat contact most membrane springs lie at that jump, and Newton steps with the exact
        derivative alternate between its sides

    Returns
    -------
    Additional displacements relative to the rigid part [m], shape (N, 2, cases).
    """
    _, lower, diagonal, upper = _tangent(fingertip, seen, blunt)
    inner = forces[1:-1].copy()  # solved in place
    solve_block_tridiagonal(lower, diagonal, upper, inner)
    out = np.zeros_like(forces)
    out[1:-1] = inner
    return out


def spring_force(
    law: SpringLaw,
    rest: tuple[float, float],
    moved: tuple[float, float],
    stiffness: float,
    poisson: float,
) -> tuple[float, float]:
    """Force of a single spring (thesis Figs. 19 to 21).

    Parameters
    ----------
    law: law of the force, see `Fingertip`
    rest: vector (x, z) from the first end to the second, unloaded [m]
    moved: displacement of the second end relative to the first [m]
    stiffness: stiffness of the spring [N/m]
    poisson: Poisson factor, with the sign of its half of the chain

    Returns
    -------
    Force (x, z) that holds the second end there [N].
    """
    number = get_args(SpringLaw).index(law)
    x, z = rest[0] + moved[0], rest[1] + moved[1]
    return spring(number, x, z, *moved, stiffness, poisson, 0.0, 0.0)[:2]


def spring_forces(fingertip: Fingertip, seen: Array) -> tuple[Array, Array]:
    """Forces that hold each node against its tissue spring, and against its membrane springs [N].

    Their sum is `chain_forces`; both have the shape (N, 2).

    Parameters
    ----------
    fingertip: the chain
    seen: node displacements (x, z) relative to the rigid part [m], shape (N, 2)
    """
    without = replace(fingertip, membrane_stiffness=TINY, poisson_membrane=0.0)
    tissue = chain_forces(without, seen)
    return tissue, chain_forces(fingertip, seen) - tissue


#: Stiffness in place of 0, which `Fingertip` refuses [N/m].
TINY = 1e-12
