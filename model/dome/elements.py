"""Linear elasticity of a body of revolution, by harmonics about its axis and finite elements.

With u_r = U cos mφ, u_φ = V sin mφ and u_z = W cos mφ each harmonic m is a separate problem in the
meridian plane, with stiffness A + m·B + m²·C. Lengths are in units of the radius and Young's
modulus is 1, so that results depend only on shape and Poisson's ratio.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
import scipy
from numpy.typing import NDArray

Array = NDArray[np.float64]


def _quadratic(x: float) -> tuple[Array, Array]:
    """Shape functions of a quadratic element at −1 ≤ x ≤ 1 and their derivatives, both (3,)."""
    return (
        np.array([x * (x - 1.0) / 2.0, 1.0 - x * x, x * (x + 1.0) / 2.0]),
        np.array([x - 0.5, -2.0 * x, x + 0.5]),
    )


@dataclass(frozen=True, kw_only=True)
class Meridian:
    """Elements of the meridian plane, and stiffness matrices of every harmonic.

    There are E elements along the skin, L node levels from core to skin, and n unknowns.

    Attributes
    ----------
    edges: angles of the element borders along the skin [rad], shape (E + 1,)
    stations: angles of the nodes [rad], shape (2E + 1,)
    radii: radii of the nodes over that of the skin, shape (L,); the last is the skin
    parts: A, B and C as lower bands of width W, shape (3, W, n)
    first: stiffness of harmonic 1 as a lower band, shape (W, n); on the axis the second unknown of
        a node is U + V, which must vanish there
    held: whether an unknown belongs to a fixed node on core or base, shape (n,)
    """

    edges: Array
    stations: Array
    radii: Array
    parts: Array
    first: Array
    held: NDArray[np.bool_]

    @property
    def skin(self) -> NDArray[np.int64]:
        """Indices of the nodes of the skin, from the apex to the base, shape (2E + 1,)."""
        levels = len(self.radii)
        return np.arange(len(self.stations)) * levels + levels - 1


def mesh(core: float, poisson: float, width: float, reach: float) -> Meridian:
    """Make elements of a half sphere of radius 1 over a core, fine enough for the loads.

    Parameters
    ----------
    core: radius of the rigid core
    poisson: Poisson's ratio
    width: width of the loads, see `loads`
    reach: angle from the apex up to which there are loads [rad]
    """
    finest = 1.1  # finest element at the skin, in widths of a load
    fine = finest * width
    inner = min(reach + 3.0 * width, np.pi / 2)
    edges = np.linspace(0.0, inner, math.ceil(inner / fine) + 1)
    if np.pi / 2 - inner > 1e-9:
        edges = np.concatenate([edges, inner + _graded(fine, np.pi / 2 - inner)[1:]])
    depths = _graded(fine, 1.0 - core)
    stations, radii = _with_middles(edges), _with_middles(1.0 - depths[::-1])
    levels = len(radii)
    places = np.stack(
        [np.outer(np.sin(stations), radii), np.outer(np.cos(stations), radii)], axis=-1
    ).reshape(-1, 2)
    along, across = np.meshgrid(
        np.arange(len(edges) - 1), np.arange(len(depths) - 1), indexing="ij"
    )
    corner = (2 * along * levels + 2 * across).ravel()
    nodes = corner[:, None] + np.add.outer(np.arange(3) * levels, np.arange(3)).ravel()
    matrices = _element_matrices(places[nodes], poisson)
    unknowns = (3 * nodes[:, :, None] + np.arange(3)).reshape(len(nodes), 27)
    # On the axis U + V = 0: with that sum as unknown in V's place it can be held like any other.
    first = matrices.sum(axis=0)
    on_axis = np.flatnonzero(np.repeat(np.arange(3), 3) == 0)
    at_apex = np.flatnonzero(along.ravel() == 0)
    for a in on_axis:
        first[at_apex, :, 3 * a] -= first[at_apex, :, 3 * a + 1]
        first[at_apex, 3 * a, :] -= first[at_apex, 3 * a + 1, :]
    node = np.arange(len(places))
    held = (node % levels == 0) | (node // levels == len(stations) - 1)
    size = 3 * len(places)
    return Meridian(
        edges=edges,
        stations=stations,
        radii=radii,
        parts=np.stack([_band(part, unknowns, size) for part in matrices]),
        first=_band(first, unknowns, size),
        held=np.repeat(held, 3),
    )


def _graded(first: float, whole: float) -> Array:
    """Borders from 0 to `whole` of elements whose sizes grow from about `first`."""
    steps = [first]
    # Growth of the elements from the skin to the core, and along the skin beyond the loads.
    growth = 1.35
    while sum(steps) < whole:
        steps.append(growth * steps[-1])
    return np.concatenate([[0.0], np.cumsum(steps)]) * whole / sum(steps)


def _with_middles(borders: Array) -> Array:
    """Borders of elements, with their middles in between."""
    places = np.empty(2 * len(borders) - 1)
    places[::2] = borders
    places[1::2] = (borders[1:] + borders[:-1]) / 2
    return places


def _element_matrices(corners: Array, poisson: float) -> Array:
    """Matrices A, B and C of E elements from their nodes (E, 9, 2), shape (3, E, 27, 27)."""
    lame = poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
    shear = 0.5 / (1.0 + poisson)
    law = np.diag([2.0 * shear] * 3 + [shear] * 3)
    law[:3, :3] += lame
    points, weights = np.polynomial.legendre.leggauss(3)
    count = len(corners)
    parts = np.zeros((3, count, 27, 27))
    u, v, w = slice(0, 27, 3), slice(1, 27, 3), slice(2, 27, 3)
    for x, weight_x in zip(points, weights, strict=True):
        for y, weight_y in zip(points, weights, strict=True):
            (values_x, slopes_x), (values_y, slopes_y) = _quadratic(x), _quadratic(y)
            values = np.outer(values_x, values_y).ravel()
            slopes = np.stack(
                [np.outer(slopes_x, values_y).ravel(), np.outer(values_x, slopes_y).ravel()]
            )
            jacobian = np.einsum("ka,eaj->ekj", slopes, corners)
            gradient = np.linalg.solve(jacobian, np.broadcast_to(slopes, (count, 2, 9)))
            rho = corners[:, :, 0] @ values
            over = values / rho[:, None]
            # Strains rr, zz, φφ, rz, rφ, zφ: `even` of the harmonic, and `odd` times m.
            even, odd = np.zeros((count, 6, 27)), np.zeros((count, 6, 27))
            even[:, 0, u] = gradient[:, 0]
            even[:, 1, w] = gradient[:, 1]
            even[:, 2, u] = over
            odd[:, 2, v] = over
            even[:, 3, u] = gradient[:, 1]
            even[:, 3, w] = gradient[:, 0]
            odd[:, 4, u] = -over
            even[:, 4, v] = gradient[:, 0] - over
            even[:, 5, v] = gradient[:, 1]
            odd[:, 5, w] = -over
            volume = (abs(np.linalg.det(jacobian)) * rho * weight_x * weight_y)[:, None, None]
            stress_even, stress_odd = law @ even, law @ odd
            even_t, odd_t = even.transpose(0, 2, 1), odd.transpose(0, 2, 1)
            parts[0] += volume * (even_t @ stress_even)
            parts[1] += volume * (even_t @ stress_odd + odd_t @ stress_even)
            parts[2] += volume * (odd_t @ stress_odd)
    return parts


def _band(matrices: Array, unknowns: NDArray[np.int64], size: int) -> Array:
    """Lower band (W, n) of the sum of element matrices (E, 27, 27)."""
    rows = np.repeat(unknowns, 27, axis=1).ravel()
    columns = np.tile(unknowns, (1, 27)).ravel()
    lower = rows >= columns
    width = int((rows - columns).max()) + 1
    band = np.bincount(
        (rows - columns)[lower] * size + columns[lower],
        weights=matrices.ravel()[lower],
        minlength=width * size,
    )
    return np.asarray(band, np.float64).reshape(width, size)


def loads(meridian: Meridian, rings: Array, width: float) -> Callable[[int], Array]:
    """Load vectors of unit forces along x, y and z at φ = 0 on each ring, for each harmonic.

    A force is spread as exp(κ·cos α), with the angle α from its place and κ = 1/width²: a smooth
    bump that is regular at the apex, and whose harmonics are Bessel functions.

    Parameters
    ----------
    rings: angles of the K rings from the apex [rad], shape (K,)
    width: standard deviation of the bump [rad]

    Returns
    -------
    Function of the number m of a harmonic, with values of shape (n, K, 3). The force along y is
    that of the mirrored problem, with −V for V.
    """
    sharpness = 1.0 / width**2
    points, weights = np.polynomial.legendre.leggauss(4)
    half = np.diff(meridian.edges) / 2
    angles = ((meridian.edges[1:] + meridian.edges[:-1]) / 2)[:, None] + half[:, None] * points
    share = half[:, None] * weights * np.sin(angles)
    spread = sharpness * np.sin(angles)[..., None] * np.sin(rings)
    height = np.exp(sharpness * (np.cos(angles[..., None] - rings) - 1.0))
    height *= sharpness / (2.0 * np.pi * -np.expm1(-2.0 * sharpness)) * share[..., None]

    @lru_cache(maxsize=3)  # a harmonic and its neighbours, of which the next one needs two
    def part(m: int) -> Array:
        return np.asarray(height * scipy.special.ive(m, spread))

    return partial(_loads_of, meridian, rings, part, [_quadratic(point)[0] for point in points])


def _loads_of(
    meridian: Meridian, rings: Array, part: Callable[[int], Array], shapes: list[Array], m: int
) -> Array:
    """Loads of a harmonic m, of which `part` has the shares of each point of an element."""
    if m == 0:
        columns = {(0, 0): part(1), (2, 2): part(0), (1, 1): -part(1)}
    else:
        below, above = part(m - 1), part(m + 1)
        columns = {
            (0, 0): below + above, (0, 1): above - below, (1, 0): below - above,
            (1, 1): -below - above, (2, 2): 2.0 * part(m),
        }  # fmt: skip
    factor = np.pi * (2.0 if m == 0 else 1.0)
    skin, elements = meridian.skin, len(meridian.edges) - 1
    work = np.zeros((len(meridian.held), len(rings), 3))
    for (force, component), values in columns.items():
        for k, each in enumerate(shapes):
            for a, shape in enumerate(each):
                # Elements share the nodes at their borders, but no two of one `a` do.
                work[3 * skin[a : a + 2 * elements : 2] + component, :, force] += (
                    factor * shape * values[:, k]
                )
    if m == 1:  # in the unknowns of `Meridian.first`
        axis = np.arange(len(meridian.radii))
        work[3 * axis] -= work[3 * axis + 1]
    return work


def half_solved(meridian: Meridian, harmonic: int, work: Array) -> Array:
    """Solve L·Y = loads with the stiffness L·Lᵀ; YᵀY are the displacements of loads by each other.

    Parameters
    ----------
    work: loads as columns, shape (n, …)
    """
    columns, held = work.reshape(len(work), -1).copy(), _held(meridian, harmonic)
    columns[held] = 0.0
    return _through(_factor(meridian, harmonic, held), columns, "N")


def solved(meridian: Meridian, harmonic: int, work: Array) -> Array:
    """Solve for the displacement (U, V, W) of every node of the meridian.

    Parameters
    ----------
    work: loads as columns, shape (n, …)

    Returns
    -------
    Shape (stations, levels, 3, columns).
    """
    columns, held = work.reshape(len(work), -1).copy(), _held(meridian, harmonic)
    columns[held] = 0.0
    factor = _factor(meridian, harmonic, held)
    whole = _through(factor, _through(factor, columns, "N"), "T")
    levels = len(meridian.radii)
    shape = whole.reshape(len(meridian.stations), levels, 3, -1)
    if harmonic == 1:  # from the unknowns of `Meridian.first`
        shape[0, :, 1] -= shape[0, :, 0]
    return shape


def _held(meridian: Meridian, harmonic: int) -> NDArray[np.bool_]:
    """Mask of the unknowns that vanish in a harmonic, shape (n,)."""
    held = meridian.held.copy()
    axis = 3 * np.arange(len(meridian.radii))
    for component in ((0, 1), (1, 2), (0, 1, 2))[min(harmonic, 2)]:
        held[axis + component] = True
    return held


def _factor(meridian: Meridian, harmonic: int, held: NDArray[np.bool_]) -> Array:
    """Cholesky factor of the stiffness of a harmonic, as a lower band."""
    m = harmonic
    if m == 1:
        band = np.pi * meridian.first
    else:
        a, b, c = meridian.parts
        band = np.pi * (2.0 if m == 0 else 1.0) * (a + m * b + m * m * c)
    size = len(held)
    for k in range(1, len(band)):
        band[k, : size - k][held[: size - k] | held[k:]] = 0.0
    band[0, held] = band[0].max()
    return np.asarray(
        scipy.linalg.cholesky_banded(band, lower=True, overwrite_ab=True, check_finite=False)
    )


def _through(factor: Array, columns: Array, side: str) -> Array:
    """Solve with the Cholesky factor ("N"), or with its transpose ("T")."""
    half, info = scipy.linalg.lapack.dtbtrs(factor, columns, uplo="L", trans=side)
    assert info == 0
    return np.asarray(half)
