"""Tracks and estimates as Parquet tables, written while they come.

Units and meanings of the columns are the metadata of a table's schema.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..folders import GrowingFile, disk_errors
from ..tracking import Tracks

if TYPE_CHECKING:
    import pyarrow as pa

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


def _bounded(stem: str, unit: str, meaning: str) -> Columns:
    """Columns of a value and the ends of its interval."""
    return {
        f"{stem}{unit}": ("float64", meaning),
        f"{stem}_low{unit}": ("float64", "lower end of its interval"),
        f"{stem}_high{unit}": ("float64", "upper end of its interval"),
    }


#: Forces, one row per frame; low and high bound a 90 % interval.
FORCES: Columns = {
    **_FRAME,
    **_bounded("normal", "_n", "sum of the normal forces [N]"),
    **_bounded("friction", "_n", "sum of the friction forces, its magnitude [N]"),
    **_bounded("mu", "", "friction coefficient in use"),
    "mu_observable": ("bool", "whether the frame shows mu, rather than what a press shows"),
    **_bounded("margin", "", "safety margin; null with nothing in contact"),
    **_bounded("limit_margin", "", "margin of friction and torsion together; null for a chain"),
    **_bounded("force_x", "_n", "force of the object on a dome along x [N]; null for a chain"),
    **_bounded("force_y", "_n", "along y [N]"),
    **_bounded("force_z", "_n", "along z, the sensor's axis [N]"),
    **_bounded("torque", "_nmm", "torque of the object about z [N·mm]; null for a chain"),
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


class _Table(GrowingFile):
    """Parquet file that is written in groups of rows.

    Parameters
    ----------
    path: of the file
    columns: of its table

    Raises
    ------
    UserError
        When it cannot be written, as where the disk is full; nothing of it is left.
    """

    def __init__(self, path: Path, columns: Columns) -> None:
        import pyarrow as pa
        from pyarrow.parquet import ParquetWriter

        super().__init__(path)
        kinds = {"list": pa.list_(pa.float32()), "dictionary": pa.dictionary(pa.int8(), "string")}
        self._schema = pa.schema(
            [pa.field(name, kinds.get(kind, kind)) for name, (kind, _) in columns.items()],
            metadata={name: text for name, (_, text) in columns.items()},
        )
        with disk_errors(path):
            self._file = ParquetWriter(self._part, self._schema)

    def _finish(self) -> None:
        self._flush()
        self._file.close()

    def _flush(self) -> None:
        """Write the rows that wait."""
        raise NotImplementedError

    def _write(self, table: "pa.Table") -> None:
        with disk_errors(self._path):
            self._file.write_table(table)


class TrackTable(_Table):
    """Table of tracks with the columns TRACKS.

    Parameters
    ----------
    path: of the file
    layers: names of the palette's layers
    rest: position of each marker at rest [px], shape (L, M, 2); NaN where it is not known
    """

    def __init__(self, path: Path, layers: tuple[str, ...], rest: NDArray[np.float64]) -> None:
        super().__init__(path, TRACKS)
        self._layers, self._rest = layers, rest
        # One buffer for a whole row group: kept small pieces would lie between the large pictures
        # of a video on the heap, and their memory could not be used again.
        size = max(1, rest[..., 0].size)
        kinds = [(n, "i1" if kind == "dictionary" else kind) for n, (kind, _) in TRACKS.items()]
        self._buffer = np.empty(max(1, _TRACK_GROUP // size) * size, kinds)
        self._rows = 0

    def add(self, index: int, tracks: Tracks) -> None:
        """Append the tracks of frame number `index`."""
        layers, markers = shape = tracks.visible.shape
        if self._rows + layers * markers > len(self._buffer):
            self._flush()
        rows = self._buffer[self._rows : self._rows + layers * markers].reshape(shape)
        self._rows += rows.size
        layer = np.arange(layers)
        known: dict[str, Any] = {
            "frame": index,
            "time_s": tracks.time,
            "layer": layer[:, None],
            "marker": np.arange(markers),
            "rest_x_px": self._rest[..., 0],
            "rest_y_px": self._rest[..., 1],
            "visible": tracks.visible,
            "ambiguous": tracks.ambiguous,
            "last_seen_s": tracks.last_seen,
        }
        measured = {
            "x_px": tracks.position[..., 0],
            "y_px": tracks.position[..., 1],
            "log_size": tracks.log_size,
            "hue_deg": np.where(layer[:, None] == 0, tracks.hue, np.nan),
            "var_xx_px2": tracks.covariance[:, 3 * layer, 3 * layer].T,
            "var_xy_px2": tracks.covariance[:, 3 * layer, 3 * layer + 1].T,
            "var_yy_px2": tracks.covariance[:, 3 * layer + 1, 3 * layer + 1].T,
        }
        for name, values in known.items():
            rows[name] = values
        for name, values in measured.items():
            rows[name] = np.where(tracks.visible, values, np.nan)

    def _flush(self) -> None:
        import pyarrow as pa

        rows, self._rows = self._buffer[: self._rows], 0
        if len(rows):  # NaN is null
            arrays = {name: pa.array(rows[name], from_pandas=True) for name in TRACKS}
            arrays["layer"] = pa.DictionaryArray.from_arrays(arrays["layer"], [*self._layers])
            self._write(pa.table(arrays, schema=self._schema))


class EstimateTable(_Table):
    """Table of estimates.

    Parameters
    ----------
    path: of the file
    columns: FORCES or DISPLACEMENTS
    """

    def __init__(self, path: Path, columns: Columns) -> None:
        super().__init__(path, columns)
        self._rows: list[Row] = []

    def add(self, row: Row) -> None:
        """Append a frame's row; None is null."""
        self._rows.append(row)
        group = 1000  # rows of estimates that make a row group
        if len(self._rows) == group:
            self._flush()

    def _flush(self) -> None:
        import pyarrow as pa

        rows, self._rows = self._rows, []
        if rows:
            self._write(pa.Table.from_pylist(rows, self._schema))
