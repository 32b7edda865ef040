"""Digests of results: for each file, one for each column, key, row, topic or picture."""

import csv
import hashlib
import json
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

#: Digests of a file, by the part that each is of.
Parts = dict[str, str]

#: Keys and columns that no two runs have in common: times, what follows from times (the front of a
#: chart), and what a machine has installed.
CHANGING = re.compile(
    "frames_per_second|reading_ms|late_frames|versions|machine|wall_time_s|first_frame_s|setup_s"
    "|milliseconds|fastest|slowest|front of .*"
)
#: Units of rows that are a speed or a time of the program.
CLOCK_UNITS = {"frames/s", "fields/s", "steps/s", "1/s", "ms", "µs/step", "min"}
#: Units that are such in rows whose names say speed; elsewhere a second is one of the simulation.
SPEED_UNITS = {"s", "×", "MB"}
#: Names of further rows of the clock or of the memory of the program, with any unit.
CLOCKED = re.compile(
    "memory|cpu_|times_real_time|times_as_fast|speed_up|^cost/|^dataset/share/|over_pyrender"
    "|two_processes_over_one|^dome/build/(first|from_cache)$|/late$"
)
#: Longest value that stands for itself in place of a digest [characters].
LONGEST = 40
#: It stands in the line of a page that tells the speed of a run.
SPEED = b"<td>speed of the loop</td>"


def digests(folder: Path, ignored: Iterable[str] = ()) -> dict[str, Parts]:
    """Digests of every file of a folder, by its path in it.

    Parameters
    ----------
    ignored: patterns of the files that are left out
    """
    names = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    kept = (name for name in names if not any(fnmatch(name, pattern) for pattern in ignored))
    return {name: of_file(folder / name) for name in kept}


def of_file(path: Path) -> Parts:
    """Digests of a file."""
    return _KINDS.get(path.suffix, _bytes)(path)


def digest(data: bytes) -> str:
    """First hex digits of a SHA-256."""
    return hashlib.sha256(data).hexdigest()[:16]


def read_columns(path: Path) -> dict[str, Any]:
    """Columns of a table in a Parquet or CSV file."""
    if path.suffix == ".parquet":
        table = pq.read_table(path)
        return {name: table[name] for name in table.column_names}
    with path.open(encoding="utf-8", newline="") as file:
        header, *lines = csv.reader(file)
    columns = {name: [line[at] for line in lines] for at, name in enumerate(header)}
    return {name: column for name, column in columns.items() if not CHANGING.fullmatch(name)}


def read_entries(path: Path) -> dict[str, object]:
    """Values in a JSON or TOML file by keys, without those that change from run to run."""
    loads = tomllib.loads if path.suffix == ".toml" else json.loads
    return dict(_entries(loads(path.read_text(encoding="utf-8")), ""))


def _entries(value: Any, name: str) -> Iterable[tuple[str, object]]:
    if isinstance(value, Mapping):
        inner = {str(key): each for key, each in value.items() if not CHANGING.fullmatch(key)}
    elif isinstance(value, list) and value and all(_is_row(each) for each in value):
        inner = {each["name"]: each for each in value if not timed(each)}
    elif isinstance(value, list) and any(isinstance(each, dict | list) for each in value):
        inner = {str(number): each for number, each in enumerate(value)}
    else:
        yield name, value
        return
    for key, each in inner.items():
        yield from _entries(each, f"{name} {key}" if name else key)


def _is_row(value: object) -> bool:
    return isinstance(value, dict) and "name" in value


def timed(row: Mapping[str, object]) -> bool:
    """Whether a row of a report is of the clock or of the memory of the program."""
    name, unit = str(row["name"]), row.get("unit")
    in_speeds = "speed" in name and unit in SPEED_UNITS
    return unit in CLOCK_UNITS or in_speeds or CLOCKED.search(name) is not None


def _of_columns(path: Path) -> Parts:
    return {name: digest(_column_bytes(column)) for name, column in read_columns(path).items()}


def _column_bytes(column: Any) -> bytes:
    if isinstance(column, list):
        return json.dumps(column).encode()
    table = pa.table({"": column.combine_chunks()})
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema) as stream:
        stream.write_table(table)
    return bytes(sink.getvalue())


def _of_entries(path: Path) -> Parts:
    texts = {key: json.dumps(value, default=str) for key, value in read_entries(path).items()}
    return {k: t if len(t) <= LONGEST else digest(t.encode()) for k, t in texts.items()}


def _of_picture(path: Path) -> Parts:
    return {"pixels": digest(read_pixels(path).tobytes()), **_bytes(path)}


def read_pixels(path: Path) -> np.ndarray[Any, Any]:
    """Levels of a picture."""
    levels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if levels is None:
        raise ValueError(f"{path} is no picture")
    return levels


def _of_video(path: Path) -> Parts:
    import av

    whole = hashlib.sha256()
    with av.open(str(path)) as file:
        for frame in file.decode(video=0):
            whole.update(frame.to_ndarray(format="rgb24").tobytes())
    return {"pixels": whole.hexdigest()[:16], **_bytes(path)}


def _of_log(path: Path) -> Parts:
    """Digests of a log by topic."""
    from mcap.reader import make_reader

    topics: dict[str, Any] = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            topic = topics.setdefault(channel.topic, hashlib.sha256())
            topic.update(b"%d " % message.log_time + message.data)
    return {topic: whole.hexdigest()[:16] for topic, whole in topics.items()}


def _of_page(path: Path) -> Parts:
    lines = path.read_bytes().splitlines(keepends=True)
    return {"bytes": digest(b"".join(line for line in lines if SPEED not in line))}


def _bytes(path: Path) -> Parts:
    return {"bytes": digest(path.read_bytes())}


_KINDS: dict[str, Callable[[Path], Parts]] = {
    ".parquet": _of_columns,
    ".csv": _of_columns,
    ".json": _of_entries,
    ".toml": _of_entries,
    ".png": _of_picture,
    ".mp4": _of_video,
    ".mkv": _of_video,
    ".mcap": _of_log,
    ".html": _of_page,
}
