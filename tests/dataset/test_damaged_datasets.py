"""Datasets of strangers, damaged in many ways: each is one sentence, and nothing is left."""

import random
import shutil
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

import pytest

from ..damages import damage
from .sealing import sealed

NAME = "sequence-000000"
#: Parts of which some are none, or those of others.
PARTS = (
    "[]", '{"../../../x": ["sequence-000000"]}', '{"a/b": ["sequence-000000"]}',
    '{"a": ["sequence-000000", "sequence-000000"]}', '{"a": [3]}', '{"": ["sequence-000000"]}',
    '{"..": ["sequence-000000"]}', '{"a": ["../x"]}', f'{{"{"x" * 5000}": ["sequence-000000"]}}',
)  # fmt: skip
LAYOUTS = ("coco", "tapvid", "webdataset", "lerobot")
Typed = Callable[..., CompletedProcess[str]]


def damaged(data: Path, draw: random.Random) -> str:
    """Damage a file of a dataset, the folder of its sequence, or its split."""
    what = draw.random()
    if what < 0.05:
        (data / "split.json").write_text(parts := draw.choice(PARTS))
        return f"split {parts[:30]}"
    if what < 0.1:
        shutil.rmtree(data / NAME)
        draw.choice((Path.mkdir, Path.touch))(data / NAME)
        return "no sequence"
    files = [path.relative_to(data).as_posix() for path in data.rglob("*") if path.is_file()]
    tables = [name for name in files if not name.endswith("png")]
    return damage(data, sorted(draw.choice((files, tables))), draw)


def through(typed: Typed, work: Path, seed: Path, draw: random.Random) -> None:
    """Run every command on a damaged copy: it answers, and of a refusal nothing is left."""
    work.mkdir()
    data = shutil.copytree(seed, work / "data")
    (work / "t.csv").write_text("frame,marker,layer,x,y\n0,0,magenta,320,240\n")
    how, layout, seal = damaged(data, draw), draw.choice(LAYOUTS), draw.random() < 0.7
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
        told = f"{words[0]} of {how}, sealed {seal}: {done.stderr}"
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
    """With fitting checksums and without."""
    for k in range(20):
        through(typed, tmp_path / "work", seed_dome, random.Random(f"few {k}"))


@pytest.mark.fuzz
@pytest.mark.parametrize("name", ["seed_dome", "tiny"])
@pytest.mark.parametrize("part", range(2))
def test_many_damages_are_each_a_sentence(
    typed: Typed, tmp_path: Path, request: pytest.FixtureRequest, name: str, part: int
) -> None:
    """Of a dataset of a dome, and of a chain."""
    for k in range(100):
        seed = Path(request.getfixturevalue(name))
        through(typed, tmp_path / "work", seed, random.Random(f"{name} {part} {k}"))
