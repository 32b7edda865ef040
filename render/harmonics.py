"""The chain's plane carried onto the skin by its two lowest azimuthal harmonics.

The mirror-even part of the chain is revolved; the mirror-odd part gives u_x = a(θ),
u_z = c(θ)·cos φ, u_y = 0. Exact in the plane of the chain, linear in the node displacements.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from .design.skin import Skin

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class HarmonicMap:
    """Linear map from node displacements to displacements of points of the skin.

    Attributes
    ----------
    right, left: interpolation of the chain at +θ and at −θ, shape (M, N)
    right_slope, left_slope: derivatives of those with respect to θ, shape (M, N)
    ring: length of a unit of φ over that of θ, shape (M,)
    phi: azimuth of the points [rad], shape (M,)
    """

    right: "scipy.sparse.csr_array"
    left: "scipy.sparse.csr_array"
    right_slope: "scipy.sparse.csr_array"
    left_slope: "scipy.sparse.csr_array"
    ring: Array
    phi: Array

    def _harmonics(self, right: Array, left: Array) -> tuple[Array, Array, Array, Array]:
        """Radial u_r, shift a, mean u_z and tilt c from (M, 2, …) values at ±θ."""
        return (
            (right[:, 0] - left[:, 0]) / 2,
            (right[:, 0] + left[:, 0]) / 2,
            (right[:, 1] + left[:, 1]) / 2,
            (right[:, 1] - left[:, 1]) / 2,
        )

    def displacement(self, nodal: Array) -> Array:
        """Displacement of every point [m], shape (M, 3, …), from nodes (N, 2, …) [m]."""
        u_r, shift, u_z, tilt = self._harmonics(_apply(self.right, nodal), _apply(self.left, nodal))
        cos, sin = _columns(np.cos(self.phi), u_r), _columns(np.sin(self.phi), u_r)
        return np.stack([u_r * cos + shift, u_r * sin, u_z + tilt * cos], axis=1)

    def scalar(self, nodal: Array) -> Array:
        """Scalar at every point, shape (M, …), from its even and odd parts on the nodes (N, …)."""
        return _apply(self._scalars, nodal)

    @cached_property
    def _scalars(self) -> "scipy.sparse.csr_array":
        half = 0.5 * np.cos(self.phi)
        both = (
            scipy.sparse.diags_array(0.5 + half) @ self.right
            + scipy.sparse.diags_array(0.5 - half) @ self.left
        )
        return scipy.sparse.csr_array(both)

    def gradient(self, nodal: Array) -> tuple[Array, Array]:
        """∂d/∂θ and ∂d/∂φ/ring of `displacement` [m per unit of θ], each of shape (M, 3, …)."""
        u_r, shift, u_z, tilt = self._harmonics(
            _apply(self.right_slope, nodal), _apply(self.left_slope, nodal)
        )
        cos, sin = _columns(np.cos(self.phi), u_r), _columns(np.sin(self.phi), u_r)
        along_theta = np.stack([u_r * cos + shift, u_r * sin, u_z + tilt * cos], axis=1)
        u_r, _, _, tilt = self._harmonics(_apply(self.right, nodal), _apply(self.left, nodal))
        ring = _columns(self.ring, u_r)
        along_phi = np.stack([-u_r * sin, u_r * cos, -tilt * sin], axis=1) / ring[:, None]
        return along_theta, along_phi


def _columns(values: Array, like: Array) -> Array:
    return values.reshape(values.shape + (1,) * (like.ndim - 1))


def _apply(matrix: "scipy.sparse.csr_array", nodal: Array) -> Array:
    flat = matrix @ nodal.reshape(nodal.shape[0], -1)
    return flat.reshape((flat.shape[0], *nodal.shape[1:]))


def harmonic_map(skin: Skin, places: Array, nodes: int | Array) -> HarmonicMap:
    """Map for points at places (M, 2) of a skin.

    Parameters
    ----------
    skin: at rest
    places: see `skin`, shape (M, 2)
    nodes: how many evenly spaced nodes cross the skin, or their places: signed angles [rad], on a
        pad x [m], increasing, shape (N,)
    """
    first, phi = np.array(places, dtype=float).T
    stations = stations_of(skin, nodes)
    right, left = _interpolation(first, stations), _interpolation(-first, stations)
    derivative = _derivative(stations)
    return HarmonicMap(
        right=right,
        left=left,
        right_slope=scipy.sparse.csr_array(right @ derivative),
        # d/dθ of f(−θ) is −f′(−θ).
        left_slope=scipy.sparse.csr_array(-(left @ derivative)),
        ring=skin.ring(first),
        phi=phi,
    )


def _derivative(stations: Array) -> "scipy.sparse.csr_array":
    """Derivative at each node."""
    n = len(stations)
    inner = np.arange(1, n - 1)
    columns = inner[:, None] + np.array([-1, 0, 1])
    values = slope_weights(stations)[1:-1].ravel()
    return scipy.sparse.csr_array((values, (np.repeat(inner, 3), columns.ravel())), shape=(n, n))


def slope_weights(stations: Array) -> Array:
    """Weights of the node before, a node and that behind in the derivative at each, shape (N, 3).

    Of second order; 0 at the two outer ones, which are held.
    """
    before, after = np.diff(stations)[:-1], np.diff(stations)[1:]
    weights = np.zeros((len(stations), 3))
    weights[1:-1, 0] = -after / (before * (before + after))
    weights[1:-1, 1] = (after - before) / (before * after)
    weights[1:-1, 2] = before / (after * (before + after))
    return weights


def _interpolation(place: Array, stations: Array) -> "scipy.sparse.csr_array":
    """Linear interpolation of nodal values at signed places."""
    n, m = len(stations), len(place)
    index, weight = node_before(place, stations)
    rows = np.concatenate([np.arange(m), np.arange(m)])
    columns = np.concatenate([index, index + 1])
    return scipy.sparse.csr_array(
        (np.concatenate([1 - weight, weight]), (rows, columns)), shape=(m, n)
    )


def node_before(place: Array, stations: Array) -> tuple[NDArray[np.int64], Array]:
    """Node before each signed place, and the weight of that behind it, shapes of `place`.

    Places beyond the outer nodes, such as a pad's corners, move as these do: they are held.
    """
    index = np.clip(np.searchsorted(stations, place, side="right") - 1, 0, len(stations) - 2)
    weight = (place - stations[index]) / (stations[index + 1] - stations[index])
    return index.astype(np.int64), np.clip(weight, 0.0, 1.0)


def stations_of(skin: Skin, nodes: int | Array) -> Array:
    """Places of nodes: evenly spaced across the skin where only their number is given, (N,)."""
    return np.linspace(-skin.half, skin.half, nodes) if isinstance(nodes, int) else nodes
