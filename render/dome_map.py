"""Membrane of a silicone body: each marker moves like the silicone at its depth."""

import numpy as np
import scipy
from numpy.typing import NDArray

from ..errors import UserError
from ..model import SoftBody
from ..model.dome import MarkerField, SkinField, lattice
from .design.sensor import SensorDesign
from .membrane import Membrane
from .place_kernels import carry_in_silicone

Array = NDArray[np.float64]


class DomeMap:
    """Maps forces on the skin to the membrane of its sensor; built once, called every frame.

    How much a layer follows the skin and how its markers swell follows from their depth, not from
    the design. A dot may be stiffer than the silicone, see `markers.stretch`. Markers that swell on
    the chain stretch like the silicone here.

    Parameters
    ----------
    sensor: design of the sensor
    dome: body that contains the markers
    places: places of the markers of each layer, shape (2, M, 2); None: as designed

    Attributes
    ----------
    field: map from forces on the skin to the motion of the silicone at the markers
    """

    def __init__(self, sensor: SensorDesign, dome: SoftBody, places: Array | None = None) -> None:
        skin = sensor.shape
        own = sensor.places if places is None else places
        own = np.broadcast_to(own, (2, *own.shape[-2:]))
        self.field = MarkerField(dome, own, layer_depths(sensor, dome))
        self._rest = np.stack(
            [skin.points(each, depth) for each, depth in zip(own, sensor.depths, strict=True)]
        )
        self._tangents = np.stack(skin.tangents(own), axis=-1)
        cos, sin = np.cos(own[..., 1]), np.sin(own[..., 1])
        # Squares lie along the sensor's x and y, discs anyhow: here their axes turn with the place.
        if sensor.markers.form == "square":
            sin = -sin
        upright = np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], -2)
        self._upright = np.asarray(sensor.half_sizes)[:, None, None, None] * upright
        self._stretch = 1.0 if sensor.markers.swell_mm else float(sensor.markers.stretch)

    def __call__(self, forces: Array) -> Membrane:
        """Membrane for forces on the nodes of the linear skin, (N, 3) [N]."""
        return self.of_field(*self.field(forces))

    def of_field(self, moved: Array, slope: Array) -> Membrane:
        """Membrane for the displacements (2, M, 3) [m] and derivatives (2, M, 3, 2) of `field`."""
        centres, axes = np.empty(self._rest.shape), np.empty(self._tangents.shape)
        carry_in_silicone(
            np.ascontiguousarray(moved.reshape(-1, 3)),
            np.ascontiguousarray(slope.reshape(-1, 3, 2)),
            self._rest.reshape(-1, 3),
            self._tangents.reshape(-1, 3, 2),
            self._upright.reshape(-1, 2, 2),
            self._stretch,
            centres.reshape(-1, 3),
            axes.reshape(-1, 3, 2),
        )
        return Membrane(centres=centres, axes=axes)


class DomeSheets:
    """Displacement of any places of three sheets: both layers (0 and 1) and the skin (2).

    Displacement and gradient are known at sample points, and 0 on the equator or a circle around a
    pad. Inside a triangle of samples i, u = Σ w_i·(u_i + ½·∇u_i·d_i) with barycentric weights w_i
    and the vector d_i from sample i, which is exact for a parabola. In the layers the gradients are
    those of the silicone; on the skin they are fitted to neighbouring nodes.

    Parameters
    ----------
    sensor: design of the sensor
    dome: body that contains the layers
    under: places of interest in each layer and on the skin, three arrays (P, 2)
    """

    def __init__(self, sensor: SensorDesign, dome: SoftBody, under: list[Array]) -> None:
        depths = layer_depths(sensor, dome)
        # Largest distance of points that tell how a layer moves, in depths of the layer.
        apart = 1.3
        # Between points farther apart than it is deep a motion is not known.
        finer = max(dome.spacing / 2.0, apart * min(depths))
        inside, nodes = dome.places(min(dome.spacing, finer)), lattice(dome).places
        self._layers = MarkerField(dome, np.broadcast_to(inside, (2, *inside.shape)), depths)
        self._skin = SkinField(dome)
        places, mesh = _with_equator(inside, dome)
        self._weights = [
            _between(sensor, mesh, places, under[sheet], depth)
            for sheet, depth in enumerate(depths)
        ]
        self._corners = np.zeros((2, len(places), 3, 3))  # of each: u and its two slopes
        places, mesh = _with_equator(nodes, dome)
        skin = _between(sensor, mesh, places, under[2], 0.0)
        self._share = skin[:, ::3][:, : len(nodes)]
        self._weights.append(skin @ _slopes(sensor, mesh, places))
        self._moved = np.zeros((len(places), 3))
        self._forces = np.zeros((len(nodes), 3))

    def __call__(self, forces: Array, sheet: int) -> Array:
        """Displacements of a sheet's places [m], (P, 3), for forces on the nodes [N], (N, 3)."""
        if not np.array_equal(self._forces, forces):
            self._forces = forces.copy()
            shift, slope = self._layers(forces)
            self._corners[:, : shift.shape[1], 0] = shift
            self._corners[:, : shift.shape[1], 1:] = np.moveaxis(slope, -1, -2)
            self._moved[: len(forces)] = self._skin(forces)
        if sheet == 2:
            return np.asarray(self._weights[2] @ self._moved)
        return np.asarray(self._weights[sheet] @ self._corners[sheet].reshape(-1, 3))

    def spread(self, values: Array) -> Array:
        """Interpolate values on the nodes of the skin, (N, C), at its places, (P, C)."""
        return np.asarray(self._share @ values)


