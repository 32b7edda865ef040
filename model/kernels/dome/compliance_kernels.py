"""Compliance of two nodes of a dome, from a table over their rings and the angle between them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit

Array = NDArray[np.float64]


class SkinCompliance(NamedTuple):
    """Compliance among all nodes of a skin.

    Attributes
    ----------
    table: of `compliance.compliance_table`, float32 (P, K + 3, 9)
    rings: number of rings
    ring, azimuth: of each node [1, rad], shape (N,)
    scale: metres per newton of a unit of the table
    """

    table: NDArray[np.float32]
    rings: int
    ring: NDArray[np.int64]
    azimuth: Array
    scale: float


@njit()
def pair_index(low: int, high: int, rings: int) -> int:
    """Row of the table for rings low ≤ high."""
    return low * rings - low * (low - 1) // 2 + high - low


@njit()
def node_block(
    table: Array,
    rings: int,
    ring_i: int,
    azimuth_i: float,
    ring_j: int,
    azimuth_j: float,
    out: Array,
) -> None:
    """Displacement (x, y, z) of node i for unit forces (x, y, z) on node j, into `out` (3, 3).

    Parameters
    ----------
    table: of `compliance.compliance_table`, float32 (P, K + 3, 9): K steps from 0 to π and one more
        on either side of them, one beyond
    """
    steps = table.shape[1] - 4
    turn = azimuth_i - azimuth_j
    swap = ring_i > ring_j
    if swap:
        turn = -turn
        pair = pair_index(ring_j, ring_i, rings)
    else:
        pair = pair_index(ring_i, ring_j, rings)
    turn -= 2.0 * np.pi * np.floor(turn / (2.0 * np.pi) + 0.5)  # −π … π
    sign = 1.0
    if turn < 0.0:  # what changes sign with the angle
        sign, turn = -1.0, -turn
    place = turn * (steps / np.pi)
    k = min(int(place), steps - 1)
    x = place - k
    # Cubic through four neighbouring steps
    w0 = -x * (x - 1.0) * (x - 2.0) / 6.0
    w1 = (x + 1.0) * (x - 1.0) * (x - 2.0) / 2.0
    w2 = -(x + 1.0) * x * (x - 2.0) / 2.0
    w3 = (x + 1.0) * x * (x - 1.0) / 6.0
    four = table[pair, k : k + 4]
    for a in range(3):
        for b in range(3):
            c = 3 * a + b
            value = w0 * four[0, c] + w1 * four[1, c] + w2 * four[2, c] + w3 * four[3, c]
            if (a == 1) != (b == 1):
                value *= sign
            if swap:
                out[b, a] = value
            else:
                out[a, b] = value
    _turn_rows(out, azimuth_i)
    _turn_columns(out, azimuth_j)


@njit()
def _turn_rows(block: Array, azimuth: float) -> None:
    c, s = np.cos(azimuth), np.sin(azimuth)
    for b in range(3):
        x, y = block[0, b], block[1, b]
        block[0, b], block[1, b] = c * x - s * y, s * x + c * y


@njit()
def _turn_columns(block: Array, azimuth: float) -> None:
    c, s = np.cos(azimuth), np.sin(azimuth)
    for a in range(3):
        x, y = block[a, 0], block[a, 1]
        block[a, 0], block[a, 1] = c * x - s * y, s * x + c * y


@njit()
def pair_block(skin: SkinCompliance, p: int, q: int, out: Array) -> None:
    """`node_block` of nodes p and q, in units of the table."""
    node_block(
        skin.table, skin.rings, skin.ring[p], skin.azimuth[p], skin.ring[q], skin.azimuth[q], out
    )


@njit()
def fill_block(skin: SkinCompliance, nodes: NDArray[np.int64], first: int, out: Array) -> None:
    """Compliance among nodes (n,), into the leading square of `out`, float32 (3n, 3n) at least.

    Those before `first` are there.
    """
    block = np.empty((3, 3))
    for i in range(first, nodes.size):
        for j in range(i + 1):
            pair_block(skin, nodes[i], nodes[j], block)
            for a in range(3):
                for b in range(3):
                    out[3 * i + a, 3 * j + b] = skin.scale * block[a, b]
                    out[3 * j + b, 3 * i + a] = skin.scale * block[a, b]


@njit()
def displace(
    skin: SkinCompliance,
    loaded: NDArray[np.int64],
    forces: Array,
    nodes: NDArray[np.int64],
    out: Array,
) -> None:
    """Displacement of `nodes` by forces (N, 3) on the `loaded` ones, into rows of `out` (N, 3)."""
    block = np.empty((3, 3))
    for i in range(nodes.size):
        p = nodes[i]
        total = np.zeros(3)
        for j in range(loaded.size):
            q = loaded[j]
            pair_block(skin, p, q, block)
            for a in range(3):
                total[a] += (
                    block[a, 0] * forces[q, 0]
                    + block[a, 1] * forces[q, 1]
                    + block[a, 2] * forces[q, 2]
                )
        for a in range(3):
            out[p, a] = skin.scale * total[a]
