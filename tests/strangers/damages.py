"""Damages of strangers' files: bytes, keys of JSON, words and lines of text, columns, arrays."""

import json
import os
import random
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from hypothesis import note

#: What a key's value is replaced by; a damage that keeps the type is no damage.
VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 3, 1e308, 10**30, "x", "", "<script>", [], [1.0], {}, {"a": None}, -0.5,
    {"../../x": "y"}, [[[[[[1]]]]]],
)  # fmt: skip
#: What a word of a text is replaced by.
WORDS = (
    "", "true", "nan", "-inf", "-1", "0", "3", "1e308", "1e400", "9" * 5000, "1e-320",
    "0x7fffffffffffffff", '"x"', '""', "[]", "{}", "[nan]", "[[1]]", "[" * 3000, "{a = {b = {}}}",
    "{a: {b: c}}", "1979-05-27", f'"{"a" * 5000}"', '"\\u0000"', "\x1b[2J", "é\u202e", "&x", "*x",
    '"nowhere:Class"', '"../../x"', '"/etc/hostname"', "<a>", ";", ",", "\0",
)  # fmt: skip
#: What a key is called.
NAMES = ("../../x", "/etc/hostname", "sequence-1", "sequence-000001", "a\nb", "", "sensors/../x")
#: What a column is replaced by.
COLUMNS: tuple[Callable[[list[Any]], pa.Array], ...] = (
    lambda v: pa.array([str(x) for x in v]), lambda v: pa.array([[x] * k for k, x in enumerate(v)]),
    lambda v: pa.array([{"a": x} for x in v]), lambda v: pa.nulls(len(v), pa.float64()),
    lambda v: pa.array([bool(x) for x in v]), lambda v: pa.array([None, *v[1:]]),
    lambda v: pa.array(np.full(len(v), 3, "int32")), lambda v: pa.array([300_000_000] * len(v)),
    lambda v: pa.array(np.full(len(v), 3, "timedelta64[s]")), lambda v: pa.array(v[::-1]),
    lambda v: pa.array([str(x) for x in v]).dictionary_encode(), lambda v: pa.array([1e9] * len(v)),
    lambda v: pa.array([x[: 5 + k] if isinstance(x, list) else -x for k, x in enumerate(v)]),
    lambda v: pa.array([np.nan] * len(v)), lambda v: pa.array(np.full(len(v), 3, "float32")),
)  # fmt: skip
#: What an array of an archive is replaced by.
ARRAYS: tuple[Callable[[np.ndarray], np.ndarray], ...] = (
    lambda v: v[:0], lambda v: v[..., None], lambda v: v.T, lambda v: v[:-1], lambda v: v[None],
    lambda v: v.astype(str), lambda v: v.astype(complex), lambda v: v.astype(object),
    lambda v: np.zeros(v.shape, "M8[s]"), lambda v: np.full(v.shape, np.nan),
    lambda v: np.full(v.shape, -1), lambda v: np.zeros(()), lambda v: np.full(v.shape, 1e308),
    lambda v: np.zeros(v.shape, "V3"),
)  # fmt: skip


def key(path: Path, draw: random.Random) -> None:
    """Take a key of JSON away, or give it another value or name."""
    content = json.loads(path.read_text(encoding="utf-8"))
    values, name = content, draw.choice(list(content))
    while isinstance(values[name], dict) and values[name] and draw.random() < 0.7:
        values = values[name]
        name = draw.choice(list(values))
    how, value = draw.random(), values.pop(name)
    if how < 0.7:
        values[name if how < 0.5 else draw.choice(NAMES)] = draw.choice((value, *VALUES))
    found = json.dumps(content)
    if draw.random() < 0.1:
        found = found.replace(": null", draw.choice((": NaN", ": 1e999", ': "\\ud800"')))
    path.write_text(found, encoding="utf-8")


