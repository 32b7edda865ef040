"""Tracks and truths of any origin as arrays: places of points in frames."""

import csv
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError, located
from ...strange_files import array_names, need_file, read_arrays, shortened

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Names that a column may have, in any case: ours, trackpy's, TrackMate's; the first counts.
_COLUMNS = {
    "frame": ("frame", "frame_number", "t"),
    "point": ("marker", "point", "particle", "track_id", "track", "id"),
    "x": ("x_px", "x", "position_x"),
    "y": ("y_px", "y", "position_y"),
    "layer": ("layer",),
    "visible": ("visible",),
}
_NEEDED = ("frame", "point", "x", "y")
#: What may stand in the column `visible`.
_SEEN = dict.fromkeys(("true", "1", "1.0"), True) | dict.fromkeys(
    ("false", "0", "0.0", "none", ""), False
)
SUFFIXES = (".parquet", ".csv", ".npz")
#: Rows of a table, and frames times points, that are read unless more are asked for.
MOST_ROWS = 20_000_000
#: Every number of a frame is below.
_FRAMES = 100_000_000
#: Rows that are converted at a time, so that a table takes no more memory than its arrays.
_PART = 50_000
#: Largest columns of a Parquet file [bytes].
_MOST_BYTES = 2**30

#: Columns of some rows, by the keys of _COLUMNS.
Rows = dict[str, list[Any]]


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

    @property
    def seen(self) -> Array:
        """Places [px], shape (F, N, 2); NaN where they are not visible."""
        return np.where(self.visible[..., None], self.position, np.nan)

    def part(self, some: Mask | NDArray[np.intp]) -> "Points":
        """Some of the points."""
        names = [self.names[k] for k in np.arange(len(self.names))[some]]
        return Points(names=names, position=self.position[:, some], visible=self.visible[:, some])


def read_points(path: Path, kind: str = "tracks", most: int = MOST_ROWS) -> Points:
    """Points of a Parquet or CSV file with a row for each frame and point, or of TAP-Vid's NumPy.

    Columns are `frame`, `marker` (or `point`, `particle`, `track_id`, `track`, `id`), `x_px` and
    `y_px` (or `x` and `y`, `position_x` and `position_y`) and, if there are any, `layer` and
    `visible`, in any case. Rows of TrackMate's spots that are in no track are left out. A NumPy
    file has `tracks` (N, F, 2) [px], `visibles` or `occluded` (N, F) and, if there are any, names
    `layer` (N,).

    Parameters
    ----------
    path: of the file
    kind: what a refusal calls it: tracks or truth
    most: rows that are read at most, and frames times points

    Raises
    ------
    UserError
        When the file cannot be read, is too large, lacks something, or has something twice.
    """
    with located(f"{kind} {path}"):
        if path.suffix not in SUFFIXES:
            raise UserError(f"expected a file that ends in {', '.join(SUFFIXES)}")
        need_file(path, "it")
        if path.suffix == ".npz":
            try:
                return _from_arrays(path, most)
            except UserError as error:  # which names the file again
                raise UserError(str(error).replace(f"{path} ", "it ", 1)) from None
        parts = _parquet_parts(path, most) if path.suffix == ".parquet" else _csv_parts(path)
        try:
            return _from_parts(parts, most)
        except UserError:
            raise
        except (OSError, ValueError, KeyError, csv.Error) as error:
            words = getattr(error, "strerror", None) or str(error).replace(f" '{path}'", "")
            raise UserError(f"it cannot be read: {words}") from None


def _from_arrays(path: Path, most: int) -> Points:
    there = {name.lower(): name for name in array_names(path)}
    seen = "visibles" if "visibles" in there else "occluded"
    if not {"tracks", seen} <= set(there):
        raise UserError("it has no arrays tracks and visibles, or occluded")
    own = {name: there[name] for name in ("tracks", seen, "layer") if name in there}
    arrays = read_arrays(path, own.values(), 2 * most)
    found = {name: arrays[key] for name, key in own.items()}
    for name in ("tracks", seen):
        if found[name].dtype.kind not in "biuf":
            raise UserError(f"its array {name} holds {found[name].dtype}, expected numbers")
    tracks, visible = found["tracks"].astype(float), found[seen].astype(bool)
    if seen == "occluded":
        visible = ~visible
    if tracks.ndim != 3 or tracks.shape[2] != 2 or visible.shape != tracks.shape[:2]:
        raise UserError(
            f"it has shapes {tracks.shape} and {visible.shape}, expected (points, frames, 2) and "
            "(points, frames)"
        )
    layers = [str(name) for name in np.ravel(found.get("layer", [""] * len(tracks)))]
    if len(layers) != len(tracks):
        raise UserError(f"its array layer names {len(layers)} of {len(tracks)} points")
    position = np.swapaxes(tracks, 0, 1)
    known = visible.T & np.isfinite(position).all(axis=2)
    names = [(layer, k) for k, layer in enumerate(layers)]
    position = np.where(known[..., None], position, np.nan)
    return Points(names=names, position=position, visible=known)


def _called(names: Iterable[str]) -> dict[str, str]:
    """Name of each column of _COLUMNS that a table has."""
    names = list(names)
    there = {name.strip().lower(): name for name in names} | {name: name for name in names}
    called = {
        name: there[column]
        for name, choices in _COLUMNS.items()
        if (column := next((c for c in choices if c in there), None))
    }
    for name in _NEEDED:
        if name not in called:
            if len(names) == 1 and (other := next((c for c in ";\t" if c in names[0]), "")):
                separated = "tabs" if other == "\t" else "semicolons"
                raise UserError(f"its columns are separated by {separated}; expected commas")
            raise UserError(f"it has no column {' or '.join(_COLUMNS[name])}")
    return called


