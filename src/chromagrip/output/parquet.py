"""Tracks and estimates as tables, written while they come: Parquet, or CSV by a file's name.

Units and meanings of the columns are the metadata of a Parquet table's schema.
"""

import csv
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..extras import need
from ..folders import GrowingFile, disk_errors
from ..tracking import Tracks

#: Arrow type of every column and what it holds; `list` is of float32, `dictionary` of strings.
Columns = Mapping[str, tuple[str, str]]

#: Tracks, one row per frame, layer and marker; null where a marker was not found.
TRACKS: Columns = {
    "frame": ("int32", "number of the frame in the source, from 0"),
    "time_s": ("float64", "time of the frame [s]"),
    "layer": ("dictionary", "name of the layer in the palette"),
    "marker": ("int32", "number of the marker; layers share it that lie on each other at rest"),
    "x_px": ("float64", "middle of the marker's image, rightwards, pixel centres at integers"),
    "y_px": ("float64", "middle of the marker's image, downwards"),
    "rest_x_px": ("float64", "x_px of the marker at rest"),
    "rest_y_px": ("float64", "y_px of the marker at rest"),
    "log_size": ("float64", "natural logarithm of the size over the size at rest"),
    "hue_deg": ("float64", "mean hue over the first layer's marker [°], in that layer's rows"),
    "visible": ("bool", "found in this frame"),
    "ambiguous": ("bool", "found, but its number is not certain"),
    "last_seen_s": ("float64", "time of the last frame in which it was found [s]"),
    "var_xx_px2": ("float64", "variance of x [px²]"),
    "var_xy_px2": ("float64", "covariance of x and y [px²]"),
    "var_yy_px2": ("float64", "variance of y [px²]"),
}
_FRAME: Columns = {
    "frame": ("int32", "number of the frame in the source, from 0"),
    "time_s": ("float64", "time of the frame [s]"),
    "markers_seen": ("int32", "marker pairs found in the frame"),
    "no_estimate": ("string", "why the frame says nothing; empty when it does"),
}
#: Forces, one row per frame; low and high bound a 90 % interval.
FORCES: Columns = {
    **_FRAME,
    "normal_n": ("float64", "sum of the normal forces [N]"),
    "normal_low_n": ("float64", "lower end of its interval"),
    "normal_high_n": ("float64", "upper end of its interval"),
    "friction_n": ("float64", "sum of the friction forces, its magnitude [N]"),
    "friction_low_n": ("float64", "lower end of its interval"),
    "friction_high_n": ("float64", "upper end of its interval"),
    "mu": ("float64", "friction coefficient in use"),
    "mu_low": ("float64", "lower end of its interval"),
    "mu_high": ("float64", "upper end of its interval"),
    "mu_observable": ("bool", "whether the frame shows mu, rather than what a press shows"),
    "margin": ("float64", "safety margin; null with nothing in contact"),
    "margin_low": ("float64", "lower end of its interval"),
    "margin_high": ("float64", "upper end of its interval"),
    "limit_margin": ("float64", "margin of friction and torsion together; null for a chain"),
    "limit_margin_low": ("float64", "lower end of its interval"),
    "limit_margin_high": ("float64", "upper end of its interval"),
    "force_x_n": ("float64", "force of the object on a dome along x [N]; null for a chain"),
    "force_x_low_n": ("float64", "lower end of its interval"),
    "force_x_high_n": ("float64", "upper end of its interval"),
    "force_y_n": ("float64", "along y [N]"),
    "force_y_low_n": ("float64", "lower end of its interval"),
    "force_y_high_n": ("float64", "upper end of its interval"),
    "force_z_n": ("float64", "along z, the sensor's axis [N]"),
    "force_z_low_n": ("float64", "lower end of its interval"),
    "force_z_high_n": ("float64", "upper end of its interval"),
    "torque_nmm": ("float64", "torque of the object about z [N·mm]; null for a chain"),
    "torque_low_nmm": ("float64", "lower end of its interval"),
    "torque_high_nmm": ("float64", "upper end of its interval"),
    "node_normal_n": ("list", "normal force on each node of the skin [N]"),
    "node_friction_n": ("list", "friction on each node [N]; of a dome (x, y, z) of each in turn"),
}
#: Displacements of a flat pad, one row per frame.
DISPLACEMENTS: Columns = {
    **_FRAME,
    "depth_mm": ("float64", "displacement into the pad, 95 % quantile over the markers [mm]"),
    "shift_x_mm": ("float64", "mean displacement along x of markers at least half as deep [mm]"),
    "shift_y_mm": ("float64", "the same along y"),
    "deviation_mm": ("float64", "typical standard deviation of a single marker's depth [mm]"),
    "marker_x_mm": ("list", "displacement of the skin at each marker along x [mm]"),
    "marker_y_mm": ("list", "along y"),
    "marker_depth_mm": ("list", "into the pad"),
}
#: Columns of estimates that a summary prints: words and unit.
VALUES = {
    "normal_n": ("normal force", " N"),
    "friction_n": ("friction force", " N"),
    "mu": ("friction coefficient", ""),
    "margin": ("safety margin", ""),
    "limit_margin": ("the same with torsion", ""),
    "force_x_n": ("force along x", " N"),
    "force_y_n": ("force along y", " N"),
    "force_z_n": ("force along z", " N"),
    "torque_nmm": ("torque about z", " N·mm"),
    "depth_mm": ("displacement into the pad", " mm"),
    "shift_x_mm": ("along x", " mm"),
    "shift_y_mm": ("along y", " mm"),
}
#: Rows of tracks that make a row group, about.
_TRACK_GROUP = 100_000


