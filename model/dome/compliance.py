"""Compliance of the skin of a dome: a table over pairs of rings, made once for each shape and ν."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...kept_arrays import content_key, keep, kept
from .dome import Dome, lattice
from .elements import half_solved, loads, mesh

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
#: Folder of the user's cache; its tables are made anew when the version changes.
_KIND, _VERSION = "domes", "dome compliance 2"


def nothing(done: int, total: int) -> None:
    """Progress that nobody asked for."""


@lru_cache(maxsize=4)
def compliance_table(dome: Dome, progress: Callable[[int, int], None] = nothing) -> Table:
    """Displacements of the skin for forces on it, over pairs of rings and the angle between nodes.

    The first call for a shape and ν solves its elasticity, which takes some seconds; the table is
    then kept in the user's cache folder.

    Parameters
    ----------
    progress: called with the harmonics that are done and all of them

    Returns
    -------
    float32, shape (P, K, 9): pairs of rings, angles from 0 to π with one step before and two after,
    and components (r, φ, z) × (r, φ, z); in units of 1/(E·R), see `compliance_scale`.
    """
    angles = lattice(dome).angles
    key = content_key(_VERSION, np.array(_shape(dome)), np.array(angles))
    found = kept(_KIND, key)
    if found is None:
        found = {"table": make_table(dome, progress)}
        keep(_KIND, key, found)
    table = np.asarray(found["table"], np.float32)
    table.setflags(write=False)
    return table


def _shape(dome: Dome) -> tuple[float, float, float]:
    """Core over radius, ν, and width of a load [rad]."""
    return round(dome.core / dome.radius, 9), dome.poisson, WIDTH * dome.spacing / dome.radius


def compliance_scale(dome: Dome) -> float:
    """Metres per newton of a unit of the table."""
    return 1.0 / (dome.young * dome.radius)


def make_table(dome: Dome, progress: Callable[[int, int], None] = nothing) -> Table:
    """As `compliance_table`, made anew."""
    core, poisson, width = _shape(dome)
    rings = lattice(dome).angles
    harmonics = int(np.ceil(_HARMONICS * np.sin(rings[-1]) / width))
    meridian = mesh(core, poisson, width, rings[-1])
    low, high = np.triu_indices(len(rings))
    energies = np.empty((harmonics + 1, len(low), 3, 3))
    for m in range(harmonics + 1):
        progress(m, harmonics + 1)
        half = half_solved(meridian, m, loads(meridian, rings, width, m))
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
