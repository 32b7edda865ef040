"""Parquet tables of labels; their Arrow types follow from the columns."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...extras import need
from ...output.parquet import FORCES
from .columns import COMMON, READING, Column, Columns
from .shot import Shot

if TYPE_CHECKING:
    import pyarrow as pa

#: What to do about a damaged file of a dataset.
MEND = "copy the dataset again, or make it again with dataset make --resume"


def frame_types(columns: Columns) -> "dict[str, pa.DataType]":
    """Arrow type of each column of `frames.parquet`."""
    pa = need("pyarrow", "data")
    # Columns of frames and of lists that are no floating-point numbers.
    whole, words = ("frame", "contact_nodes"), ("slip_state",)
    kinds = {
        **dict.fromkeys(columns.frame, "float64"),
        **dict.fromkeys(whole, "int32"),
        **dict.fromkeys(words, "string"),
        **{name: FORCES[of][0] for name, of in READING.items()},
    }
    return {name: pa.type_for_alias(kinds[name]) for name in columns.frame}


def marker_types(columns: Columns) -> "dict[str, pa.DataType]":
    """Arrow type of each column of `markers.parquet`; lists have no fixed length."""
    pa = need("pyarrow", "data")
    lists = (*columns.markers, *columns.nodes)
    flags = ("visible", "node_contact", "node_slips")
    return {"frame": pa.int32()} | {
        name: pa.list_(pa.bool_() if name in flags else pa.float32()) for name in lists
    }


def frame_table(rows: list[Shot], columns: Columns) -> "pa.Table":
    """Arrow table of the values of frames, one row per frame."""
    pa = need("pyarrow", "data")
    made = {
        name: pa.array([row.values[name] for row in rows], kind)
        for name, kind in frame_types(columns).items()
    }
    return _with_meaning(pa.table(made), columns.frame)


def marker_table(rows: list[Shot], columns: Columns) -> "pa.Table":
    """Arrow table of markers and nodes, one row of lists per frame."""
    pa = need("pyarrow", "data")
    made = {"frame": pa.array([int(row.values["frame"]) for row in rows], pa.int32())}
    for name in columns.markers:
        made[name] = _lists([row.markers[name] for row in rows])
    for name in columns.nodes:
        made[name] = _lists([row.nodes[name] for row in rows])
    meaning = {"frame": COMMON["frame"], **columns.markers, **columns.nodes}
    return _with_meaning(pa.table(made), meaning)


def _lists(values: list[Any]) -> "pa.Array":
    """Arrow array of equally long lists; float32 resolves 0.05 nm and 0.00006 px."""
    pa = need("pyarrow", "data")
    stacked = np.stack(values)
    flat = stacked.ravel() if stacked.dtype == bool else stacked.astype(np.float32).ravel()
    return pa.FixedSizeListArray.from_arrays(pa.array(flat), stacked.shape[1])


def _with_meaning(table: "pa.Table", columns: dict[str, Column]) -> "pa.Table":
    """Store the meaning of each column in the table's metadata."""
    meaning = {name: of.meaning.encode() for name, of in columns.items()}
    return table.replace_schema_metadata(meaning)


def to_parquet(table: "pa.Table") -> bytes:
    """Write a table as the bytes of a Parquet file."""
    pa, pq = need("pyarrow", "data"), need("pyarrow.parquet", "data")
    # Numbers do not repeat, but their signs and exponents do: bytes of equal rank lie together.
    split = [
        f"{field.name}.list.element"
        for field in table.schema
        if pa.types.is_fixed_size_list(field.type) and field.type.value_type == pa.float32()
    ]
    sink = pa.BufferOutputStream()
    pq.write_table(
        table, sink, compression="zstd", use_dictionary=False, use_byte_stream_split=split
    )
    return sink.getvalue().to_pybytes()


def read_table(
    path: Path, rows: int, types: "Mapping[str, pa.DataType]", others: bool = False
) -> "pa.Table":
    """Read columns of a Parquet file; check its metadata before decoding.

    Parameters
    ----------
    path: path of the file
    rows: required number of rows
    types: types of the columns to read; none of their values may be missing
    others: whether to read all other columns too, of any type

    Raises
    ------
    UserError
        When the file is damaged or too large, or has the wrong number of rows, columns or types.
    """
    pa, pq = need("pyarrow", "data"), need("pyarrow.parquet", "data")
    try:
        with pq.ParquetFile(path) as file:
            found = file.metadata.num_rows
            if found != rows:
                raise damaged(path, f"it has {found} rows, expected {rows}")
            names = file.schema_arrow.names
            if missing := [name for name in types if names.count(name) != 1]:
                raise damaged(path, f"it must have one column {missing[0]}")
            _check_size(path, file.metadata)
            table = file.read(columns=None if others else list(types))
            table.validate(full=True)
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or str(error).partition("\n")[0]
        raise damaged(path, reason) from None
    for name, kind in types.items():
        _check_column(path, name, table[name], kind)
    return table


def damaged(path: Path, reason: str) -> UserError:
    """Make the error for a damaged file of a dataset."""
    return UserError(f"{path} is damaged: {reason}; {MEND}")


def _check_size(path: Path, metadata: Any) -> None:
    """Refuse a table that would need too much memory; a small file may decode to a large table."""
    size = 0
    width = 4  # bytes of a value in memory, about
    for group in map(metadata.row_group, range(metadata.num_row_groups)):
        for column in map(group.column, range(group.num_columns)):
            size += max(width * column.num_values, column.total_uncompressed_size)
    most_bytes = 2**30  # largest table in memory [bytes], estimated before it is decoded
    if size > most_bytes:
        most = f"{most_bytes / 1e9:.1f} GB"
        raise damaged(path, f"it would take {size / 1e9:.1f} GB of memory, more than {most}")


def _check_column(path: Path, name: str, column: "pa.ChunkedArray", kind: "pa.DataType") -> None:
    """Refuse a column with another type, missing values, or lists of different lengths."""
    pa, pc = need("pyarrow", "data"), need("pyarrow.compute", "data")
    own, missing = column.type, column.null_count
    if pa.types.is_list(kind) and (pa.types.is_list(own) or pa.types.is_fixed_size_list(own)):
        own = pa.list_(own.value_type)
        missing += pc.list_flatten(column).null_count
    if own != kind:
        raise damaged(path, f"column {name} holds {own}, expected {kind}")
    if missing:
        raise damaged(path, f"column {name} has values that are missing")
    if pa.types.is_list(kind):
        lengths = pc.unique(pc.list_value_length(column))
        if len(lengths) != 1:
            raise damaged(path, f"column {name} has lists of {len(lengths)} lengths, expected one")


def stacked(column: "pa.ChunkedArray") -> NDArray[Any]:
    """Convert a column of lists to an array with one list per row."""
    lists = column.combine_chunks()
    flat = lists.flatten().to_numpy(zero_copy_only=False)
    return np.asarray(flat.reshape(len(lists), -1))