#: Values of a frame by column.
Row = dict[str, float | str | NDArray[np.float32] | None]


#: Values of some rows by column; NaN of an array is null, as None of a list.
_Values = Mapping[str, Sequence[Any] | NDArray[Any]]


class _Writer(Protocol):
    """Writes a table, some rows at a time; errors of the disk are an `OSError`."""

    def write(self, values: _Values) -> None:
        """Append rows."""

    def close(self) -> None:
        """Complete the file."""


class _ParquetWriter:
    """Writes a Parquet file, with a group of rows at a time."""

    def __init__(self, path: Path, columns: Columns, categories: Sequence[str]) -> None:
        pa, pq = need("pyarrow", "data"), need("pyarrow.parquet", "data")
        self._categories = pa.array(categories, pa.string())
        kinds = {"list": pa.list_(pa.float32()), "dictionary": pa.dictionary(pa.int8(), "string")}
        self._schema = pa.schema(
            [pa.field(name, kinds.get(kind, kind)) for name, (kind, _) in columns.items()],
            metadata={name: text for name, (_, text) in columns.items()},
        )
        self._numbered = {name for name, (kind, _) in columns.items() if kind == "dictionary"}
        self._file = pq.ParquetWriter(path, self._schema)

    def write(self, values: _Values) -> None:
        pa = need("pyarrow", "data")
        arrays = []
        for field in self._schema:
            own = values[field.name]
            if field.name in self._numbered:
                array = pa.DictionaryArray.from_arrays(pa.array(own), self._categories)
            else:
                array = pa.array(own, field.type, from_pandas=isinstance(own, np.ndarray))
            arrays.append(array)
        self._file.write_table(pa.Table.from_arrays(arrays, schema=self._schema))

    def close(self) -> None:
        self._file.close()


class _CsvWriter:
    """Writes a CSV file, without the columns whose values are lists; unknown values are empty."""

    def __init__(self, path: Path, columns: Columns, categories: Sequence[str]) -> None:
        self._path, self._categories = path, categories
        self._kinds = {name: kind for name, (kind, _) in columns.items() if kind != "list"}
        self._append([list(self._kinds)])

    def write(self, values: _Values) -> None:
        count, part = len(values["frame"]), 1000  # rows that are text at a time
        for start in range(0, count, part):
            cells = (
                self._cells(kind, values[name][start : start + part])
                for name, kind in self._kinds.items()
            )
            self._append(zip(*cells, strict=True))

    def close(self) -> None:
        """Do nothing: the file is closed after every piece, also where the disk is full."""

    def _append(self, rows: Iterable[Sequence[object]]) -> None:
        with self._path.open("a", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)

    def _cells(self, kind: str, values: Sequence[Any] | NDArray[Any]) -> list[object]:
        plain = values.tolist() if isinstance(values, np.ndarray) else values
        if kind == "dictionary":
            return [self._categories[number] for number in plain]
        return [value if value == value else "" for value in plain]  # NaN is not itself


