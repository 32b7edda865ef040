"""Tables of labels: arrays by column, kept as Parquet."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...output.parquet import FORCES
from .columns import COMMON, READING, Column, Columns
from .shot import Shot

if TYPE_CHECKING:
    import pyarrow as pa

#: What to do about a damaged file of a dataset.
MEND = "copy the dataset again, or make it again with dataset make --resume"
#: Columns by name: values (T,), or lists of one length (T, L).
Table = dict[str, NDArray[Any]]
#: Kind of each column: `float64`, `int32`, `bool`, `string`, or `list` of `float` or `bool`.
Kinds = Mapping[str, str]
#: NumPy types of the kinds.
_DTYPES = {
    "float64": np.float64, "int32": np.int32, "bool": np.bool_,
    "list float": np.float32, "list bool": np.bool_,
}  # fmt: skip


def frame_kinds(columns: Columns) -> Kinds:
    """Kind of each column of the table `frames`."""
    # Columns of frames and of lists that are no floating-point numbers.
    whole, words = ("frame", "contact_nodes"), ("slip_state",)
    kinds = {
        **dict.fromkeys(columns.frame, "float64"),
        **dict.fromkeys(whole, "int32"),
        **dict.fromkeys(words, "string"),
        **{name: FORCES[of][0] for name, of in READING.items()},
    }
    return {name: kinds[name] for name in columns.frame}


def marker_kinds(columns: Columns) -> Kinds:
    """Kind of each column of the table `markers`; lists have no fixed length."""
    flags = ("visible", "node_contact", "node_slips")
    return {"frame": "int32"} | {
        name: f"list {'bool' if name in flags else 'float'}"
        for name in (*columns.markers, *columns.nodes)
    }


def frame_table(rows: list[Shot], columns: Columns) -> Table:
    """Values of frames, one row per frame."""
    return {
        name: np.array(
            [row.values[name] for row in rows], object if kind == "string" else _DTYPES[kind]
        )
        for name, kind in frame_kinds(columns).items()
    }


def marker_table(rows: list[Shot], columns: Columns) -> Table:
    """Values of markers and nodes, one row of lists per frame; float32 resolves 0.00006 px."""
    made: Table = {"frame": np.array([int(row.values["frame"]) for row in rows], np.int32)}
    for name in columns.markers:
        made[name] = np.stack([row.markers[name] for row in rows])
    for name in columns.nodes:
        made[name] = np.stack([row.nodes[name] for row in rows])
    kinds = marker_kinds(columns)
    return {name: values.astype(_DTYPES[kinds[name]]) for name, values in made.items()}


def frame_meanings(columns: Columns) -> dict[str, Column]:
    """Description of each column of the table `frames`."""
    return dict(columns.frame)


def marker_meanings(columns: Columns) -> dict[str, Column]:
    """Description of each column of the table `markers`."""
    return {"frame": COMMON["frame"], **columns.markers, **columns.nodes}


def table_bytes(table: Table, meanings: Mapping[str, Column]) -> bytes:
    """Bytes of the Parquet file of a table."""
    import pyarrow as pa

    made = pa.table({key: _arrow(value) for key, value in table.items()})
    meaning = {key: of.meaning.encode() for key, of in meanings.items()}
    return _parquet(made.replace_schema_metadata(meaning))


def rows_bytes(rows: Sequence[Mapping[str, Any]]) -> bytes:
    """Bytes of the Parquet file of a table of any values.

    Raises
    ------
    UserError
        When values of a column have no common type.
    """
    import pyarrow as pa

    keys = list(dict.fromkeys(key for row in rows for key in row))
    try:
        return _parquet(pa.table({key: pa.array([row.get(key) for row in rows]) for key in keys}))
    except (pa.ArrowException, OverflowError) as error:  # of values that a stranger gave
        raise UserError(f"drawn values of the sequences fit in no table: {error}") from None


def _arrow(values: NDArray[Any]) -> "pa.Array":
    """Arrow array of a column."""
    import pyarrow as pa

    if values.ndim == 1:
        return pa.array(values, pa.string() if values.dtype == object else None)
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])


def _parquet(table: "pa.Table") -> bytes:
    """Write a table as the bytes of a Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

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
    return bytes(sink.getvalue().to_pybytes())


def read_table(path: Path, rows: int, kinds: Kinds, others: bool = False) -> Table:
    """Read columns of a table; check its metadata before decoding.

    Parameters
    ----------
    path: path of the file
    rows: required number of rows
    kinds: kinds of the columns to read; none of their values may be missing
    others: whether to read all other columns too, of any kind

    Raises
    ------
    UserError
        When the file is damaged or too large, or has the wrong number of rows, columns or types.
    """
    table = _arrow_table(path, rows, kinds, others)
    return {name: _values(table[name]) for name in table.column_names}


def read_rows(path: Path, rows: int, kinds: Kinds) -> list[dict[str, Any]]:
    """Read a Parquet table of any values, row by row; parameters and errors as in `read_table`."""
    return list(_arrow_table(path, rows, kinds, others=True).to_pylist())


def _arrow_table(path: Path, rows: int, kinds: Kinds, others: bool) -> "pa.Table":
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            found = file.metadata.num_rows
            if found != rows:
                raise damaged(path, f"it has {found} rows, expected {rows}")
            names = file.schema_arrow.names
            if absent := [name for name in kinds if names.count(name) != 1]:
                raise damaged(path, f"it must have one column {absent[0]}")
            _check_size(path, file.metadata)
            table = file.read(columns=None if others else list(kinds))
            table.validate(full=True)
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or str(error).partition("\n")[0]
        raise damaged(path, reason) from None
    for name, kind in kinds.items():
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


def _check_column(path: Path, name: str, column: "pa.ChunkedArray", kind: str) -> None:
    """Refuse a column with another type, missing values, or lists of different lengths."""
    import pyarrow as pa
    import pyarrow.compute as pc

    own, absent = column.type, column.null_count
    words = kind.split()
    lists = len(words) > 1
    expected = pa.type_for_alias(words[-1])
    expected = pa.list_(expected) if lists else expected
    if lists and (pa.types.is_list(own) or pa.types.is_fixed_size_list(own)):
        own = pa.list_(own.value_type)
        absent += pc.list_flatten(column).null_count
    if own != expected:
        raise damaged(path, f"column {name} holds {own}, expected {expected}")
    if absent:
        raise damaged(path, f"column {name} has values that are missing")
    if lists:
        lengths = pc.unique(pc.list_value_length(column))
        if len(lengths) != 1:
            raise damaged(path, f"column {name} has lists of {len(lengths)} lengths, expected one")


def _values(column: "pa.ChunkedArray") -> NDArray[Any]:
    """Convert a column to an array, lists of one length to one with a list per row."""
    import pyarrow as pa

    own = column.type
    if not (pa.types.is_list(own) or pa.types.is_fixed_size_list(own)):
        return np.asarray(column.to_numpy())
    lists = column.combine_chunks()
    flat = lists.flatten().to_numpy(zero_copy_only=False)
    if len(lists) and len(flat) % len(lists):  # a stranger's lists, which nobody reads
        return np.array(lists.to_pylist(), object)
    return np.asarray(flat.reshape(len(lists), -1))