def text(path: Path, draw: random.Random) -> None:
    """Change some words of a text, or take lines away or put them elsewhere."""
    lines = path.read_text(encoding="utf-8").splitlines()
    for _ in range(draw.choice((1, 1, 2, 4))):
        at = draw.randrange(len(lines))
        found = list(re.finditer(r"[-+.\w]+|\"[^\"]*\"", lines[at]))
        if found and draw.random() < 0.8:
            old = draw.choice((found[-1], draw.choice(found)))
            lines[at] = lines[at][: old.start()] + draw.choice(WORDS) + lines[at][old.end() :]
        elif len(lines) > 1:
            one = lines.pop(at)
            if draw.random() < 0.5:
                lines.insert(draw.randrange(len(lines)), one)
    path.write_text("\n".join(lines), encoding="utf-8")


def array(path: Path, draw: random.Random) -> None:
    """Change an array of an archive or its name, or take it away; a lone array is changed."""
    if path.suffix == ".npy":
        np.save(path, draw.choice(ARRAYS)(np.load(path)))
        return
    arrays = dict(np.load(path))
    how, name = draw.random(), draw.choice(list(arrays))
    value = arrays.pop(name)
    if how < 0.85:
        other = name if how < 0.7 else draw.choice(("new", "../x", name.upper()))
        arrays[other] = draw.choice(ARRAYS)(value)
    np.savez(path, **arrays)


def column(path: Path, draw: random.Random) -> None:
    """Change a table's columns or number of rows, or a column's type."""
    table = pq.read_table(path)
    at = draw.choice((0, draw.randrange(table.num_columns)))
    name, what = table.column_names[at], draw.randrange(6)
    if what == 0:
        table = table.select([]) if draw.random() < 0.2 else table.remove_column(at)
    elif what == 1:
        table = table.append_column(draw.choice((name, "new")), table[name])
    elif what == 2:
        rows = draw.choice((0, 1, max(table.num_rows - 1, 0)))
        table = draw.choice((table.slice(0, rows), pa.concat_tables([table, table])))
    else:
        try:
            other = draw.choice(COLUMNS)(table[name].to_pylist())
        except (TypeError, pa.ArrowException):  # of text
            other = pa.nulls(table.num_rows)
        table = table.set_column(at, name, other)
    pq.write_table(table, path)


def flip(path: Path, draw: random.Random) -> None:
    data = bytearray(path.read_bytes())
    for _ in range(draw.choice((1, 1, 3, 30))):
        data[draw.randrange(len(data))] = draw.randrange(256)
    path.write_bytes(data)


def cut(path: Path, draw: random.Random) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: draw.choice((0, 9, draw.randrange(len(data))))])


def garbage(path: Path, draw: random.Random) -> None:
    """Other bytes before, after or in place of a file's own."""
    deep = (b"[" * 100_000, b"a = " + b"[" * 50_000, b'{"a":' * 9000, b"\0" * 99)
    own = path.read_bytes()
    path.write_bytes(draw.choice((draw.randbytes(500), own + b"x" * 9, b"\xff\xfe\0" + own, *deep)))


def replaced(path: Path, draw: random.Random) -> None:
    """A folder, a pipe, a link or nothing in a file's place."""
    path.unlink()
    link = draw.choice((path.name, "/dev/zero", "/etc/passwd", "nowhere", "."))
    draw.choice((os.mkdir, os.mkfifo, lambda at: Path(at).symlink_to(link), str))(path)


INSIDE = {".json": key, ".parquet": column, ".npz": array, ".npy": array}
INSIDE |= dict.fromkeys((".toml", ".csv", ".yml", ".yaml", ".xml"), text)


def harmed(path: Path, draw: random.Random, share: float = 0.75) -> None:
    """Damage a file: with that probability what it says, else as a whole."""
    whole = draw.choice((flip, cut, garbage, replaced))
    harm = INSIDE.get(path.suffix, flip) if draw.random() < share else whole
    note(f"{harm.__name__} {path.name}")
    harm(path, draw)
