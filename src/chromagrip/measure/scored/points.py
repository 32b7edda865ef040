"""Tracks and truths of any origin as arrays: places of points in frames."""

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...extras import need

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Names that a column may have.
_COLUMNS = {
    "frame": ("frame", "frame_number", "t"),
    "point": ("marker", "point", "track", "id"),
    "x": ("x_px", "x"),
    "y": ("y_px", "y"),
    "layer": ("layer",),
    "visible": ("visible",),
}
_NEEDED = ("frame", "point", "x", "y")
SUFFIXES = (".parquet", ".csv", ".npz")


@dataclass(frozen=True, kw_only=True)
class Points:
    """Places of N points in F frames.

    Attributes
    ----------
    names: layer and number of each point; the layer is empty where there are none
    position: [px], shape (F, N, 2); NaN where there is none
    visible: shape (F, N)
    """

    names: list[tuple[str, int]]
    position: Array
    visible: Mask

    @property
    def layers(self) -> Array:
        """Layer of each point, shape (N,)."""
        return np.array([layer for layer, _ in self.names], dtype=object)

    def part(self, some: Mask) -> "Points":
        """Some of the points."""
        names = [name for name, kept in zip(self.names, some, strict=True) if kept]
        return Points(names=names, position=self.position[:, some], visible=self.visible[:, some])


def read_points(path: Path) -> Points:
    """Points of a Parquet or CSV file with a row for each frame and point, or of TAP-Vid's NumPy.

    Columns are `frame`, `marker` (or `point`, `track`, `id`), `x_px` and `y_px` (or `x` and `y`)
    and, if there are any, `layer` and `visible`. A NumPy file has `tracks` (N, F, 2) [px] and
    `visibles` or `occluded` (N, F).

    Raises
    ------
    UserError
        When the file cannot be read, or lacks something.
    """
    if path.suffix not in SUFFIXES:
        raise UserError(f"tracks {path}: expected a file that ends in {', '.join(SUFFIXES)}")
    try:
        if path.suffix == ".npz":
            return _from_arrays(path)
        rows = _parquet_rows(path) if path.suffix == ".parquet" else _csv_rows(path)
        return _from_rows(rows, path)
    except (OSError, ValueError, KeyError) as error:
        words = error.strerror if isinstance(error, OSError) else error
        raise UserError(f"tracks {path} cannot be read: {words}") from None


def _from_arrays(path: Path) -> Points:
    with np.load(path) as file:
        if "tracks" not in file or not {"visibles", "occluded"} & set(file.files):
            raise UserError(f"tracks {path} has no arrays tracks and visibles, or occluded")
        tracks = np.asarray(file["tracks"], dtype=float)
        visible = file["visibles"] if "visibles" in file else ~file["occluded"].astype(bool)
    if tracks.ndim != 3 or tracks.shape[2] != 2 or visible.shape != tracks.shape[:2]:
        raise UserError(
            f"tracks {path} has shapes {tracks.shape} and {visible.shape}, expected (points, "
            "frames, 2) and (points, frames)"
        )
    position = np.swapaxes(tracks, 0, 1)
    seen = np.asarray(visible.T, dtype=bool) & np.isfinite(position).all(axis=2)
    names = [("", k) for k in range(len(tracks))]
    return Points(names=names, position=np.where(seen[..., None], position, np.nan), visible=seen)


def _parquet_rows(path: Path) -> dict[str, list[Any]]:
    pa = need("pyarrow", "data")
    try:
        table = need("pyarrow.parquet", "data").read_table(path)
    except pa.ArrowException as error:
        raise ValueError(error) from None
    return {name: table[name].to_pylist() for name in table.column_names}


def _csv_rows(path: Path) -> dict[str, list[Any]]:
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        rows = list(reader)
        return {name: [row[name] for row in rows] for name in reader.fieldnames or ()}


def _from_rows(rows: dict[str, list[Any]], path: Path) -> Points:
    columns = {
        name: next((rows[column] for column in choices if column in rows), None)
        for name, choices in _COLUMNS.items()
    }
    for name in _NEEDED:
        if columns[name] is None:
            raise UserError(f"tracks {path} has no column {' or '.join(_COLUMNS[name])}")
    frame = np.array(columns["frame"], dtype=int)
    number = np.array(columns["point"], dtype=int)
    count = len(frame)
    if count == 0 or frame.min() < 0:
        raise UserError(f"tracks {path} has no row, or a frame before 0")
    layer = [str(value) for value in columns["layer"] or [""] * count]
    at = np.stack([_numbers(columns[name] or ()) for name in ("x", "y")], axis=-1)
    seen = np.isfinite(at).all(axis=1)
    if columns["visible"] is not None:
        seen &= np.array([str(v).lower() in ("true", "1") for v in columns["visible"]])
    names = sorted(set(zip(layer, number.tolist(), strict=True)))
    place = {name: k for k, name in enumerate(names)}
    column = np.array([place[name] for name in zip(layer, number.tolist(), strict=True)])
    position = np.full((frame.max() + 1, len(names), 2), np.nan)
    visible = np.zeros(position.shape[:2], dtype=bool)
    position[frame[seen], column[seen]] = at[seen]
    visible[frame[seen], column[seen]] = True
    return Points(names=names, position=position, visible=visible)


def _numbers(values: Iterable[Any]) -> Array:
    return np.array([np.nan if v in (None, "") else float(v) for v in values])
