"""Compliance of the skin: a table over pairs of node rings, made once for each shape and ν."""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...kept_arrays import content_key, kept_or_made
from ..kernels.dome.compliance_kernels import SkinCompliance
from .dome import Dome, Pad, SoftBody, lattice
from .elements import half_solved, loads, mesh
from .layer import layer_motion, layer_moved

Array = NDArray[np.float64]
Table = NDArray[np.float32]

#: Width of the load of a node's force, in pitches h. On a half space, whose point force
#: F moves what is r away by c·F/r, it moves itself by √π/(2·WIDTH)·c·F/h; a disc of the node's area
#: under uniform pressure by 16/(3·√π)·c·F/h, which makes WIDTH 0.295. With 0.5 contacts of two to
#: four nodes' radius were 4 to 14 % too stiff.
WIDTH = 0.3
#: Harmonics for each unit of 1/(width of a load): beyond them a load has less than a thousandth.
_HARMONICS = 2.45
#: Steps of the table in half a turn, for each harmonic.
_STEPS = 5.3


def nothing(done: int, total: int) -> None:
    """Ignore progress."""


@lru_cache(maxsize=4)
def compliance_table(body: SoftBody, progress: Callable[[int, int], None] = nothing) -> Table:
    """Displacements of the skin for unit forces, over pairs of rings and the angle between nodes.

    The first call for a shape and ν of a dome solves its elasticity, which takes some seconds; the
    table is then stored in the user's cache folder. A pad's table takes a second and is not stored.

    Parameters
    ----------
    body: dome or pad
    progress: function called with the numbers of finished and of all harmonics

    Returns
    -------
    float32, shape (P, K, 9): P pairs of rings; K angles, from 0 to π with one step before and two
    after; and components (r, φ, z) of displacement × force, in units of `compliance_scale`.
    """
    table = _TABLES[type(body)](body, progress)
    table.setflags(write=False)
    return table


def _kept_table(dome: Dome, progress: Callable[[int, int], None]) -> Table:
    """Table of a dome, from the user's cache folder if it is there."""
    version = "dome compliance 2"
    key = content_key(version, np.array(_shape(dome)), np.array(lattice(dome).angles))
    kind = "domes"  # folder of the user's cache; its tables are made anew when the version changes
    found = kept_or_made(kind, key, lambda: {"table": make_table(dome, progress)})
    return np.asarray(found["table"], np.float32)


def _shape(dome: Dome) -> tuple[float, float, float]:
    """Core over radius, ν, and width of a load [rad]."""
    return round(dome.core / dome.radius, 9), dome.poisson, WIDTH * dome.spacing / dome.radius


def compliance_scale(body: SoftBody) -> float:
    """Unit of the table, 1/(E·R) [m/N]."""
    return 1.0 / (body.young * body.radius)


def skin_compliance(body: SoftBody) -> SkinCompliance:
    """Compliance among all nodes of a body's skin."""
    nodes = lattice(body)
    table, scale = compliance_table(body), compliance_scale(body)
    return SkinCompliance(table, len(nodes.angles), nodes.ring, nodes.azimuth, scale)


def _pad_table(pad: Pad, progress: Callable[[int, int], None]) -> Table:
    """Table of a pad, where displacement depends only on the vector from the force."""
    rings = lattice(pad).angles / pad.radius
    width = WIDTH * pad.spacing / pad.radius
    # Spread as a bump where it acts, and weighed with that bump where it moves the skin.
    motion = layer_motion(pad.thickness / pad.radius, pad.poisson, math.sqrt(2.0) * width, 2.5, 0.0)
    steps = int(np.ceil(_STEPS * _HARMONICS * rings[-1] / width))
    turns = np.arange(-1, steps + 3) * np.pi / steps
    c, s = np.cos(turns), np.sin(turns)
    table = np.empty((len(rings) * (len(rings) + 1) // 2, steps + 4, 3, 3), np.float32)
    low, high = np.triu_indices(len(rings))
    for pair, (i, j) in enumerate(zip(low, high, strict=True)):
        block = layer_moved(motion, np.stack([rings[i] * c - rings[j], rings[i] * s], axis=-1))
        x, y = block[:, 0].copy(), block[:, 1].copy()
        block[:, 0], block[:, 1] = c[:, None] * x + s[:, None] * y, c[:, None] * y - s[:, None] * x
        table[pair] = block
    return table.reshape(len(table), steps + 4, 9)


def make_table(dome: Dome, progress: Callable[[int, int], None] = nothing) -> Table:
    """Compute the table of a dome, see `compliance_table`, without the cache."""
    core, poisson, width = _shape(dome)
    rings = lattice(dome).angles
    harmonics = int(np.ceil(_HARMONICS * np.sin(rings[-1]) / width))
    meridian = mesh(core, poisson, width, rings[-1])
    low, high = np.triu_indices(len(rings))
    load = loads(meridian, rings, width)
    energies = np.empty((harmonics + 1, len(low), 3, 3))
    for m in range(harmonics + 1):
        progress(m, harmonics + 1)
        half = half_solved(meridian, m, load(m))
        whole = (half.T @ half).reshape(len(rings), 3, len(rings), 3)
        energies[m] = whole[low, :, high, :]
    progress(harmonics + 1, harmonics + 1)
    steps = int(np.ceil(_STEPS * harmonics))
    turns = np.outer(np.arange(-1, steps + 3) * np.pi / steps, np.arange(harmonics + 1))
    table = np.empty((len(low), steps + 4, 3, 3), np.float32)
    even, odd = np.cos(turns), np.sin(turns)
    # A force along y is that of the mirrored problem: what it does to x and z goes with the sine.
    for a in range(3):
        for b in range(3):
            wave = even if (a == 1) == (b == 1) else odd if b == 1 else -odd
            table[:, :, a, b] = (wave @ energies[:, :, a, b]).T
    return table.reshape(len(low), steps + 4, 9)


#: What makes the table of each kind of body.
_TABLES: dict[type[SoftBody], Callable[[Any, Callable[[int, int], None]], Table]] = {
    Dome: _kept_table,
    Pad: _pad_table,
}
