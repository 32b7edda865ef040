"""Displacement of points inside the silicone, and its derivatives, for forces on the nodes."""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from ...kept_arrays import content_key, kept_or_made
from ..kernels.dome.inside_kernels import add_columns, fill_column, fill_skin_columns
from .compliance import WIDTH, compliance_scale, nothing, skin_compliance
from .dome import Dome, Pad, SoftBody, lattice
from .elements import Meridian, loads, mesh, solved
from .layer import layer_motion, layer_moved, layer_slopes

Array = NDArray[np.float64]
Table = NDArray[np.float32]

#: Columns of forces are kept up to so many bytes; what is loaded now always is.
_ROOM = 200_000_000


def inside_table(
    dome: Dome, depth: float, progress: Callable[[int, int], None] = nothing
) -> tuple[Array, Table]:
    """Harmonics of the displacement at a depth, for unit forces on each ring.

    The first call for a shape, ν and depth solves the elasticity, which takes some seconds; the
    table is then stored in the user's cache folder.

    Parameters
    ----------
    depth: depth under the skin [m]
    progress: function called with the numbers of finished and of all harmonics

    Returns
    -------
    stations: angles from the apex [rad], shape (S,)
    waves: amplitudes U, V, W of H harmonics for forces along r, φ, z on K rings, shape
        (K, S, H, 9), in units of `compliance_scale`
    """
    return _inside_table(_shape(dome), round(depth / dome.radius, 9), progress)


def _shape(dome: Dome) -> tuple[float, float, float, float]:
    """Core over radius, ν, width of a load [rad] and number of rings."""
    return (
        round(dome.core / dome.radius, 9),
        dome.poisson,
        WIDTH * dome.spacing / dome.radius,
        float(len(lattice(dome).angles)),
    )


@lru_cache(maxsize=8)
def _inside_table(
    shape: tuple[float, float, float, float], depth: float, progress: Callable[[int, int], None]
) -> tuple[Array, Table]:
    core, poisson, width, rings = shape
    angles = np.asarray((np.arange(int(rings)) + 0.5) * width / WIDTH, np.float64)
    version = "inside a dome 2"
    key = content_key(version, np.array(shape), np.array([depth]))
    kind = "domes"  # folder of the user's cache; its tables are made anew when the version changes

    def make() -> dict[str, NDArray[np.generic]]:
        stations, waves = make_waves(core, poisson, width, angles, depth, progress)
        return {"stations": stations, "waves": waves}

    found = kept_or_made(kind, key, make)
    for array in found.values():
        array.setflags(write=False)
    return np.asarray(found["stations"], np.float64), np.asarray(found["waves"], np.float32)


def make_waves(
    core: float,
    poisson: float,
    width: float,
    rings: Array,
    depth: float,
    progress: Callable[[int, int], None] = nothing,
) -> tuple[Array, Table]:
    """Compute an `inside_table` without the cache, with lengths over the radius."""
    meridian = mesh(core, poisson, width, rings[-1])
    above = _between_levels(meridian, 1.0 - depth)
    load = loads(meridian, rings, width)
    faded = 5.0  # harmonics of which less than exp(−faded) arrives at a depth are left out
    # A harmonic m is spread as exp(−m²·width²/2), and fades as exp(−m·depth) below the skin.
    most = (math.sqrt(depth**2 + 2.0 * faded * width**2) - depth) / width**2
    harmonics = math.ceil(most) + 2
    # Silicone between a layer and the core that is thinner than this counts as none, over the
    # radius.
    thinnest = 1e-9
    if depth >= 1.0 - core - thinnest:  # bonded to the core, where nothing moves
        harmonics = 0
    shape = len(rings), len(meridian.stations), max(harmonics, 1), 9
    waves = np.zeros(shape, np.float32)
    largest = np.zeros(len(rings))
    # Nor are loads of a harmonic that are so small a share of those of others on the ring.
    nothing_share = 1e-4
    for m in range(harmonics):
        progress(m, harmonics)
        work = load(m)
        sizes = abs(work).max(axis=(0, 2))
        largest = np.maximum(largest, sizes)
        some = np.flatnonzero(sizes > nothing_share * largest)
        if not len(some):
            break
        moved = solved(meridian, m, work[:, some])
        at_depth = np.einsum("l,slck->sck", above, moved).reshape(len(moved), 3, len(some), 3)
        waves[some, :, m] = at_depth.transpose(2, 0, 1, 3).reshape(len(some), len(moved), 9)
    return meridian.stations, waves


