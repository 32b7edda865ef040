"""Tracks and truths of any origin as arrays: places of points in frames."""

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError, located
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
#: What may stand in the column `visible`.
_SEEN = dict.fromkeys(("true", "1", "1.0"), True) | dict.fromkeys(
    ("false", "0", "0.0", "none", ""), False
)
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


def read_points(path: Path, kind: str = "tracks") -> Points:
    """Points of a Parquet or CSV file with a row for each frame and point, or of TAP-Vid's NumPy.

    Columns are `frame`, `marker` (or `point`, `track`, `id`), `x_px` and `y_px` (or `x` and `y`)
    and, if there are any, `layer` and `visible`. A NumPy file has `tracks` (N, F, 2) [px],
    `visibles` or `occluded` (N, F) and, if there are any, names `layer` (N,).

    Parameters
    ----------
    path: of the file
    kind: what a refusal calls it: tracks or truth

    Raises
    ------
    UserError
        When the file cannot be read, or lacks something, or has something twice.
    """
    with located(f"{kind} {path}"):
        if path.suffix not in SUFFIXES:
            raise UserError(f"expected a file that ends in {', '.join(SUFFIXES)}")
        try:
            if path.suffix == ".npz":
                return _from_arrays(path)
            return _from_rows(_parquet_rows(path) if path.suffix == ".parquet" else _csv_rows(path))
        except UserError:
            raise
        except (OSError, ValueError, KeyError, csv.Error, BadZipFile) as error:
            words = error.strerror if isinstance(error, OSError) else error
            raise UserError(f"it cannot be read: {words}") from None


def _from_arrays(path: Path) -> Points:
    with np.load(path) as file:
        if "tracks" not in file or not {"visibles", "occluded"} & set(file.files):
            raise UserError("it has no arrays tracks and visibles, or occluded")
        tracks = np.asarray(file["tracks"], dtype=float)
        visible = file["visibles"] if "visibles" in file else ~file["occluded"].astype(bool)
        layers = [str(name) for name in file["layer"]] if "layer" in file else [""] * len(tracks)
    if tracks.ndim != 3 or tracks.shape[2] != 2 or visible.shape != tracks.shape[:2]:
        raise UserError(
            f"it has shapes {tracks.shape} and {visible.shape}, expected (points, frames, 2) and "
            "(points, frames)"
        )
    if len(layers) != len(tracks):
        raise UserError(f"its array layer names {len(layers)} of {len(tracks)} points")
    position = np.swapaxes(tracks, 0, 1)
    seen = np.asarray(visible.T, dtype=bool) & np.isfinite(position).all(axis=2)
    names = [(layer, k) for k, layer in enumerate(layers)]
    return Points(names=names, position=np.where(seen[..., None], position, np.nan), visible=seen)


def _parquet_rows(path: Path) -> dict[str, list[Any]]:
    pa = need("pyarrow", "data")
    try:
        table = need("pyarrow.parquet", "data").read_table(path)
    except pa.ArrowException as error:
        words = str(error).replace(f" '{path}'", "")  # the refusal has named it
        raise ValueError(words) from None
    return {name: table[name].to_pylist() for name in table.column_names}


def _csv_rows(path: Path) -> dict[str, list[Any]]:
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        rows = list(reader)
        names = reader.fieldnames or ()
    for k, row in enumerate(rows):
        if None in row or None in row.values():
            raise UserError(f"row {k + 1} has not {len(names)} values")
    return {name: [row[name] for row in rows] for name in names}


def _from_rows(rows: dict[str, list[Any]]) -> Points:
    called = {
        name: next((column for column in choices if column in rows), None)
        for name, choices in _COLUMNS.items()
    }
    for name in _NEEDED:
        if called[name] is None:
            raise UserError(f"it has no column {' or '.join(_COLUMNS[name])}")
    columns = {name: (column, rows[column]) for name, column in called.items() if column}
    frame, number = (_read(*columns[name], _whole, "whole number") for name in ("frame", "point"))
    count = len(frame)
    if count == 0 or frame.min() < 0:
        raise UserError("it has no row, or a frame before 0")
    layer = [str(value) for value in columns["layer"][1]] if "layer" in columns else [""] * count
    at = np.stack([_read(*columns[name], _place, "number") for name in ("x", "y")], axis=-1)
    seen = np.isfinite(at).all(axis=1)
    if "visible" in columns:
        seen &= _read(*columns["visible"], _truth, "true or false")
    names, column = _numbered(layer, number)
    _check_once(frame, column, names)
    position = np.full((frame.max() + 1, len(names), 2), np.nan)
    visible = np.zeros(position.shape[:2], dtype=bool)
    position[frame[seen], column[seen]] = at[seen]
    visible[frame[seen], column[seen]] = True
    return Points(names=names, position=position, visible=visible)


def _numbered(
    layer: list[str], number: NDArray[np.int64]
) -> tuple[list[tuple[str, int]], NDArray[np.intp]]:
    """Layer and number of each point, sorted, and which of them each row is of."""
    own = list(zip(layer, number.tolist(), strict=True))
    names = sorted(set(own))
    place = {name: k for k, name in enumerate(names)}
    return names, np.array([place[name] for name in own], dtype=np.intp)


def _check_once(
    frame: NDArray[np.int64], column: NDArray[np.intp], names: list[tuple[str, int]]
) -> None:
    """Refuse two rows of one point in one frame: which of them holds is not guessed."""
    order = np.lexsort((column, frame))
    again = (np.diff(frame[order]) == 0) & (np.diff(column[order]) == 0)
    if again.any():
        k = order[int(again.argmax())]
        layer, number = names[column[k]]
        of = f" of layer {layer}" if layer else ""
        raise UserError(
            f"{again.sum()} rows repeat another one, first of marker {number}{of} in frame "
            f"{frame[k]}; wanted: one row for each frame, layer and marker"
        )


def _read(column: str, values: list[Any], kind: Callable[[Any], Any], words: str) -> NDArray[Any]:
    """Values of a column as that kind; a refusal names row and column."""
    found = []
    for k, value in enumerate(values):
        try:
            found.append(kind(value))
        except (ValueError, TypeError, KeyError, OverflowError):
            raise UserError(f"row {k + 1}, column {column}: {value!r} is no {words}") from None
    return np.array(found)


def _whole(value: Any) -> int:
    whole = int(float(value))
    if whole != float(value):
        raise ValueError(value)
    return whole


def _place(value: Any) -> float:
    return np.nan if value in (None, "") else float(value)


def _truth(value: Any) -> bool:
    return _SEEN[str(value).lower()]
