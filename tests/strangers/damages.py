"""Damages of strangers' files: bytes, keys of JSON, words and lines of text, columns, arrays."""

import json
import math
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
    "", "true", "nan", "-inf", "-1", "0", "3", "1e308", "1e400", "9" * 5000, "1" + "0" * 300,
    "1e-320", "0x7fffffffffffffff", '"x"', '""', "[]", "{}", "[nan]", "[[1]]", "[" * 3000,
    "{a = {b = {}}}", "{a: {b: c}}", "1979-05-27", f'"{"a" * 5000}"', '"\\u0000"', "\x1b[2J",
    "é\u202e", '"nowhere:Class"', '"../../x"', '"/etc/hostname"', "&x", "*x", "<a>", ";", ",", "\0",
)  # fmt: skip
#: What a key or a link is called.
NAMES = ("../../x", "/etc/hostname", "sequence-1", "sequence-000001", "a\nb", "", "sensors/../x")
#: Types that a column is stored with: of any values, of numbers and of lists.
KINDS: tuple[Callable[[list[Any]], pa.Array], ...] = (
    lambda v: pa.array([str(x) for x in v]),
    lambda v: pa.array([[x] * k for k, x in enumerate(v)]),
    lambda v: pa.array([{"a": x} for x in v]),
    lambda v: pa.nulls(len(v), pa.float64()),
    lambda v: pa.array([bool(x) for x in v]),
    lambda v: pa.array([None, *v[1:]]),
    lambda v: pa.array(np.full(len(v), 3, "int32")),
    lambda v: pa.array(np.full(len(v), 300_000_000)),
    lambda v: pa.array(np.full(len(v), 3, "timedelta64[s]")),
    lambda v: pa.array([str(x) for x in v]).dictionary_encode(),
    lambda v: pa.array(np.full(len(v), 1e308)),
    lambda v: pa.array(v[::-1]),
)
OF_NUMBERS: tuple[Callable[[list[Any]], pa.Array], ...] = (
    lambda v: pa.array(np.asarray(v, float) * (1.0, math.nan, 1e15, -1.0)[len(v) % 4]),
    lambda v: pa.array([*v[:-1], math.nan], pa.float64()),
    lambda v: pa.array(np.asarray(v, "float32")),
)
OF_LISTS: tuple[Callable[[list[Any]], pa.Array], ...] = (
    lambda v: pa.array([x[: 5 + k] for k, x in enumerate(v)]),
    lambda v: pa.array([x[:4] for x in v], pa.list_(pa.array(v[0]).type, 4)),
)


#: What an array of an archive is replaced by.
ARRAYS: tuple[Callable[[np.ndarray], np.ndarray], ...] = (
    lambda v: v[:0], lambda v: v[..., None], lambda v: v.T, lambda v: v[:-1],
    lambda v: v.astype(str), lambda v: v.astype(complex), lambda v: v.astype(object),
    lambda v: np.zeros(v.shape, "M8[s]"),
    lambda v: np.full(v.shape, np.nan), lambda v: np.full(v.shape, -1), lambda v: np.zeros(()),
    lambda v: np.full(v.shape, 1e308), lambda v: np.zeros(v.shape, "V3"), lambda v: v[None],
)  # fmt: skip


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
    kinds = {".json": key, ".parquet": column, ".npz": array, ".npy": array}
    kinds |= dict.fromkeys((".toml", ".csv", ".yml", ".yaml", ".xml"), text)
    kinds.get(path.suffix, flip)(path, draw)


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
    name = draw.choice(list(arrays))
    how = draw.random()
    if how < 0.7:
        arrays[name] = draw.choice(ARRAYS)(arrays[name])
    else:
        value = arrays.pop(name)
        arrays |= {draw.choice(("new", "../x", name.upper())): value} if how < 0.85 else {}
    np.savez(path, **arrays)


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


def harmed(path: Path, draw: random.Random, share: float = 0.75) -> None:
    """Damage a file, with that probability inside, else as a whole."""
    harm = inside if draw.random() < share else draw.choice(HARMS)
    note(f"{harm.__name__} {path.name}")
    harm(path, draw)
