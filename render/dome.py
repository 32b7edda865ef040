"""The chain's plane carried onto the dome by its two lowest azimuthal harmonics.

The mirror-even part of the chain is revolved; the mirror-odd part gives u_x = a(θ),
u_z = c(θ)·cos φ, u_y = 0. Exact in the plane of the chain, linear in the node displacements.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class DomeMap:
    """Linear map from node displacements to displacements of points of the dome.

    Attributes
    ----------
    right, left: interpolation of the chain at +θ and at −θ, shape (M, N)
    right_slope, left_slope: derivatives of those with respect to θ [1/rad], shape (M, N)
    theta, phi: directions of the points [rad], shape (M,)
    """

    right: csr_array
    left: csr_array
    right_slope: csr_array
    left_slope: csr_array
    theta: Array
    phi: Array

    def _harmonics(self, right: Array, left: Array) -> tuple[Array, Array, Array, Array]:
        """Radial u_r, shift a, mean u_z and tilt c from (M, 2, …) values at ±θ."""
        return (
            (right[:, 0] - left[:, 0]) / 2,
            (right[:, 0] + left[:, 0]) / 2,
            (right[:, 1] + left[:, 1]) / 2,
            (right[:, 1] - left[:, 1]) / 2,
        )

    def displacement(self, seen: Array) -> Array:
        """Displacement of every point [m], shape (M, 3, …), from nodes (N, 2, …) [m]."""
        u_r, shift, u_z, tilt = self._harmonics(_apply(self.right, seen), _apply(self.left, seen))
        cos, sin = _columns(np.cos(self.phi), u_r), _columns(np.sin(self.phi), u_r)
        return np.stack([u_r * cos + shift, u_r * sin, u_z + tilt * cos], axis=1)

    def gradient(self, seen: Array) -> tuple[Array, Array]:
        """∂d/∂θ and ∂d/∂φ/sin θ of `displacement` [m/rad], each of shape (M, 3, …)."""
        u_r, shift, u_z, tilt = self._harmonics(
            _apply(self.right_slope, seen), _apply(self.left_slope, seen)
        )
        cos, sin = _columns(np.cos(self.phi), u_r), _columns(np.sin(self.phi), u_r)
        along_theta = np.stack([u_r * cos + shift, u_r * sin, u_z + tilt * cos], axis=1)
        u_r, _, _, tilt = self._harmonics(_apply(self.right, seen), _apply(self.left, seen))
        ring = _columns(np.sin(self.theta), u_r)
        along_phi = np.stack([-u_r * sin, u_r * cos, -tilt * sin], axis=1) / ring[:, None]
        return along_theta, along_phi


def _columns(values: Array, like: Array) -> Array:
    return values.reshape(values.shape + (1,) * (like.ndim - 1))


def _apply(matrix: csr_array, seen: Array) -> Array:
    flat = matrix @ seen.reshape(seen.shape[0], -1)
    return flat.reshape((flat.shape[0], *seen.shape[1:]))


def dome_map(directions: Array, nodes: int) -> DomeMap:
    """Map for points at directions (θ, φ) [rad], shape (M, 2), and a chain of `nodes` nodes."""
    theta, phi = np.array(directions, dtype=float).T
    spacing = np.pi / (nodes - 1)
    # Central differences at the nodes; the two outer ones are held and lie outside the markers.
    rows = np.repeat(np.arange(1, nodes - 1), 2)
    columns = (np.arange(1, nodes - 1)[:, None] + np.array([1, -1])).ravel()
    values = np.tile([0.5 / spacing, -0.5 / spacing], nodes - 2)
    derivative = csr_array((values, (rows, columns)), shape=(nodes, nodes))
    right, left = _interpolation(theta, nodes), _interpolation(-theta, nodes)
    return DomeMap(
        right=right,
        left=left,
        right_slope=csr_array(right @ derivative),
        # d/dθ of f(−θ) is −f′(−θ).
        left_slope=csr_array(-(left @ derivative)),
        theta=theta,
        phi=phi,
    )


def _interpolation(angle: Array, nodes: int) -> csr_array:
    """Linear interpolation of nodal values at signed angles from the apex."""
    place = (angle + np.pi / 2) / np.pi * (nodes - 1)
    index = np.clip(place.astype(int), 0, nodes - 2)
    weight = place - index
    m = len(angle)
    rows = np.concatenate([np.arange(m), np.arange(m)])
    columns = np.concatenate([index, index + 1])
    return csr_array((np.concatenate([1 - weight, weight]), (rows, columns)), shape=(m, nodes))
