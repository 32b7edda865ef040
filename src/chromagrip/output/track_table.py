"""Tracks as a Parquet file, written while they come."""

from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..extras import need
from ..tracking import Tracks

#: Arrow type of every column and what it holds; a null is what was not seen or not measured.
COLUMNS: dict[str, tuple[str, str]] = {
    "frame": ("int32", "number of the frame in the source, from 0"),
    "time_s": ("float64", "time of the frame [s]"),
    "layer": ("dictionary", "name of the layer in the palette"),
    "marker": ("int32", "number of the marker; layers share it that lie on each other at rest"),
    "x_px": ("float64", "middle of the marker's image, rightwards, pixel centres at integers"),
    "y_px": ("float64", "middle of the marker's image, downwards"),
    "log_size": ("float64", "natural logarithm of the size over the size at rest"),
    "hue_deg": ("float64", "mean hue over the first layer's marker [°], in that layer's rows"),
    "visible": ("bool", "found in this frame"),
    "ambiguous": ("bool", "found, but its number is not certain"),
    "last_seen_s": ("float64", "time of the last frame in which it was found [s]"),
    "var_xx_px2": ("float64", "variance of x [px²]"),
    "var_xy_px2": ("float64", "covariance of x and y [px²]"),
    "var_yy_px2": ("float64", "variance of y [px²]"),
}
#: About so many rows make a row group, which is written when it is full.
_GROUP = 100_000


class TrackTable:
    """Parquet file of tracks, one row per frame, layer and marker.

    Written beside its final name and renamed when closed, so that a cut file never looks whole.

    Parameters
    ----------
    path: of the file
    layers: names of the palette's layers
    """

    def __init__(self, path: Path, layers: tuple[str, ...]) -> None:
        self._path = path
        self._part = path.with_name(path.name + ".part")
        pa, pq = need("pyarrow", "data"), need("pyarrow.parquet", "data")
        self._layers = pa.array(layers)
        meaning = {name: text for name, (_, text) in COLUMNS.items()}
        kinds = {"dictionary": pa.dictionary(pa.int8(), pa.string())}
        self._schema = pa.schema(
            [pa.field(name, kinds.get(kind, kind)) for name, (kind, _) in COLUMNS.items()],
            metadata=meaning,
        )
        self._writer = pq.ParquetWriter(self._part, self._schema)
        # One buffer a column for a whole row group: kept small pieces would lie between the large
        # pictures of a video on the heap, and their memory could not be used again.
        self._columns: dict[str, NDArray[Any]] = {}
        self._rows = 0

    def __enter__(self) -> "TrackTable":
        """Use as a context: closed and renamed even after an interruption."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Finish the file and give it its name."""
        if self._rows:
            self._flush()
        self._writer.close()
        self._part.replace(self._path)

    def add(self, index: int, tracks: Tracks) -> None:
        """Append the tracks of frame number `index`."""
        layers, markers = tracks.visible.shape
        size = layers * markers
        if not self._columns:
            self._allocate(max(1, _GROUP // size) * size)
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
        rows: dict[str, Any] = {
            "frame": index,
            "time_s": tracks.time,
            "layer": np.repeat(np.arange(layers), markers),
            "marker": np.tile(np.arange(markers), layers),
            "visible": tracks.visible.ravel(),
            "ambiguous": tracks.ambiguous.ravel(),
            "last_seen_s": tracks.last_seen.ravel(),
        }
        for name, values in measured.items():
            rows[name] = np.where(tracks.visible, values, np.nan).ravel()
        for name, column in self._columns.items():
            column[self._rows : self._rows + size] = rows[name]
        self._rows += size

    def _allocate(self, rows: int) -> None:
        for name, (kind, _) in COLUMNS.items():
            self._columns[name] = np.empty(rows, "int8" if kind == "dictionary" else kind)

    def _flush(self) -> None:
        pa = need("pyarrow", "data")
        filled = {name: column[: self._rows] for name, column in self._columns.items()}
        arrays = [
            pa.DictionaryArray.from_arrays(pa.array(values), self._layers)
            if name == "layer"
            else pa.array(values, from_pandas=True)  # NaN is null
            for name, values in filled.items()
        ]
        self._writer.write_table(pa.Table.from_arrays(arrays, schema=self._schema))
        self._rows = 0
