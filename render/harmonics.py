"""Extension of the chain's plane displacements to the whole skin, by two azimuthal harmonics.

The mirror-even part of the chain is revolved about the axis; the mirror-odd part gives u_x = a(θ),
u_z = c(θ)·cos φ, u_y = 0. This is exact in the plane of the chain and linear in the displacements.
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
    """Linear map from displacements of N nodes to displacements of M points of the skin.

    Attributes
    ----------
    right, left: matrices that interpolate node values at +θ and at −θ of each point, shape (M, N)
    right_slope, left_slope: matrices of their derivatives with respect to θ, shape (M, N)
    ring: length of a unit of φ over length of a unit of θ, at each point, shape (M,)
    phi: azimuth of the points from the plane of the chain [rad], shape (M,)
    azimuth: azimuth of that plane [rad]
    """

    right: "scipy.sparse.csr_array"
    left: "scipy.sparse.csr_array"
    right_slope: "scipy.sparse.csr_array"
    left_slope: "scipy.sparse.csr_array"
    ring: Array
    phi: Array
    azimuth: float = 0.0

    def _harmonics(self, right: Array, left: Array) -> tuple[Array, Array, Array, Array]:
        """Radial u_r, shift a, mean u_z and tilt c, from values (M, 2, …) at +θ and at −θ."""
        return (
            (right[:, 0] - left[:, 0]) / 2,
            (right[:, 0] + left[:, 0]) / 2,
            (right[:, 1] + left[:, 1]) / 2,
            (right[:, 1] - left[:, 1]) / 2,
        )

    def displacement(self, nodal: Array) -> Array:
        """Displacements of the points [m], (M, 3, …), from those of the nodes [m], (N, 2, …)."""
        return self._moved(_apply(self.right, nodal), _apply(self.left, nodal))

    def scalar(self, nodal: Array) -> Array:
        """Extend a scalar on the nodes, (N, …), to the points, (M, …), by the same harmonics."""
        return _apply(self._scalars, nodal)

    @cached_property
    def _scalars(self) -> "scipy.sparse.csr_array":
        """Matrix of `scalar`, shape (M, N)."""
        half = 0.5 * np.cos(self.phi)
        both = (
            scipy.sparse.diags_array(0.5 + half) @ self.right
            + scipy.sparse.diags_array(0.5 - half) @ self.left
        )
        return scipy.sparse.csr_array(both)

    def gradient(self, nodal: Array) -> tuple[Array, Array]:
        """Derivatives ∂d/∂θ and (∂d/∂φ)/ring of `displacement` [m per unit of θ], (M, 3, …)."""
        return (
            self._moved(_apply(self.right_slope, nodal), _apply(self.left_slope, nodal)),
            self._around(_apply(self.right, nodal), _apply(self.left, nodal)),
        )

    def many(self, nodal: Array) -> tuple[Array, Array]:
        """Displacements (S, M, 3) and gradients (S, M, 3, 2) for S displacements (S, N, 2)."""
        values = np.ascontiguousarray((self._whole @ nodal.reshape(len(nodal), -1).T).T)
        values = values.reshape(len(nodal), len(self.phi), 3, 3)
        return values[..., 0], values[..., 1:]

    @cached_property
    def _whole(self) -> "scipy.sparse.csr_array":
        """Matrix of displacement and gradient as columns, at all points, shape (M·3·3, N·2)."""
        points = len(self.phi)
        # What each of the four values at ±θ, and each of their slopes, contributes.
        unit = np.eye(4).reshape(2, 1, 2, 4)
        moved, around = self._moved(*unit), self._around(*unit)
        none = np.zeros_like(moved)
        shares = (np.stack(each, axis=2) for each in ((moved, none, around), (none, moved, none)))
        sides = np.concatenate([np.split(share, 2, axis=-1) for share in shares])
        at = np.arange(points), np.arange(points + 1)
        matrices = (self.right, self.left, self.right_slope, self.left_slope)
        parts = (
            scipy.sparse.bsr_array((side, *at)) @ scipy.sparse.kron(matrix, np.eye(2))
            for side, matrix in zip(sides.reshape(4, points, 9, 2), matrices, strict=True)
        )
        whole = scipy.sparse.csr_array(sum(parts))
        whole.eliminate_zeros()
        return whole

    def _moved(self, right: Array, left: Array) -> Array:
        """Displacements of the points (M, 3, …) for values (M, 2, …) at +θ and at −θ."""
        u_r, shift, u_z, tilt = self._harmonics(right, left)
        cos, sin = _columns(np.cos(self.phi), u_r), _columns(np.sin(self.phi), u_r)
        return self._turned(u_r * cos + shift, u_r * sin, u_z + tilt * cos)

    def _around(self, right: Array, left: Array) -> Array:
        """Their derivatives along φ."""
        u_r, _, _, tilt = self._harmonics(right, left)
        cos, sin = _columns(np.cos(self.phi), u_r), _columns(np.sin(self.phi), u_r)
        ring = _columns(self.ring, u_r)
        return self._turned(-u_r * sin, u_r * cos, -tilt * sin) / ring[:, None]

    def _turned(self, x: Array, y: Array, z: Array) -> Array:
        """Vectors (M, 3, …) of components (M, …) along and across the plane of the chain."""
        if self.azimuth:
            cos, sin = np.cos(self.azimuth), np.sin(self.azimuth)
            x, y = cos * x - sin * y, sin * x + cos * y
        return np.stack([x, y, z], axis=1)


def _columns(values: Array, like: Array) -> Array:
    """Append axes to values (M,) so that they multiply `like`."""
    return values.reshape(values.shape + (1,) * (like.ndim - 1))


def _apply(matrix: "scipy.sparse.csr_array", nodal: Array) -> Array:
    """Multiply a sparse matrix by nodal values (N, …)."""
    flat = matrix @ nodal.reshape(nodal.shape[0], -1)
    return flat.reshape((flat.shape[0], *nodal.shape[1:]))


def harmonic_map(
    skin: Skin, places: Array, nodes: int | Array, azimuth: float = 0.0
) -> HarmonicMap:
    """Make the map for M points of a skin.

    Parameters
    ----------
    skin: skin at rest
    places: places of the points, see `skin`, shape (M, 2)
    nodes: number of evenly spaced nodes across the skin, or their increasing places: signed angles
        [rad], on a pad x [m], shape (N,)
    azimuth: azimuth of the plane of the chain [rad]
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
        phi=phi - azimuth,
        azimuth=azimuth,
    )


