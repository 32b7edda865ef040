"""Damages of strangers' files, drawn by a seed: bytes, keys of JSON, lines of TOML, columns."""

import json
import math
import os
import random
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

#: What a key's value is replaced by; a damage that keeps the type is no damage.
VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 3, 1e308, 10**30, "x", "", "<script>", [], [1.0], {}, {"a": None}, -0.5,
    {"../../x": "y"}, [[[[[[1]]]]]],
)  # fmt: skip
#: What a key or a link is called.
NAMES = ("../../x", "/etc/hostname", "sequence-1", "sequence-000001", "a\nb", "", "sensors/../x")
#: Types that a column is stored with: of any values, of numbers and of lists.
KINDS: tuple[Callable[[list[Any]], pa.Array], ...] = (
    lambda v: pa.array([str(x) for x in v]),
    lambda v: pa.array([str(x).encode() for x in v]),
    lambda v: pa.array([[x] * k for k, x in enumerate(v)]),
    lambda v: pa.array([{"a": x} for x in v]),
    lambda v: pa.nulls(len(v)),
    lambda v: pa.nulls(len(v), pa.float64()),
    lambda v: pa.array([bool(x) for x in v]),
    lambda v: pa.array([None, *v[1:]]),
    lambda v: pa.array(np.full(len(v), 3, "int32")),
    lambda v: pa.array(np.full(len(v), 300_000_000)),
    lambda v: pa.array(np.full(len(v), 3, "timedelta64[s]")),
    lambda v: pa.array([str(x) for x in v]).dictionary_encode(),
    lambda v: pa.array(np.full(len(v), np.inf)),
    lambda v: pa.array(np.full(len(v), 1e308)),
    lambda v: pa.array(v[::-1]),
)
OF_NUMBERS: tuple[Callable[[list[Any]], pa.Array], ...] = (
    lambda v: pa.array(np.asarray(v, float) * (1.0, math.nan, 1e15, -1.0)[len(v) % 4]),
    lambda v: pa.array([*v[:-1], math.nan], pa.float64()),
    lambda v: pa.array(-np.asarray(v, float)),
    lambda v: pa.array(np.asarray(v, "float32")),
)
OF_LISTS: tuple[Callable[[list[Any]], pa.Array], ...] = (
    lambda v: pa.array([x[: 5 + k] for k, x in enumerate(v)]),
    lambda v: pa.array([x[:4] for x in v]),
    lambda v: pa.array([x[:4] for x in v], pa.list_(pa.array(v[0]).type, 4)),
)


def flip(path: Path, draw: random.Random) -> None:
    data = bytearray(path.read_bytes())
    for _ in range(draw.choice((1, 1, 3, 30))):
        data[draw.randrange(len(data))] = draw.randrange(256)
    path.write_bytes(data)


def cut(path: Path, draw: random.Random) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: draw.choice((0, 9, draw.randrange(len(data))))])


def longer(path: Path, draw: random.Random) -> None:
    data = path.read_bytes()
    path.write_bytes(draw.choice((data + draw.randbytes(100), b"\xff\xfe\x00" + data)))


def garbage(path: Path, draw: random.Random) -> None:
    deep = (b"[" * 100_000, b"a = " + b"[" * 50_000, b'{"a":' * 9000)
    path.write_bytes(draw.choice((draw.randbytes(500), *deep, b"\0" * 99)))


def missing(path: Path, draw: random.Random) -> None:
    path.unlink()


def other_kind(path: Path, draw: random.Random) -> None:
    """Folder or pipe in the file's place."""
    path.unlink()
    draw.choice((os.mkdir, os.mkfifo))(path)


def linked(path: Path, draw: random.Random) -> None:
    path.unlink()
    path.symlink_to(draw.choice((path.name, "/dev/zero", "/etc/passwd", "nowhere", ".")))


def inside(path: Path, draw: random.Random) -> None:
    """Damage what a file says; the file stays one of its kind."""
    {".json": key, ".toml": line, ".parquet": column}.get(path.suffix, flip)(path, draw)


def key(path: Path, draw: random.Random) -> None:
    """Take a key away, or give it another value or name."""
    content = json.loads(path.read_text(encoding="utf-8"))
    values, name = content, draw.choice(list(content))
    while isinstance(values[name], dict) and values[name] and draw.random() < 0.7:
        values = values[name]
        name = draw.choice(list(values))
    how = draw.random()
    if how < 0.5:
        values[name] = draw.choice(VALUES)
    else:
        value = values.pop(name)
        if how < 0.7:
            values[draw.choice(NAMES)] = value
    text = json.dumps(content)
    if draw.random() < 0.1:
        other = draw.choice((": NaN", ": Infinity", ": 1e999", ': "\\ud800"'))
        text = text.replace(": null", other)
    path.write_text(text, encoding="utf-8")


def line(path: Path, draw: random.Random) -> None:
    lines = path.read_text(encoding="utf-8").splitlines()
    at = draw.randrange(2, len(lines))
    word = draw.choice(("", "true", "nan", "-1", "1e308", '"x"', "[]", "{}", "[[1]]", "1979-05-27"))
    lines[at] = f"{lines[at].partition('=')[0]} = {word}" if word else draw.choice(lines)
    path.write_text("\n".join(lines), encoding="utf-8")


def column(path: Path, draw: random.Random) -> None:
    """Change a table's columns or number of rows, or a column's type."""
    table = pq.read_table(path)
    at = draw.choice((0, draw.randrange(table.num_columns)))
    name = table.column_names[at]
    what = draw.randrange(6)
    if what == 0:
        table = table.select([]) if draw.random() < 0.2 else table.remove_column(at)
    elif what == 1:
        table = table.append_column(draw.choice((name, "new")), table[name])
    elif what == 2:
        rows = draw.choice((0, 1, 3, max(table.num_rows - 1, 0)))
        table = draw.choice((table.slice(0, rows), pa.concat_tables([table, table])))
    else:
        kind, values = table[name].type, table[name].to_pylist()
        own = OF_LISTS if pa.types.is_fixed_size_list(kind) else ()
        own = OF_NUMBERS if pa.types.is_floating(kind) else own
        table = table.set_column(at, name, draw.choice((*KINDS, *own, *own))(values))
    pq.write_table(table, path)


HARMS = (flip, cut, longer, garbage, missing, other_kind, linked)


def damage(folder: Path, names: Sequence[str], draw: random.Random) -> str:
    """Damage one file of a folder; return which, and how.

    Parameters
    ----------
    names: files, of which one is damaged inside or as a whole
    """
    name = draw.choice(names)
    harm = inside if draw.random() < 0.5 else draw.choice(HARMS)
    harm(folder / name, draw)
    return f"{harm.__name__} {name}"