def _between_levels(meridian: Meridian, radius: float) -> Array:
    """Weights of a meridian's L levels in the value at a radius (quadratic elements), (L,)."""
    radii = meridian.radii
    element = min(max(int(np.searchsorted(radii[::2], radius)) - 1, 0), len(radii) // 2 - 1)
    three = radii[2 * element : 2 * element + 3]
    weights = np.zeros(len(radii))
    for i in range(3):
        others = np.delete(three, i)
        weights[2 * element + i] = np.prod((radius - others) / (three[i] - others))
    return weights


class _Columns:
    """Cached columns of a linear map from node forces, each made when its node is first loaded.

    Parameters
    ----------
    nodes: number of nodes
    values: length of a column
    fill: function that computes the columns of nodes (n,), into (n, 3, values)
    """

    def __init__(
        self, nodes: int, values: int, fill: Callable[[NDArray[np.int64], Table], None]
    ) -> None:
        self._slot, self._fill = np.full(nodes, -1), fill
        self._columns, self._used = np.empty((0, 3, values), np.float32), 0
        self._sum = np.zeros(values, np.float32)

    def __call__(self, forces: Array) -> Table:
        """Multiply the columns by forces (N, 3); the result is overwritten by the next call."""
        loaded = np.flatnonzero(forces.any(axis=1))
        self._make(loaded)
        add_columns(self._columns, self._slot[loaded], forces[loaded], self._sum)
        return self._sum

    def of(self, nodes: NDArray[np.int64]) -> Table:
        """Columns of nodes (n,), shape (n, 3, values)."""
        self._make(nodes)
        return self._columns[self._slot[nodes]]

    def _make(self, loaded: NDArray[np.int64]) -> None:
        """Make the missing columns of nodes."""
        missing = loaded[self._slot[loaded] < 0]
        if len(missing):
            if 12 * self._sum.size * (self._used + len(missing)) > _ROOM:
                self._slot[:] = -1
                self._used, missing = 0, loaded
            until = self._used + len(missing)
            if until > len(self._columns):
                room = np.empty((until + 64, *self._columns.shape[1:]), np.float32)
                room[: self._used] = self._columns[: self._used]
                self._columns = room
            self._fill(missing, self._columns[self._used : until])
            self._slot[missing] = np.arange(self._used, until)
            self._used = until


class SkinField:
    """Displacement of all skin nodes, as by `displacements`, cached for many frames."""

    def __init__(self, body: SoftBody) -> None:
        skin = skin_compliance(body)

        def fill(missing: NDArray[np.int64], out: Table) -> None:
            fill_skin_columns(skin, missing, out)

        self._columns = _Columns(len(skin.ring), 3 * len(skin.ring), fill)

    def __call__(self, forces: Array) -> Array:
        """Displacements [m] for forces on the nodes of the linear skin [N], both (N, 3)."""
        return self._columns(forces).reshape(-1, 3).astype(np.float64)

    def of_nodes(self, nodes: NDArray[np.int64]) -> Table:
        """Displacements of all N nodes for unit forces on n nodes [m/N], shape (n, 3, N, 3)."""
        return self._columns.of(nodes).reshape(len(nodes), 3, -1, 3)


class MarkerField:
    """Displacement of M markers in each of L layers, and its derivatives along the layer.

    Parameters
    ----------
    body: body that contains the markers
    places: angle from the apex of a dome [rad] or distance from the middle of a pad [m], and
        azimuth [rad], of the markers of each layer, shape (L, M, 2)
    depths: depths of the layers under the skin [m], shape (L,)
    """

    def __init__(self, body: SoftBody, places: Array, depths: Sequence[float]) -> None:
        nodes = lattice(body)
        self._shape = places.shape[:2]
        self._layers: list[_DomeLayer | _PadLayer] = [
            _LAYERS[type(body)](body, np.asarray(place, np.float64), float(depth))
            for place, depth in zip(places, depths, strict=True)
        ]
        values = 9 * self._shape[0] * self._shape[1]
        self._columns = _Columns(len(nodes.ring), values, self._fill)

    def __call__(self, forces: Array) -> tuple[Array, Array]:
        """Displacements and their derivatives for forces on the nodes.

        Parameters
        ----------
        forces: forces on the nodes of the linear skin [N], shape (N, 3)

        Returns
        -------
        displacement: displacements of the markers [m], shape (L, M, 3)
        slopes: derivatives of each component per length along the first coordinate of a place and
            along φ, shape (L, M, 3, 2)
        """
        field = self._columns(forces).reshape(*self._shape, 9).astype(np.float64)
        return field[..., :3], field[..., 3:].reshape(*self._shape, 3, 2)

    def of_nodes(self, nodes: NDArray[np.int64]) -> Table:
        """Displacements and derivatives for unit forces on n nodes [m/N], (n, 3, L, M, 9)."""
        return self._columns.of(nodes).reshape(len(nodes), 3, *self._shape, 9)

    def _fill(self, missing: NDArray[np.int64], out: Table) -> None:
        each = out.reshape(len(missing), 3, *self._shape, 9)
        for n, layer in enumerate(self._layers):
            layer.fill(missing, each[:, :, n])


class _DomeLayer:
    """Markers at one depth of a dome."""

    def __init__(self, dome: Dome, places: Array, depth: float) -> None:
        stations, self._table = inside_table(dome, depth)
        nearest = 1e-3  # markers nearer to the axis than this are taken to lie so far from it [rad]
        angles = np.maximum(places[:, 0], nearest)
        self._angles, self._azimuths = angles, np.ascontiguousarray(places[:, 1])
        each, self._row = np.unique(angles, return_inverse=True)
        # Beyond the apex a field goes on as on the other side, with the sign of its harmonic.
        mirrored = min(6, len(stations) - 1)
        stations = np.concatenate([-stations[mirrored:0:-1], stations])
        flip = np.where(np.arange(self._table.shape[2]) % 2 == 0, 1.0, -1.0)[:, None]
        self._flip = (flip * np.repeat([-1.0, -1.0, 1.0], 3)).astype(np.float32)
        self._mirrored = mirrored
        self._slopes, self._between = _spline(stations, each)
        self._along, self._scale = 1.0 / (dome.radius - depth), compliance_scale(dome)
        self._nodes = lattice(dome)
        self._of_ring: dict[int, tuple[Table, Table]] = {}

    def _waves(self, ring: int) -> tuple[Table, Table]:
        """Harmonics at the A marker angles, and their derivatives, both (A, H, 9) [m/N]."""
        if ring not in self._of_ring:
            table = self._table[ring]
            # Harmonics of which nothing arrives from this ring.
            sizes = abs(table).max(axis=(0, 2))
            last = int(np.flatnonzero(sizes > 1e-5 * max(sizes.max(), 1e-30)).max(initial=0))
            table = table[:, : last + 1]
            over = self._flip[: last + 1] * table[self._mirrored : 0 : -1]
            values = np.concatenate([over, table]).reshape(-1, table[0].size).astype(float)
            values *= self._scale
            both = self._between @ np.concatenate([values, self._slopes @ values])
            wave, slope = both.astype(np.float32).reshape(2, -1, *table[0].shape)
            self._of_ring[ring] = wave, slope
        return self._of_ring[ring]

    def fill(self, nodes: NDArray[np.int64], out: Table) -> None:
        """Compute the columns of nodes (n,), into `out` (n, 3, M, 9)."""
        rings = self._nodes.ring[nodes]
        for ring in np.unique(rings):
            waves = self._waves(int(ring))
            for i in np.flatnonzero(rings == ring):
                fill_column(
                    *waves, self._row, self._angles, self._azimuths,
                    float(self._nodes.azimuth[nodes[i]]), self._along, out[i],
                )  # fmt: skip


class _PadLayer:
    """Markers at one depth of a pad."""

    def __init__(self, pad: Pad, places: Array, depth: float) -> None:
        self._motion = layer_motion(
            pad.thickness, pad.poisson, WIDTH * pad.spacing, math.inf, depth
        )
        self._scale = 1.0 / pad.young
        rho, phi = places.T
        c, s = np.cos(phi), np.sin(phi)
        self._at = np.stack([rho * c, rho * s], axis=-1)
        self._axes = np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)
        self._points = lattice(pad).points

    def fill(self, nodes: NDArray[np.int64], out: Table) -> None:
        """Compute the columns of nodes (n,), into `out` (n, 3, M, 9)."""
        for i, node in enumerate(nodes):
            way = self._at - self._points[node, :2]
            slopes = layer_slopes(self._motion, way) @ self._axes[:, None]
            out[i, :, :, :3] = self._scale * layer_moved(self._motion, way).transpose(2, 0, 1)
            out[i, :, :, 3:] = self._scale * slopes.transpose(2, 0, 1, 3).reshape(3, len(way), 6)


