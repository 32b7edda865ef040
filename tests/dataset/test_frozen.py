"""The frozen benchmark: recorded digests of its sequences, and what they notice."""

import hashlib
import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import cv2
import pytest
from msgspec.structs import replace

from chromagrip.dataset.check import check
from chromagrip.dataset.folder import sequence_name
from chromagrip.dataset.frozen import digests_of, recorded, seal
from chromagrip.dataset.make import make
from chromagrip.dataset.recipe import load_recipe
from chromagrip.dataset.sequence import write_sequence

Typed = Callable[..., subprocess.CompletedProcess[str]]
BENCHMARK = load_recipe("benchmark-v2")
#: SHA-256 over the recorded digests of all sequences. Who changes it makes another benchmark.
DIGEST = "b8eda76423fa9f2df447c22b523e1a6b6671339bf0c4c155937d065af4296738"


def test_sequences_are_as_they_were_frozen(tmp_path: Path, respelled: Callable[..., None]) -> None:
    """A chain, and a dome through JPEG, bit for bit on the processors of `docs/datasets.md`."""
    _, record = recorded(BENCHMARK)
    for number in (8, 13):
        write_sequence(BENCHMARK, number, tmp_path)
        assert digests_of(tmp_path / sequence_name(number)) == record[sequence_name(number)]
    folder = tmp_path / sequence_name(13)
    picture = cv2.imread(str(folder / "frame-003.png"))
    assert picture is not None
    picture[100, 100, 0] ^= 1
    cv2.imwrite(str(folder / "frame-003.png"), picture)
    spoilt = digests_of(folder)
    assert spoilt["pictures"] != record[folder.name]["pictures"]
    assert spoilt["labels"] == record[folder.name]["labels"]


def test_a_label_is_told_to_three_decimals(
    tiny: Path, tmp_path: Path, respelled: Callable[..., None]
) -> None:
    folder = shutil.copytree(tiny, tmp_path / "data")
    before = digests_of(folder / sequence_name(0))
    for value, same in ((1e-6, True), (2e-3, False)):
        respelled(folder, "frames", "load_n", 0, value)
        assert (digests_of(folder / sequence_name(0)) == before) is same


def test_the_record_is_of_every_sequence_and_of_no_other() -> None:
    name, record = recorded(replace(BENCHMARK, sequences=7, truth=("flow",), reading="auto"))
    assert name == "benchmark-v2"
    assert list(record) == [sequence_name(number) for number in range(BENCHMARK.sequences)]
    text = "".join(f"{key} {one['pictures']} {one['labels']}\n" for key, one in record.items())
    assert hashlib.sha256(text.encode()).hexdigest() == DIGEST
    assert len({one["pictures"] for one in record.values()}) == len(record)
    for other in (load_recipe("tiny"), replace(BENCHMARK, seed=3)):
        assert recorded(other) == ("", {})


@pytest.mark.data
def test_the_commands_tell_the_digest(tmp_path: Path, typed: Typed) -> None:
    two = tmp_path / "two"
    words = ["dataset", "make", "benchmark-v2", "--n", "2", "--out", two, "--json"]
    made = json.loads(typed(*words).stdout)
    checked = json.loads(typed("dataset", "check", two, "--json").stdout)
    assert made["digest"] == checked["digest"]
    assert (made["frozen"], made["as_recorded"]) == ("benchmark-v2", "2 of 2")


@pytest.mark.data
def test_the_whole_benchmark_is_as_it_was_frozen(tmp_path: Path) -> None:
    make(BENCHMARK, tmp_path / "whole", workers=os.cpu_count() or 1)
    assert check(tmp_path / "whole") == BENCHMARK.sequences
    told = seal(tmp_path / "whole")
    assert (told["as_recorded"], told["digest"]) == ("40 of 40", DIGEST)
    size = sum(file.stat().st_size for file in (tmp_path / "whole").rglob("*") if file.is_file())
    assert size < 115e6
