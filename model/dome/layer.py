"""Linear elasticity of a flat layer that is bonded to a rigid base, by waves along it.

A traction proportional to cos(k·x) displaces the layer by the same wave, whose amplitude at any
depth is known in closed form. The displacement for a force that is spread as a bump is the integral
over all waves, with Bessel functions. Young's modulus is 1.
"""

from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

Array = NDArray[np.float64]


def wave_amplitudes(k: Array, thickness: float, poisson: float, depth: float) -> Array:
    """Displacement amplitudes at a depth for unit waves of traction on the skin.

    Parameters
    ----------
    k: wave numbers, above 0, shape (K,)
    depth: depth under the skin

    Returns
    -------
    Shape (5, K). For a normal traction cos kx: u_z over cos kx, u_x over sin kx. For a traction
    sin kx along x: u_z over cos kx, u_x over sin kx. For a traction along y: u_y over it.
    """
    shear = 0.5 / (1.0 + poisson)
    bulky = 2.0 * poisson / (1.0 - 2.0 * poisson)  # λ over the shear modulus
    kappa = 3.0 - 4.0 * poisson
    h = k * thickness

    def fields(z: Array) -> Array:
        """u_x, u_z and their derivatives by k·z for the four solutions, (4 fields, 4, K)."""
        columns = []
        # One part fades from the skin (x = kz), the other from the base (x = kz + kh).
        for s, x in ((1.0, z), (-1.0, z + h)):
            e, one = np.exp(s * x), np.ones_like(x)
            columns.append(e * np.stack([one, -s * one, s * one, -one]))
            columns.append(e * np.stack([x, kappa - s * x, s * x + 1.0, s * kappa - x - s]))
        return np.stack(columns, axis=1)

    top, base = fields(np.zeros_like(k)), fields(-h)
    matrix = np.stack([bulky * (top[0] + top[3]) + 2.0 * top[3], top[2] - top[1], base[0], base[1]])
    loads = np.zeros((len(k), 4, 2))
    loads[:, 0, 0] = loads[:, 1, 1] = 1.0 / (shear * k)
    solution = np.linalg.solve(matrix.transpose(2, 0, 1), loads)
    along, up = np.einsum("fck,kcl->flk", fields(-k * depth)[:2], solution)
    across = (np.exp(-k * depth) - np.exp(k * depth - 2.0 * h)) / (1.0 + np.exp(-2.0 * h))
    return np.stack([up[0], along[0], up[1], along[1], across / (shear * k)])


@lru_cache(maxsize=16)
def layer_motion(
    thickness: float, poisson: float, width: float, reach: float, depth: float
) -> "scipy.interpolate.CubicSpline":
    """Displacement at a depth, against the distance r from a unit force that is spread as a bump.

    Parameters
    ----------
    width: standard deviation of the bump
    reach: largest distance of interest
    depth: depth under the skin

    Returns
    -------
    A function of r with values (…, 5), for a Young's modulus of 1: u_z and u_r for a force along z;
    u_z over cos φ for one along x; and a, b in u = a·f − b·(2·r̂·r̂ᵀ − 1)·f for f along the layer.
    """
    farthest = 20.0  # distance beyond which nothing arrives, in thicknesses
    far = min(farthest * thickness, reach)
    step_share = 0.25  # distances are tabulated in steps of this share of the bump's width
    step = step_share * width
    before = 5  # steps on the other side of 0, for the spline
    r = np.arange(-before, int(np.ceil(far / step)) + before) * step
    shortest = 6.0  # waves shorter than this many widths of a bump are left out: k·width
    most = shortest / width
    edges = np.linspace(0.0, most, int(np.ceil(most * max(far, thickness) / (2.0 * np.pi))) + 1)
    points, weights = np.polynomial.legendre.leggauss(8)
    half = 0.5 * np.diff(edges)[:, None]
    k = (half * points + 0.5 * (edges[1:] + edges[:-1])[:, None]).ravel()
    share = (half * weights).ravel() * k * np.exp(-0.5 * (k * width) ** 2) / (2.0 * np.pi)
    zz, xz, zx, xx, yy = wave_amplitudes(k, thickness, poisson, depth)
    values = np.empty((len(r), 5))
    for rows in np.array_split(np.arange(len(r)), max(1, len(r) // 100)):
        kr = np.outer(r[rows], k)
        even, odd = scipy.special.j0(kr), scipy.special.j1(kr)
        double = np.divide(2.0 * odd, kr, out=np.ones_like(kr), where=kr != 0.0) - even
        values[rows, 0] = even @ (share * zz)
        values[rows, 1] = odd @ (share * xz)
        values[rows, 2] = odd @ (-share * zx)
        values[rows, 3] = even @ (0.5 * share * (xx + yy))
        values[rows, 4] = double @ (0.5 * share * (xx - yy))
    return scipy.interpolate.CubicSpline(r, values)


def layer_moved(motion: "scipy.interpolate.CubicSpline", way: Array) -> Array:
    """Displacement (x, y, z) for unit forces along x, y and z.

    Parameters
    ----------
    motion: result of `layer_motion`
    way: vector along the layer from the force to the place, shape (…, 2)

    Returns
    -------
    Shape (…, 3, 3): displacement × force.
    """
    r, x, y = _apart(way)
    uz, ur, zx, a, b = np.moveaxis(motion(r) * (r < motion.x[-1])[..., None], -1, 0)
    return _parts(a, b, _doubled(x, y), ur, zx, uz, (x, y))


def layer_slopes(motion: "scipy.interpolate.CubicSpline", way: Array) -> Array:
    """Derivatives of `layer_moved` with respect to x and y, shape (…, 3, 3, 2)."""
    r, x, y = _apart(way)
    on = (r < motion.x[-1])[..., None]
    r = np.maximum(r, 1e-6 * motion.x[-1])  # at 0 what is over r is a slope
    _, ur, zx, _, b = np.moveaxis(motion(r) * on, -1, 0) / r
    uz_r, ur_r, zx_r, a_r, b_r = np.moveaxis(motion(r, 1) * on, -1, 0)
    cos, sin = _doubled(x, y)
    none = np.zeros_like(r)
    # Along r̂, and across it, where r̂ turns by 1/r.
    outwards = _parts(a_r, b_r, (cos, sin), ur_r, zx_r, uz_r, (x, y))
    around = _parts(none, 2.0 * b, (-sin, cos), ur, zx, none, (-y, x))
    along = np.stack([x, y, -y, x], axis=-1).reshape(*r.shape, 1, 1, 2, 2)
    return outwards[..., None] * along[..., 0, :] + around[..., None] * along[..., 1, :]


def _parts(
    a: Array, b: Array, double: tuple[Array, Array], ur: Array, zx: Array, uz: Array,
    unit: tuple[Array, Array],
) -> Array:  # fmt: skip
    """Assemble displacement × force, shape (…, 3, 3), from the parts of `layer_motion`."""
    (cos, sin), (x, y) = double, unit
    rows = [[a - b * cos, -b * sin, ur * x], [-b * sin, a + b * cos, ur * y], [zx * x, zx * y, uz]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _doubled(x: Array, y: Array) -> tuple[Array, Array]:
    """Cosine and sine of twice the azimuth of unit vectors."""
    return 2.0 * x * x - 1.0, 2.0 * x * y


def _apart(way: Array) -> tuple[Array, Array, Array]:
    """Length r of vectors (…, 2), and the components x and y of their unit vectors."""
    r = np.hypot(way[..., 0], way[..., 1])
    some = np.where(r > 0.0, r, 1.0)
    return r, np.where(r > 0.0, way[..., 0] / some, 1.0), way[..., 1] / some
