"""Defects of a specimen's markers."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..design.dials import Defects
from ..design.sensor import SensorDesign
from ..membrane import Membrane

Array = NDArray[np.float64]

# Numbers of random streams, one for each defect, so that no dial changes another one's draws. They
# stand last in a seed and start at 1: NumPy ignores trailing zeros of a seed.
LEDS = 1
DUST = 2
SPECULAR = 3
NOISE = 4
WHITE_BALANCE = 5
GAIN = 6
MISSING = 7
MISALIGNMENT = 8
MISPLACEMENT = 9
WORN = 10
CROOKEDNESS = 11
GORES = 12
RUBBED = 13
SEAMS = 14
BLOTCHES = 15
GRAIN = 16
THREADS = 17

#: Gores of a skin whose design has no seams.
GORE_COUNT = 4


class Flaws:
    """Defects of the markers of one specimen: misplaced along the skin, rubbed off, or missing.

    Parameters
    ----------
    sensor: design
    defects: their sizes
    seed: of the run; one seed is one specimen

    Attributes
    ----------
    places: of the markers of each layer, see `skin`, shape (2, M, 2); None is as designed
    missing: whether a marker is missing, shape (2, M)
    """

    _kept: Array | None = None
    _towards: NDArray[np.intp]

    def __init__(self, sensor: SensorDesign, defects: Defects, seed: int) -> None:
        count = len(sensor.places)
        self.places: Array | None = None
        d = defects
        if d.misplacement_mm or d.misalignment_mm or d.crookedness_mm or d.gore_misalignment_mm:
            self.places = _misplaced(sensor, defects, seed)
        self.missing = np.zeros((2, count), dtype=np.bool_)
        absent = round(defects.missing_markers * count)
        for layer in range(2):
            order = np.random.default_rng([seed, layer, MISSING]).permutation(count)
            self.missing[layer, order[:absent]] = True
        # Half as far from the middle, or half as far again: the edge is ragged.
        ragged = np.random.default_rng([seed, WORN]).uniform(0.5, 1.5, count)
        nearest = np.argsort(sensor.places[:, 0] * ragged, kind="stable")
        outer = int(np.argmin(sensor.depths))
        self.missing[outer, nearest[: round(defects.worn_markers * count)]] = True
        kept_of_rubbed = (0.35, 0.8)  # shares of a rubbed marker's width that may be left
        if defects.rubbed_markers:
            rng = np.random.default_rng([seed, RUBBED])
            kept = rng.uniform(*kept_of_rubbed, (2, count))
            self._kept = np.where(rng.random((2, count)) < defects.rubbed_markers, kept, 1.0)
            self._towards = rng.integers(0, 4, (2, count))

    def __call__(self, membrane: Membrane) -> Membrane:
        """Membrane with what is left of rubbed markers, without the missing: centres are NaN."""
        if self._kept is not None:
            membrane = _rubbed(membrane, self._kept, self._towards)
        if not self.missing.any():
            return membrane
        centres = membrane.centres.copy()
        centres[self.missing] = np.nan
        return replace(membrane, centres=centres)


def _rubbed(membrane: Membrane, kept: Array, towards: NDArray[np.intp]) -> Membrane:
    """Membrane of whose markers a share (2, M) is left, at one end of one of their axes."""
    centres, axes = membrane.centres.copy(), membrane.axes.copy()
    for axis in range(2):
        along = towards // 2 == axis
        side = np.where(towards % 2 == 0, 1.0, -1.0)
        gone = np.where(along, 1.0 - kept, 0.0)[..., None]
        centres += gone * side[..., None] * axes[..., axis]
        axes[..., axis] *= 1.0 - gone
    return Membrane(centres=centres, axes=axes)


def _misplaced(sensor: SensorDesign, defects: Defects, seed: int) -> Array:
    """Places of each layer's markers, shape (2, M, 2)."""
    skin, count = sensor.shape, len(sensor.places)
    points = np.stack([skin.points(sensor.places, depth) for depth in sensor.depths])
    moved = np.zeros_like(points)
    scatter = np.random.default_rng([seed, MISPLACEMENT]).standard_normal((2, count, 2))
    along = np.stack(skin.tangents(sensor.places), axis=-1)
    moved += 1e-3 * defects.misplacement_mm * np.einsum("mki,lmi->lmk", along, scatter)
    if defects.crookedness_mm:
        both = np.random.default_rng([seed, CROOKEDNESS]).standard_normal((count, 2))
        moved += 1e-3 * defects.crookedness_mm * np.einsum("mki,mi->mk", along, both)
    if defects.gore_misalignment_mm:
        moved[1] += _by_gore(sensor, points[1], 1e-3 * defects.gore_misalignment_mm, seed)
    moved[1] += misalignment(sensor, points[1], defects.misalignment_mm * 1e-3, seed)
    return np.stack([skin.places_of(p) for p in points + moved])


def gores(sensor: SensorDesign, places: Array) -> NDArray[np.intp]:
    """Number of the gore in which places (…, 2) lie."""
    count = sensor.seams.count if sensor.seams else GORE_COUNT
    return np.floor(np.mod(places[..., 1], 2 * np.pi) / (2 * np.pi) * count).astype(int)


def _by_gore(sensor: SensorDesign, points: Array, size: float, seed: int) -> Array:
    """Displacement of a layer's points (M, 3), by up to `size` in the worst gore [m]."""
    rng = np.random.default_rng([seed, GORES])
    of = gores(sensor, sensor.places)
    count = int(of.max()) + 1
    share = rng.permutation((np.arange(1, count + 1) / count) ** 2.5)
    streams = rng.integers(1, 2**31, count)
    each = [
        misalignment(sensor, points, size * s, int(k)) for s, k in zip(share, streams, strict=True)
    ]
    return np.asarray(np.stack(each)[of, np.arange(len(points))])


def misalignment(sensor: SensorDesign, points: Array, size: float, seed: int) -> Array:
    """Displacement of points of a layer that lies beside its place on the skin [m], (…, 3).

    Parameters
    ----------
    sensor: design
    points: of the resting layer [m], shape (…, 3)
    size: shift of its middle; the turn about the axis moves the rim by up to as much [m]
    seed: of the direction and the turn
    """
    rng = np.random.default_rng([seed, MISALIGNMENT])
    angle, turn = rng.uniform(0.0, 2 * np.pi), rng.uniform(-1.0, 1.0)
    x, y = np.cos(angle), np.sin(angle)
    if sensor.shape.flat:
        axis = np.array([0.0, 0.0, turn / sensor.shape.half])
        return size * (np.array([x, y, 0.0]) + np.cross(axis, points))
    # On a ball every shift is a turn.
    axis = np.array([-y, x, turn]) / np.linalg.norm(points, axis=-1).max()
    return size * np.cross(axis, points)
