"""The file of a trace, a Parquet table.

It may be a stranger's: it is checked before it is decoded.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...strange_files import shortened

Array = NDArray[np.float64]

#: Name of the file in a run folder.
TRACE = "trace.parquet"
#: Name of the video beside it, which a run may lack.
VIDEO = "tactile.mp4"
#: Largest number of rows that is read.
MOST_ROWS = 2_000_000
#: Largest value of a column.
LARGEST = 1e12
#: What mends a damaged run folder.
MEND = "take a whole copy of the folder, or run its scene again"


def write_trace(path: Path, columns: Mapping[str, Array], meanings: Mapping[str, str]) -> None:
    """Write a trace; errors of the disk are an `OSError`.

    Parameters
    ----------
    path: path of the file
    columns: columns by name
    meanings: meaning of each column that is written
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table({name: pa.array(columns[name]) for name in meanings})
    encoded = {name: text.encode() for name, text in meanings.items()}
    pq.write_table(table.replace_schema_metadata(encoded), path)


def read_trace(
    path: Path, names: list[str], later: tuple[str, ...] = (), max_rows: int = MOST_ROWS
) -> dict[str, Array]:
    """Read columns of a trace.

    Parameters
    ----------
    path: path of the file
    names: names of the columns
    later: endings of the names of columns that may be missing
    max_rows: largest number of rows, checked before they are read

    Raises
    ------
    UserError
        When it cannot be read, lacks a column, or has values that no trace has.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            rows, schema = file.metadata.num_rows, file.schema_arrow
            if not 0 < rows <= max_rows:
                allowed = f"a run has 1 to {max_rows}; for more give --max-rows N"
                raise UserError(f"{path} has {rows} rows; {allowed}")
            there = _there(path, names, later, schema.names)
            for name in there:  # checked before they are decoded
                kind = str(schema.field(name).type)
                if not kind.startswith(("double", "float", "halffloat", "int", "uint")):
                    said = f"column {name} holds {shortened(kind)}, not numbers"
                    raise UserError(f"{path}: {said}; {MEND}")
            table = file.read(columns=there)
        columns = {name: table[name].cast("float64").to_numpy() for name in there}
    except UserError:
        raise
    except (OSError, ValueError, pa.ArrowException) as error:
        reason = shortened(str(error).split("\n")[0], 200)
        raise UserError(f"{path} cannot be read as a trace: {reason}; {MEND}") from None
    _check_values(path, columns)
    return columns


def _there(path: Path, names: list[str], later: tuple[str, ...], found: list[str]) -> list[str]:
    """Those of some columns that a table has; refuses one that is missing, or there twice."""
    there = [name for name in names if name in found or not name.endswith(later)]
    for name in sorted(there):
        count = found.count(name)
        if count != 1:
            wrong = "no column" if count == 0 else f"{count} columns"
            raise UserError(f"{path} has {wrong} {name}; {MEND}")
    return there


def _check_values(path: Path, columns: Mapping[str, Array]) -> None:
    """Refuse times that do not rise, and values that no run has."""
    time, latest = columns["time_s"], 1e6  # [s]
    if not (np.isfinite(time).all() and time[0] >= 0.0 and time[-1] <= latest):
        raise UserError(f"{path}: column time_s must hold times of 0 to {latest:g} s; {MEND}")
    late = np.flatnonzero(np.diff(time) <= 0.0)
    if len(late):
        raise UserError(f"{path}: column time_s does not rise at row {late[0] + 1}; {MEND}")
    for name, values in columns.items():
        wrong = np.flatnonzero(np.isfinite(values) & (abs(values) > LARGEST))
        if len(wrong):
            place = f"column {name} is {values[wrong[0]]:g} at row {wrong[0]}"
            raise UserError(f"{path}: {place}, allowed is at most {LARGEST:g}; {MEND}")