def _derivative(stations: Array) -> "scipy.sparse.csr_array":
    """Matrix of the derivative at each node, shape (N, N)."""
    n = len(stations)
    inner = np.arange(1, n - 1)
    columns = inner[:, None] + np.array([-1, 0, 1])
    values = slope_weights(stations)[1:-1].ravel()
    return scipy.sparse.csr_array((values, (np.repeat(inner, 3), columns.ravel())), shape=(n, n))


def slope_weights(stations: Array) -> Array:
    """Weights of the previous, the own and the next node in the derivative at a node, (N, 3).

    The derivative is of second order; it is 0 at the two outer nodes, which are held.
    """
    before, after = np.diff(stations)[:-1], np.diff(stations)[1:]
    weights = np.zeros((len(stations), 3))
    weights[1:-1, 0] = -after / (before * (before + after))
    weights[1:-1, 1] = (after - before) / (before * after)
    weights[1:-1, 2] = before / (after * (before + after))
    return weights


def _interpolation(place: Array, stations: Array) -> "scipy.sparse.csr_array":
    """Matrix that linearly interpolates nodal values at M signed places, shape (M, N)."""
    n, m = len(stations), len(place)
    index, weight = node_before(place, stations)
    rows = np.concatenate([np.arange(m), np.arange(m)])
    columns = np.concatenate([index, index + 1])
    return scipy.sparse.csr_array(
        (np.concatenate([1 - weight, weight]), (rows, columns)), shape=(m, n)
    )


def node_before(place: Array, stations: Array) -> tuple[NDArray[np.int64], Array]:
    """Index of the node before each signed place, and weight of the next node.

    Places beyond the outer nodes, such as a pad's corners, move like these, which are held.
    """
    index = np.clip(np.searchsorted(stations, place, side="right") - 1, 0, len(stations) - 2)
    weight = (place - stations[index]) / (stations[index + 1] - stations[index])
    return index.astype(np.int64), np.clip(weight, 0.0, 1.0)


def stations_of(skin: Skin, nodes: int | Array) -> Array:
    """Places of the nodes, (N,); evenly spaced across the skin if only their number is given."""
    return np.linspace(-skin.half, skin.half, nodes) if isinstance(nodes, int) else nodes
