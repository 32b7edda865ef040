"""Estimates as a Parquet file, written while they come."""

from pathlib import Path
from types import TracebackType
from typing import Any, Self

from ..extras import need

_F = "float64"
_NODES = "list"

_FRAME: dict[str, tuple[str, str]] = {
    "frame": ("int32", "number of the frame in the source, from 0"),
    "time_s": (_F, "time of the frame [s]"),
    "markers_seen": ("int32", "marker pairs found in the frame"),
    "no_estimate": ("string", "why the frame says nothing; empty when it does"),
}
#: Arrow type of every column of forces and what it holds; low and high bound a 90 % interval.
FORCES = _FRAME | {
    "normal_n": (_F, "sum of the normal forces [N]"),
    "normal_low_n": (_F, "lower end of its interval"),
    "normal_high_n": (_F, "upper end of its interval"),
    "friction_n": (_F, "sum of the friction forces, its magnitude [N]"),
    "friction_low_n": (_F, "lower end of its interval"),
    "friction_high_n": (_F, "upper end of its interval"),
    "mu": (_F, "friction coefficient in use"),
    "mu_low": (_F, "lower end of its interval"),
    "mu_high": (_F, "upper end of its interval"),
    "mu_observable": ("bool", "whether the frame shows mu, rather than what a press shows"),
    "margin": (_F, "safety margin; null with nothing in contact"),
    "margin_low": (_F, "lower end of its interval"),
    "margin_high": (_F, "upper end of its interval"),
    "node_normal_n": (_NODES, "normal force on each node of the chain [N]"),
    "node_friction_n": (_NODES, "friction on each node of the chain [N]"),
}
#: The same of displacements, of a flat pad.
DISPLACEMENTS = _FRAME | {
    "depth_mm": (_F, "displacement into the pad, 95 % quantile over the markers [mm]"),
    "shift_x_mm": (_F, "mean displacement along x of markers at least half as deep [mm]"),
    "shift_y_mm": (_F, "the same along y"),
    "deviation_mm": (_F, "typical standard deviation of a single marker's depth [mm]"),
    "marker_x_mm": (_NODES, "displacement of the skin at each marker along x [mm]"),
    "marker_y_mm": (_NODES, "along y"),
    "marker_depth_mm": (_NODES, "into the pad"),
}
#: What a summary tells of the columns that there are: in words, and the unit.
VALUES = {
    "normal_n": ("normal force", " N"),
    "friction_n": ("friction force", " N"),
    "mu": ("friction coefficient", ""),
    "margin": ("safety margin", ""),
    "depth_mm": ("displacement into the pad", " mm"),
    "shift_x_mm": ("along x", " mm"),
    "shift_y_mm": ("along y", " mm"),
}
#: So many rows make a row group, which is written when it is full.
_GROUP = 1000

Columns = dict[str, tuple[str, str]]


class EstimateTable:
    """Parquet file, one row per frame.

    Written beside its final name and renamed when closed, so that a cut file never looks whole.

    Parameters
    ----------
    path: of the file
    columns: FORCES or DISPLACEMENTS
    """

    def __init__(self, path: Path, columns: Columns) -> None:
        self._path = path
        self._part = path.with_name(path.name + ".part")
        pa, pq = need("pyarrow", "data"), need("pyarrow.parquet", "data")
        meaning = {name: text for name, (_, text) in columns.items()}
        kinds = {_NODES: pa.list_(pa.float32())}
        fields = [pa.field(name, kinds.get(kind, kind)) for name, (kind, _) in columns.items()]
        self._schema = pa.schema(fields, metadata=meaning)
        self._writer = pq.ParquetWriter(self._part, self._schema)
        self._rows: list[dict[str, Any]] = []

    def __enter__(self) -> Self:
        """Use as a context: closed and renamed even after an interruption."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Finish the file and give it its name."""
        self._flush()
        self._writer.close()
        self._part.replace(self._path)

    def add(self, row: dict[str, Any]) -> None:
        """Append a frame's row; None is null."""
        self._rows.append(row)
        if len(self._rows) == _GROUP:
            self._flush()

    def _flush(self) -> None:
        if self._rows:
            pa = need("pyarrow", "data")
            self._writer.write_table(pa.Table.from_pylist(self._rows, self._schema))
            self._rows = []