def _with_equator(places: Array, dome: SoftBody) -> "tuple[Array, scipy.spatial.Delaunay]":
    """Append points of the equator to places, and triangulate all of them."""
    count = 72  # points of the circle where nothing moves: a dome's equator, or one around a pad
    turn = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    equator = np.column_stack([np.full_like(turn, dome.end), turn])
    whole = np.concatenate([places, equator])
    return whole, scipy.spatial.Delaunay(_chart(whole))


def _chart(places: Array) -> Array:
    """Map places (P, 2) to a plane, keeping azimuth and distance from the apex."""
    return places[:, :1] * np.stack([np.cos(places[:, 1]), np.sin(places[:, 1])], axis=-1)


def _between(
    sensor: SensorDesign, mesh: "scipy.spatial.Delaunay", places: Array, wanted: Array, depth: float
) -> "scipy.sparse.csr_matrix":
    """Matrix (P, 3V) from values and derivatives at V `places` to values at P `wanted` ones."""
    skin, at = sensor.shape, _chart(wanted)
    found = mesh.find_simplex(at)
    off = found < 0
    transform = mesh.transform[found]
    part = np.einsum("nij,nj->ni", transform[:, :2], at - transform[:, 2])
    share = np.column_stack([part, 1.0 - part.sum(axis=1)])
    share[off] = 0.0
    corner = mesh.simplices[found]
    way = skin.points(wanted, depth)[:, None] - skin.points(places, depth)[corner]
    along, across = skin.tangents(places)
    half = 0.5 * share
    values = np.stack(
        [
            share,
            half * (way * along[corner]).sum(axis=-1),
            half * (way * across[corner]).sum(axis=-1),
        ],
        axis=-1,
    )
    columns = 3 * corner[..., None] + np.arange(3)
    rows = np.repeat(np.arange(len(wanted)), 9)
    shape = (len(wanted), 3 * len(places))
    return scipy.sparse.csr_matrix((values.ravel(), (rows, columns.ravel())), shape=shape)


def _slopes(
    sensor: SensorDesign, mesh: "scipy.spatial.Delaunay", places: Array
) -> "scipy.sparse.csr_matrix":
    """Matrix (3V, V) that adds derivatives, fitted to neighbours, to V displacements."""
    points = sensor.shape.points(places, 0.0)
    along, across = sensor.shape.tangents(places)
    first, around = mesh.vertex_neighbor_vertices
    rows, columns, values = [3 * np.arange(len(places))], [np.arange(len(places))], []
    values.append(np.ones(len(places)))
    for i in range(len(places)):
        others = around[first[i] : first[i + 1]]
        way = points[others] - points[i]
        plane = np.linalg.pinv(np.column_stack([way @ along[i], way @ across[i]]))
        for k in range(2):
            rows.append(np.full(len(others) + 1, 3 * i + 1 + k))
            columns.append(np.append(others, i))
            values.append(np.append(plane[k], -plane[k].sum()))
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return scipy.sparse.csr_matrix(entries, shape=(3 * len(places), len(places)))


def layer_depths(sensor: SensorDesign, dome: SoftBody) -> tuple[float, float]:
    """Depths of both layers under the skin [m].

    Raises
    ------
    UserError
        For a layer below the silicone.
    """
    first, second = (float(depth) for depth in sensor.depths)
    if max(first, second) > dome.thickness * (1.0 + 1e-9):
        raise UserError(
            f"a layer of markers lies {1e3 * max(first, second):.3g} mm under the skin, below the "
            f"silicone of {1e3 * dome.thickness:.3g} mm"
        )
    return min(first, dome.thickness), min(second, dome.thickness)