#: Layer of markers in each kind of body.
_LAYERS: dict[type[SoftBody], Callable[[Any, Array, float], _DomeLayer | _PadLayer]] = {
    Dome: _DomeLayer,
    Pad: _PadLayer,
}


def _spline(stations: Array, places: Array) -> "tuple[Array, scipy.sparse.csr_matrix]":
    """Matrices of a cubic spline through S stations, evaluated at P fixed places.

    Returns
    -------
    slopes: matrix from values to derivatives at the stations, shape (S, S)
    between: matrix from values and derivatives at the stations to values, then derivatives, at the
        places, shape (2·P, 2·S)
    """
    count = len(stations)
    slopes = scipy.interpolate.CubicSpline(stations, np.eye(count))(stations, 1)
    left = np.clip(np.searchsorted(stations, places, side="right") - 1, 0, count - 2)
    step = stations[left + 1] - stations[left]
    t = (places - stations[left]) / step
    value = [(1.0 + 2.0 * t) * (1.0 - t) ** 2, t**2 * (3.0 - 2.0 * t)]
    value += [step * t * (1.0 - t) ** 2, step * t**2 * (t - 1.0)]
    derivative = [6.0 * t * (t - 1.0) / step, 6.0 * t * (1.0 - t) / step]
    derivative += [(1.0 - t) * (1.0 - 3.0 * t), t * (3.0 * t - 2.0)]
    columns = np.stack([left, left + 1, count + left, count + left + 1], axis=-1)
    weights = np.concatenate([np.stack(value, axis=-1), np.stack(derivative, axis=-1)])
    rows = np.repeat(np.arange(2 * len(places)), 4)
    entries = weights.ravel(), (rows, np.tile(columns.ravel(), 2))
    return np.asarray(slopes), scipy.sparse.csr_matrix(entries, shape=(2 * len(places), 2 * count))