def _too_many(found: str, most: int) -> UserError:
    return UserError(f"it has {found}, more than {most}; give --max-rows to read it")


def _parquet_parts(path: Path, most: int) -> Iterator[tuple[dict[str, str], Rows]]:
    """Yield some rows at a time, with the names of their columns."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            if file.metadata.num_rows > most:  # before anything is decoded
                raise _too_many(f"{file.metadata.num_rows} rows", most)
            called = _called(file.schema_arrow.names)
            groups = map(file.metadata.row_group, range(file.metadata.num_row_groups))
            if sum(group.total_byte_size for group in groups) > _MOST_BYTES:
                raise _too_many("columns of over a gigabyte of text or numbers", most)
            for batch in file.iter_batches(_PART, columns=list(called.values())):
                yield called, {key: batch.column(own).to_pylist() for key, own in called.items()}
    except pa.ArrowException as error:
        raise ValueError(str(error).partition("\n")[0]) from None


def _csv_parts(path: Path) -> Iterator[tuple[dict[str, str], Rows]]:
    """Yield some rows at a time, with the names of their columns."""
    with path.open("rb") as file:
        wide = file.read(2) in (BOM_UTF16_LE, BOM_UTF16_BE)  # as Excel's "Unicode text"
    with path.open(newline="", encoding="utf-16" if wide else "utf-8-sig") as file:
        reader, start = csv.reader(file), 0
        names = next(reader, [])
        called, place = _called(names), {name: k for k, name in enumerate(names)}
        spots = called["x"].lower() == "position_x"
        body = _spots(reader, place[called["x"]], place[called["point"]]) if spots else reader
        while rows := [row for row in islice(body, _PART) if row]:
            for k, row in enumerate(rows):
                if len(row) != len(names):
                    raise UserError(f"row {start + k + 1} has not {len(names)} values")
            start += len(rows)
            yield called, {key: [row[place[own]] for row in rows] for key, own in called.items()}


def _spots(rows: Iterator[list[str]], x: int, track: int) -> Iterator[list[str]]:
    """Rows of TrackMate's spots that are in a track, without its rows of long names and units.

    Parameters
    ----------
    rows: those below the first line of the table
    x, track: columns of POSITION_X and TRACK_ID
    """
    head = list(islice(rows, 3))
    if head and head[0][x : x + 1] == ["X"]:
        unit = "".join(head[-1][x : x + 1]).strip(" ()").lower()
        if unit not in ("", "pixel", "pixels"):
            raise UserError(
                f"its places are in {unit}; wanted: pixels, as of a picture without scale"
            )
        head = []
    return (row for row in chain(head, rows) if row[track : track + 1] not in ([""], ["None"]))


def _from_parts(parts: Iterable[tuple[dict[str, str], Rows]], most: int) -> Points:
    frames, columns, places, visibles = [], [], [], []
    number: dict[tuple[str, int], int] = {}
    start = 0
    for called, rows in parts:
        count = len(rows["frame"])
        if start + count > most:
            raise _too_many("more rows", most)

        def read(name: str, kind: Callable[[Any], Any], words: str) -> NDArray[Any]:
            return _read(called[name], rows[name], kind, words, start)  # noqa: B023

        frames.append(read("frame", _frame, f"whole number below {_FRAMES}"))
        own = read("point", _whole, "whole number").tolist()
        layer = [str(value) for value in rows.get("layer", [""] * count)]
        columns.append([number.setdefault(n, len(number)) for n in zip(layer, own, strict=True)])
        places.append(np.stack([read(name, _place, "number") for name in ("x", "y")], axis=-1))
        seen = np.isfinite(places[-1]).all(axis=1)
        visibles.append(
            seen & read("visible", _truth, "true or false") if "visible" in rows else seen
        )
        start += count
    if not start or min(part.min() for part in frames) < 0:
        raise UserError("it has no row, or a frame before 0")
    frame, at, seen = (np.concatenate(part) for part in (frames, places, visibles))
    names = sorted(number)
    rank = np.empty(len(names), dtype=np.intp)
    rank[[number[name] for name in names]] = np.arange(len(names))
    column = rank[np.concatenate(columns)]
    _check_once(frame, column, names)
    count = int(frame.max()) + 1
    if count * len(names) > most:
        raise _too_many(f"{count} frames of {len(names)} points", most)
    position = np.full((count, len(names), 2), np.nan)
    visible = np.zeros(position.shape[:2], dtype=bool)
    position[frame[seen], column[seen]] = at[seen]
    visible[frame[seen], column[seen]] = True
    return Points(names=names, position=position, visible=visible)


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


def _read(
    column: str, values: list[Any], kind: Callable[[Any], Any], words: str, start: int
) -> NDArray[Any]:
    """Values of a column as that kind; a refusal names row, counted on from `start`, and column."""
    found = []
    for k, value in enumerate(values):
        try:
            found.append(kind(value))
        except (ValueError, TypeError, KeyError, OverflowError):
            raise UserError(
                f"row {start + k + 1}, column {column}: {shortened(value)} is no {words}"
            ) from None
    return np.array(found)


def _whole(value: Any) -> int:
    whole = int(float(value))
    if whole != float(value) or abs(whole) >= 2**53:
        raise ValueError(value)
    return whole


def _frame(value: Any) -> int:
    number = _whole(value)
    if number >= _FRAMES:
        raise ValueError(value)
    return number


def _place(value: Any) -> float:
    return np.nan if value in (None, "") else float(value)


def _truth(value: Any) -> bool:
    return _SEEN[str(value).lower()]