class _Table(GrowingFile):
    """Table that is written in groups of rows.

    Parameters
    ----------
    path: of the file; one that ends in `.csv` is CSV, others are Parquet
    columns: of its table
    categories: strings that a `dictionary` column numbers

    Raises
    ------
    UserError
        When it cannot be written, as where the disk is full; nothing of it is left.
    """

    def __init__(self, path: Path, columns: Columns, categories: Sequence[str] = ()) -> None:
        super().__init__(path)
        kind: Callable[..., _Writer] = _CsvWriter if path.suffix == ".csv" else _ParquetWriter
        with disk_errors(path):
            self._writer = kind(self._part, columns, categories)

    def _finish(self) -> None:
        self._flush()
        self._writer.close()

    def _flush(self) -> None:
        """Write the rows that wait."""
        raise NotImplementedError

    def _write(self, values: _Values) -> None:
        with disk_errors(self._path):
            self._writer.write(values)


class TrackTable(_Table):
    """Table of tracks with the columns TRACKS.

    Parameters
    ----------
    path: of the file
    layers: names of the palette's layers
    rest: position of each marker at rest [px], shape (L, M, 2); NaN where it is not known
    """

    def __init__(self, path: Path, layers: tuple[str, ...], rest: NDArray[np.float64]) -> None:
        super().__init__(path, TRACKS, layers)
        self._rest = rest.reshape(-1, 2)
        # One buffer a column for a whole row group: kept small pieces would lie between the large
        # pictures of a video on the heap, and their memory could not be used again.
        self._columns: dict[str, NDArray[Any]] = {}
        self._rows = 0

    def add(self, index: int, tracks: Tracks) -> None:
        """Append the tracks of frame number `index`."""
        layers, markers = tracks.visible.shape
        size = layers * markers
        if not self._columns:
            rows = max(1, _TRACK_GROUP // size) * size
            for name, (kind, _) in TRACKS.items():
                self._columns[name] = np.empty(rows, "int8" if kind == "dictionary" else kind)
        elif self._rows + size > len(self._columns["frame"]):
            self._flush()
        at = 3 * np.arange(layers)
        hue = np.full((layers, markers), np.nan)
        hue[0] = tracks.hue
        measured = {
            "x_px": tracks.position[..., 0],
            "y_px": tracks.position[..., 1],
            "log_size": tracks.log_size,
            "hue_deg": hue,
            "var_xx_px2": tracks.covariance[:, at, at].T,
            "var_xy_px2": tracks.covariance[:, at, at + 1].T,
            "var_yy_px2": tracks.covariance[:, at + 1, at + 1].T,
        }
        fields: dict[str, Any] = {
            "frame": index,
            "time_s": tracks.time,
            "rest_x_px": self._rest[:, 0],
            "rest_y_px": self._rest[:, 1],
            "layer": np.repeat(np.arange(layers), markers),
            "marker": np.tile(np.arange(markers), layers),
            "visible": tracks.visible.ravel(),
            "ambiguous": tracks.ambiguous.ravel(),
            "last_seen_s": tracks.last_seen.ravel(),
        }
        for name, values in measured.items():
            fields[name] = np.where(tracks.visible, values, np.nan).ravel()
        for name, column in self._columns.items():
            column[self._rows : self._rows + size] = fields[name]
        self._rows += size

    def _flush(self) -> None:
        if self._rows:
            rows, self._rows = self._rows, 0
            self._write({name: column[:rows] for name, column in self._columns.items()})


class EstimateTable(_Table):
    """Table of estimates; as CSV it has no lists, such as the forces on each node.

    Parameters
    ----------
    path: of the file
    columns: FORCES or DISPLACEMENTS
    """

    def __init__(self, path: Path, columns: Columns) -> None:
        super().__init__(path, columns)
        self._names = list(columns)
        self._rows: list[Row] = []

    def add(self, row: Row) -> None:
        """Append a frame's row; None is null."""
        self._rows.append(row)
        group = 1000  # rows of estimates that make a row group
        if len(self._rows) == group:
            self._flush()

    def _flush(self) -> None:
        if self._rows:
            rows, self._rows = self._rows, []
            self._write({name: [row.get(name) for row in rows] for name in self._names})
