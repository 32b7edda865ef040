"""Motion inside a dome: harmonics summed into columns, and columns times forces."""

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit
from .compliance_kernels import SkinCompliance, pair_block

Array = NDArray[np.float64]
Column = NDArray[np.float32]


@njit()
def fill_column(
    waves: Column,
    slopes: Column,
    row: NDArray[np.int64],
    angles: Array,
    azimuths: Array,
    azimuth: float,
    along: float,
    out: Column,
) -> None:
    """Displacement and gradient of markers of one layer for unit forces on one node.

    Parameters
    ----------
    waves, slopes: of U, V, W (for forces along r, φ, z) and their derivatives by the angle from
        the apex, shape (A, H, 9), component by component
    row: of `waves` of each marker, shape (M,)
    angles, azimuths: of the markers [rad], shape (M,); no marker lies on the axis
    azimuth: of the node [rad]
    along: 1 over the radius of the layer [1/m]
    out: for forces x, y, z: x, y, z of the displacement, then for each of them its slopes along θ
        and φ, shape (3, M, 9)
    """
    value, by_angle, by_turn = np.empty(9), np.empty(9), np.empty(9)
    f, g = np.empty(9), np.empty(9)
    for i in range(row.size):
        value[:] = 0.0
        by_angle[:] = 0.0
        by_turn[:] = 0.0
        wave, slope = waves[row[i]], slopes[row[i]]
        turn = azimuths[i] - azimuth
        step_c, step_s = np.cos(turn), np.sin(turn)
        c, s = 1.0, 0.0
        for m in range(wave.shape[0]):
            # u_r and u_z of forces r and z go with the cosine, u_φ with the sine; a force along φ
            # is that of the mirrored problem.
            f[0] = f[2] = f[6] = f[8] = c
            g[0] = g[2] = g[6] = g[8] = -m * s
            f[1] = f[3] = f[5] = f[7] = s
            g[1] = g[3] = g[5] = g[7] = m * c
            f[4] = -c
            g[4] = m * s
            for k in range(9):
                value[k] += f[k] * wave[m, k]
                by_angle[k] += f[k] * slope[m, k]
                by_turn[k] += g[k] * wave[m, k]
            c, s = c * step_c - s * step_s, s * step_c + c * step_s
        _turned(value, by_angle, by_turn, angles[i], azimuths[i], azimuth, along, out[:, i])


@njit()
def _turned(
    value: Array,
    by_angle: Array,
    by_turn: Array,
    angle: float,
    own: float,
    azimuth: float,
    along: float,
    out: Column,
) -> None:
    """From components (r, φ, z) × forces (r, φ, z) to x, y, z of both, into `out` (3, 9)."""
    c, s = np.cos(own), np.sin(own)
    c0, s0 = np.cos(azimuth), np.sin(azimuth)
    across = along / np.sin(angle)
    part = np.empty((3, 3, 3))  # force r, φ, z; component x, y, z; value and its two slopes
    for b in range(3):
        r, p = value[b], value[3 + b]
        for k in range(3):
            if k == 0:
                u, v, w, scale = r, p, value[6 + b], 1.0
            elif k == 1:
                u, v, w, scale = by_angle[b], by_angle[3 + b], by_angle[6 + b], along
            else:  # the directions r and φ turn with the azimuth
                u, v, w, scale = by_turn[b] - p, by_turn[3 + b] + r, by_turn[6 + b], across
            part[b, 0, k] = scale * (c * u - s * v)
            part[b, 1, k] = scale * (s * u + c * v)
            part[b, 2, k] = scale * w
    for a in range(3):
        for k in range(3):
            at = a if k == 0 else 2 + 2 * a + k
            out[0, at] = c0 * part[0, a, k] - s0 * part[1, a, k]
            out[1, at] = s0 * part[0, a, k] + c0 * part[1, a, k]
            out[2, at] = part[2, a, k]


@njit()
def add_columns(
    columns: NDArray[np.float32],
    slots: NDArray[np.int64],
    forces: Array,
    out: NDArray[np.float32],
) -> None:
    """Columns (S, 3, V) of these slots times forces (n, 3), into `out` (V,); four at once."""
    out[:] = 0.0
    single = forces.astype(np.float32)
    i = 0
    while i + 4 <= slots.size:
        a, b, c, d = (
            columns[slots[i]], columns[slots[i + 1]], columns[slots[i + 2]], columns[slots[i + 3]]
        )  # fmt: skip
        f, g, h, k = single[i], single[i + 1], single[i + 2], single[i + 3]
        for v in range(out.size):
            part = out[v] + (f[0] * a[0, v] + f[1] * a[1, v] + f[2] * a[2, v])
            part += g[0] * b[0, v] + g[1] * b[1, v] + g[2] * b[2, v]
            part += h[0] * c[0, v] + h[1] * c[1, v] + h[2] * c[2, v]
            out[v] = part + (k[0] * d[0, v] + k[1] * d[1, v] + k[2] * d[2, v])
        i += 4
    while i < slots.size:
        a, f = columns[slots[i]], single[i]
        for v in range(out.size):
            out[v] += f[0] * a[0, v] + f[1] * a[1, v] + f[2] * a[2, v]
        i += 1


@njit()
def fill_skin_columns(
    skin: SkinCompliance, nodes: NDArray[np.int64], out: NDArray[np.float32]
) -> None:
    """Displacement of all nodes of the skin for unit forces on some, into (n, 3, 3·N)."""
    block = np.empty((3, 3))
    for j in range(nodes.size):
        for i in range(skin.ring.size):
            pair_block(skin, i, nodes[j], block)
            for a in range(3):
                for b in range(3):
                    out[j, b, 3 * i + a] = skin.scale * block[a, b]
