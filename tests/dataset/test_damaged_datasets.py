"""Datasets of strangers, damaged in hundreds of ways: each is one sentence, and nothing is left."""

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from chromagrip.dataset.folder import FILES, MANIFEST

NAME = "sequence-000000"
#: Every so many-th damage is tried, by each part.
STRIDE = 16
Typed = Callable[..., CompletedProcess[str]]
#: Changes a copy of the seed; the file that it damages, and how.
Damage = tuple[str, str, Callable[[Path], object]]


def sealed(folder: Path) -> None:
    """Make checksums fit what was changed, as somebody does who wants to be read."""

    def digest(path: Path, before: str) -> str:
        return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else before

    lists = ((folder / NAME / FILES, "files"), (folder / MANIFEST, "files"))
    for path, key in lists:
        if not path.is_file():
            continue
        try:
            listed = json.loads(path.read_text("utf-8"))
            listed[key] = {
                name: digest(path.parent / name, was) for name, was in listed[key].items()
            }
            if path.name == MANIFEST:
                own = listed["sequences"]
                listed["sequences"] = {n: digest(folder / n / FILES, was) for n, was in own.items()}
            path.write_text(json.dumps(listed), "utf-8")
        except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
            pass  # it is what was damaged


def of_files(seed: Path) -> Iterator[Damage]:
    """Damages of the bytes of any file."""

    def with_bytes(change: Callable[[bytes], bytes]) -> Callable[[Path], object]:
        return lambda path: path.write_bytes(change(path.read_bytes()))

    def flipped(data: bytes) -> bytes:
        rng, found = np.random.default_rng(len(data)), bytearray(data)
        for at in rng.integers(0, len(data), 8):
            found[at] ^= 1 << int(rng.integers(8))
        return bytes(found)

    def instead(make: Callable[[Path], object]) -> Callable[[Path], object]:
        def change(path: Path) -> None:
            path.unlink()
            make(path)

        return change

    kinds: dict[str, Callable[[Path], object]] = {
        "half": with_bytes(lambda data: data[: len(data) // 2]),
        "start": with_bytes(lambda data: data[:9]),
        "empty": with_bytes(lambda data: b""),
        "flipped": with_bytes(flipped),
        "no text": with_bytes(lambda data: b"\xff\xfe\x00" + data),
        "deep": with_bytes(lambda data: b"a = " * (data[:1] != b"{") + b"[" * 50_000),
        "gone": lambda path: path.unlink(),
        "folder": instead(Path.mkdir),
        "pipe": instead(os.mkfifo),
        "link": instead(lambda path: path.symlink_to("/etc/hostname")),
        "loop": instead(lambda path: path.symlink_to(path.name)),
    }
    names = [file.relative_to(seed).as_posix() for file in sorted(seed.rglob("*"))]
    for name in names:
        if (seed / name).is_file():
            for kind, change in kinds.items():
                yield name, kind, change
    yield NAME, "folder", lambda path: [shutil.rmtree(path), path.mkdir()]
    yield NAME, "file", lambda path: [shutil.rmtree(path), path.write_text("x")]


def of_json(seed: Path) -> Iterator[Damage]:
    """Keys that are missing, have another type, or another name."""
    others: list[Any] = [None, 3, -1, 1.5, "x", "", [], {}, [[[[[[1]]]]]], {"../../x": "y"}, 10**30]

    def changed(keys: tuple[str, ...], value: Any) -> Callable[[Path], object]:
        def change(path: Path) -> None:
            content = json.loads(path.read_text("utf-8"))
            inner = content
            for key in keys[:-1]:
                inner = inner[key]
            if value is KeyError:
                del inner[keys[-1]]
            elif isinstance(value, str) and value.startswith("name "):
                inner[value.removeprefix("name ")] = inner.pop(keys[-1])
            else:
                inner[keys[-1]] = value
            path.write_text(json.dumps(content), "utf-8")

        return change

    strange = (
        "../../x",
        "/etc/hostname",
        "sequence-1",
        "sequence-000001",
        "a\nb",
        "",
        "sensors/../x",
    )
    for name in (MANIFEST, f"{NAME}/{FILES}"):
        for key, value in json.loads((seed / name).read_text("utf-8")).items():
            for other in (KeyError, *others):
                yield name, f"{key} = {other}", changed((key,), other)
            for inner in list(value)[:3] if isinstance(value, dict) else ():
                for other in (KeyError, *others, *(f"name {one}" for one in strange)):
                    yield name, f"{key}.{inner} = {other}", changed((key, inner), other)
    for parts in ([], {"../../../x": [NAME]}, {"a/b": [NAME]}, {"a": [NAME, NAME]}, {"a": [3]},
                  {"": [NAME]}, {"..": [NAME]}, {"a": ["../x"]}, {"x" * 5000: [NAME]}):  # fmt: skip
        text = json.dumps(parts)
        yield "split.json", text[:30], lambda path, text=text: path.write_text(text)  # type: ignore[misc]


def of_tables(seed: Path) -> Iterator[Damage]:
    """Columns that are missing, of another type, null or ragged; rows too few and too many."""

    def with_table(change: Callable[[pa.Table], pa.Table]) -> Callable[[Path], object]:
        return lambda path: pq.write_table(change(pq.read_table(path)), path)

    def put(column: str, make: Callable[[pa.Table], Any]) -> Callable[[Path], object]:
        def change(table: pa.Table) -> pa.Table:
            return table.set_column(table.column_names.index(column), column, make(table))

        return with_table(change)

    def one_null(column: str) -> Callable[[pa.Table], Any]:
        def make(table: pa.Table) -> Any:
            values = table[column].to_pylist()
            return pa.array([None, *values[1:]], table[column].type)

        return make

    def ragged(column: str) -> Callable[[pa.Table], Any]:
        def make(table: pa.Table) -> Any:
            kind = pa.list_(table[column].type.value_type)
            return pa.array([v[: 5 + k] for k, v in enumerate(table[column].to_pylist())], kind)

        return make

    def short(column: str) -> Callable[[pa.Table], Any]:
        def make(table: pa.Table) -> Any:
            kind = pa.list_(table[column].type.value_type, 4)
            return pa.array([v[:4] for v in table[column].to_pylist()], kind)

        return make

    def all_short(table: pa.Table, starts: Any) -> pa.Table:
        for k, column in enumerate(table.column_names[1:], 1):
            if column.startswith(starts):
                table = table.set_column(k, column, short(column)(table))
        return table

    def filled(value: Any) -> Callable[[pa.Table], Any]:
        return lambda table: pa.array([value] * table.num_rows)

    values = ("x", 3, -1, 300_000_000, 1.5, np.nan, None, [1.0], [[1.0]], b"\xff", {"a": 1})
    for name in (f"{NAME}/frames.parquet", f"{NAME}/markers.parquet", "sequences.parquet"):
        table = pq.read_table(seed / name)
        for kind, whole in {
            "no rows": lambda t: t.slice(0, 0),
            "fewer rows": lambda t: t.slice(0, max(t.num_rows - 1, 0)),
            "more rows": lambda t: pa.concat_tables([t, t]),
            "no columns": lambda t: t.select([]),
            "twice": lambda t: t.append_column(t.column_names[0], t[0]),
            "more": lambda t: t.append_column("new", t[0]),
        }.items():
            yield name, kind, with_table(whole)
        if name.endswith("markers.parquet"):
            for starts in ("node", ("x", "y", "p", "v", "o", "c", "m")):
                yield name, f"all {starts} short", with_table(lambda t, s=starts: all_short(t, s))
        for column in table.column_names:
            yield name, f"{column} dropped", with_table(lambda t, c=column: t.drop_columns([c]))
            for value in values:
                yield name, f"{column} = {value}", put(column, filled(value))
            yield name, f"{column} with a null", put(column, one_null(column))
            if pa.types.is_fixed_size_list(table[column].type):
                yield name, f"{column} ragged", put(column, ragged(column))
                yield name, f"{column} short", put(column, short(column))


def every(seed: Path) -> list[Damage]:
    """Damages of each file of a dataset."""
    return [*of_files(seed), *of_json(seed), *of_tables(seed)]


def through(typed: Typed, work: Path, seed: Path, damage: Damage, seal: bool, layout: str) -> None:
    """Run every command on a damaged copy: it answers, and of a refusal nothing is left."""
    name, how, change = damage
    work.mkdir()
    data = shutil.copytree(seed, work / "data")
    (work / "t.csv").write_text("frame,marker,layer,x,y\n0,0,magenta,320,240\n")
    change(data / name)
    if seal:
        sealed(data)
    before = sorted(work.iterdir())
    for words in (
        ("check", data), ("info", data), ("split", data, "--shares", "train=1"),
        ("merge", data, "--out", work / "a" / "merged"),
        ("export", data, "--to", layout, "--out", work / "b" / "exported"),
        ("score", work / "t.csv", data, "--json"),
    ):  # fmt: skip
        done = typed(*(() if words[0] == "score" else ("dataset",)), *words)
        told = f"{words[0]} of {name}, {how}, sealed {seal}: {done.stderr}"
        assert done.returncode in (0, 2), told
        assert "Traceback" not in done.stderr, told
        if done.returncode == 2:
            assert len(done.stderr.strip().splitlines()[-1]) < 1000, told
            assert done.stderr.count("chromagrip: ") == 1, told
            assert sorted(work.iterdir()) == before, told
        for made in ("a", "b"):
            shutil.rmtree(work / made, ignore_errors=True)
    shutil.rmtree(work)


def test_a_few_damages_are_each_a_sentence(typed: Typed, tmp_path: Path, seed_dome: Path) -> None:
    """Every 233rd, with and without fitting checksums."""
    for k, damage in enumerate(every(seed_dome)[3::233]):
        layout = ("coco", "tapvid", "webdataset")[k % 3]
        through(typed, tmp_path / "work", seed_dome, damage, k % 3 > 0, layout)


@pytest.fixture(params=["seed_dome", "tiny"])
def seed(request: pytest.FixtureRequest) -> Path:
    """A dataset of a dome, or of a chain."""
    return Path(request.getfixturevalue(request.param))


@pytest.mark.slow
@pytest.mark.fuzz
@pytest.mark.parametrize("part", range(2))
def test_every_damage_is_a_sentence(typed: Typed, tmp_path: Path, seed: Path, part: int) -> None:
    """One in STRIDE; a stride of 2 is all of them, and takes two hours."""
    layouts = ("coco", "tapvid", "webdataset", "lerobot")
    for k, damage in enumerate(every(seed)[part::STRIDE]):
        for seal in (True, False):
            if seal or k % 4 == 0:  # without, most are the same refusal
                through(typed, tmp_path / "work", seed, damage, seal, layouts[k % 4])
