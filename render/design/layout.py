"""Layouts of the markers: their places (θ or ρ, φ) on the skin, see `skin`."""

import csv
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError

Array = NDArray[np.float64]

#: Distance of the apex marker from the apex, in pitches: coordinates are singular at 0.
_APEX = 1e-3
#: Angle between successive points of an even spiral [rad].
GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))


def unit_vectors(directions: Array) -> Array:
    """Unit vectors (x, y, z) of directions (θ from the apex, φ from the load), shape (M, 3)."""
    theta, phi = directions.T
    return np.column_stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    )


def spiral(count: int, coverage: float) -> Array:
    """Markers in a golden-angle spiral to an angle from the apex [rad], even in area."""
    index = np.arange(count)
    height = 1.0 - (1.0 - np.cos(coverage)) * (index + 0.5) / count
    return np.column_stack([np.arccos(height), np.mod(index * GOLDEN_ANGLE, 2 * np.pi)])


@lru_cache(maxsize=16)
def geodesic(count: int, coverage: float, pitch: float) -> Array:
    """Markers in a golden-angle spiral, and a row of markers on the chain's meridian.

    The spiral is even in area and has no symmetry that could hide an error; its points near the
    meridian's row are omitted.

    Parameters
    ----------
    count: number of all markers
    coverage: largest angle from the apex [rad]
    pitch: angle between markers on the meridian [rad]

    Returns
    -------
    directions (θ, φ) [rad], shape (count, 2), read-only
    """
    arc = pitch * np.arange(1, int(coverage / pitch) + 1)
    # The marker at the apex is just off it: spherical coordinates are singular there.
    row = np.concatenate(
        [[[_APEX, 0.0]]] + [np.column_stack([arc, np.full_like(arc, phi)]) for phi in (0.0, np.pi)]
    )
    if len(row) >= count:
        raise UserError(f"{count} markers are too few for a meridian row of {len(row)}")
    row_vectors = unit_vectors(row)
    for total in range(count - len(row), 4 * count):
        turns = spiral(total, coverage)
        nearest = (unit_vectors(turns) @ row_vectors.T).max(axis=1)
        kept = turns[np.arccos(np.clip(nearest, -1.0, 1.0)) > 0.95 * pitch]
        if len(kept) + len(row) >= count:
            layout = np.concatenate([row, kept[: count - len(row)]])
            layout.setflags(write=False)
            return layout
    raise UserError(f"no room for {count} markers with a meridian row of {len(row)}")


def rings(counts: tuple[int, ...], pitch: float, turn: float) -> Array:
    """Rings of evenly spaced markers around the apex, one marker in the middle if counts[0] is 1.

    Parameters
    ----------
    counts: number of markers of each ring, outwards
    pitch: distance between rings, in the first coordinate
    turn: turn of a ring's first marker from φ = 0, as a share of the ring's own spacing
    """
    places = []
    for k, count in enumerate(counts):
        first = pitch * k if counts[0] == 1 else pitch * (k + 0.5)
        phi = 2 * np.pi * (np.arange(count) + turn) / count
        places.append(np.column_stack([np.full(count, max(first, _APEX * pitch)), phi]))
    return np.concatenate(places)


def meridians(count: int, pitch: float, coverage: float, gap: float, turn: float) -> Array:
    """Rows of markers on meridians, thinned towards the apex.

    Parameters
    ----------
    count: number of meridians, evenly spaced over the full turn
    pitch: distance between markers of a row, in the first coordinate
    coverage: largest first coordinate of a marker
    gap: smallest distance between markers of neighbouring rows; only every second, fourth, … row
        has a marker in a ring that would be denser
    turn: turn of the first meridian from φ = 0, as a share of their spacing
    """
    places = [np.array([[_APEX * pitch, 0.0]])]
    for first in np.arange(pitch, coverage + 1e-9, pitch):
        rows = count
        while rows > 1 and 2 * np.pi * np.sin(min(first, np.pi / 2)) / rows < gap:
            rows = rows // 2 if rows % 2 == 0 else 1
        if rows > 1:
            phi = 2 * np.pi * (np.arange(rows) * (count // rows) + turn) / count
            places.append(np.column_stack([np.full(rows, first), phi]))
    return np.concatenate(places)


def grid(rows: int, columns: int, pitch: float) -> Array:
    """Square grid, rows along y and columns along x; on a dome wrapped around the apex."""
    y, x = np.mgrid[:rows, :columns].astype(float)
    x, y = pitch * (x - (columns - 1) / 2).ravel(), pitch * (y - (rows - 1) / 2).ravel()
    return np.column_stack([np.maximum(np.hypot(x, y), _APEX * pitch), np.arctan2(y, x)])


def from_file(path: str, flat: bool) -> Array:
    """Read places from a CSV file with columns theta_deg, phi_deg (dome) or x_mm, y_mm (pad).

    Raises
    ------
    UserError
        When the file cannot be read, or has other columns or values.
    """
    columns = ("x_mm", "y_mm") if flat else ("theta_deg", "phi_deg")
    try:
        with Path(path).open(encoding="utf-8", newline="") as file:
            values = [[float(row[c]) for c in columns] for row in csv.DictReader(file)]
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        raise UserError(f"layout file {path} cannot be read: {reason}") from None
    except (KeyError, TypeError, ValueError):
        raise UserError(f"layout file {path} must have columns {','.join(columns)}") from None
    if not values or not np.isfinite(values).all():
        raise UserError(f"layout file {path} must hold at least one marker, all of them finite")
    first, second = np.array(values).T
    if flat:
        x, y = 1e-3 * first, 1e-3 * second
        return np.column_stack([np.maximum(np.hypot(x, y), 1e-9), np.arctan2(y, x)])
    return np.column_stack([np.maximum(np.deg2rad(first), 1e-9), np.deg2rad(second)])
