"""The frozen benchmark: recorded digests, what they notice, and what they leave to rounding."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from msgspec.structs import replace

from chromagrip import UserError
from chromagrip.dataset import load_sequences
from chromagrip.dataset.check import check
from chromagrip.dataset.folder import sequence_name
from chromagrip.dataset.frozen import Frozen, content_of, digest_of, frozen_as, seal
from chromagrip.dataset.make import make
from chromagrip.dataset.recipe import bodies_of, drawn, load_recipe, scene_of
from chromagrip.dataset.sequence import write_sequence
from chromagrip.render import load_sensor, sensor_names

Typed = Callable[..., subprocess.CompletedProcess[str]]
BENCHMARK = load_recipe("benchmark-v2")
#: SHA-256 over the recorded digests of all sequences. Who changes it makes another benchmark.
DIGEST = "b8eda76423fa9f2df447c22b523e1a6b6671339bf0c4c155937d065af4296738"

#: Designs that are younger than the benchmark.
YOUNGER = {"chromatouch-next"}
#: Conditions of each body.
HOW = ("clean", "worn", "jpeg")


def recorded() -> Frozen:
    frozen = frozen_as(BENCHMARK)
    assert frozen is not None
    return frozen


@pytest.fixture(scope="module")
def some(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The cheapest sequences of each condition, of both bodies; no dataset."""
    folder = tmp_path_factory.mktemp("data")
    for number in (8, 11, 13):
        write_sequence(BENCHMARK, number, folder)
    return folder


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first two sequences as a dataset."""
    folder = tmp_path_factory.mktemp("data") / "two"
    make(replace(BENCHMARK, sequences=2), folder)
    return folder


def test_sequences_are_as_they_were_frozen(some: Path) -> None:
    """Bit for bit on the processors of `docs/datasets.md`, but for rounding on others."""
    for folder in sorted(some.iterdir()):
        assert recorded().likeness(folder.name, content_of(folder)) in ("same", "rounded")


def test_the_record_is_of_every_sequence_and_of_no_other() -> None:
    names = [sequence_name(number) for number in range(BENCHMARK.sequences)]
    assert list(recorded().sequences) == names
    assert digest_of(recorded().sequences) == DIGEST
    assert len({one.pictures for one in recorded().sequences.values()}) == len(names)


def test_every_design_that_a_body_can_be_made_of_is_there_in_every_case() -> None:
    designs = {*sensor_names()} - YOUNGER
    domes = {name for name in designs if not load_sensor(name).shape.flat}
    found: dict[str, set[str]] = {}
    for number in range(BENCHMARK.sequences):
        values = drawn(BENCHMARK, number)
        found.setdefault(values["case"], set()).add(scene_of(BENCHMARK, number, values).sensor)
    pads = {case: found.pop(case) for case in ("pad, clean", "pad, worn")}
    assert set(found) == {f"{body}, {how}" for body in ("chain", "dome") for how in HOW}
    assert all(sensors == domes for sensors in found.values())
    assert all(sensors == designs - domes for sensors in pads.values())
    assert bodies_of(BENCHMARK) == ["chain", "dome"]


def spoilt(folder: Path, to: Path, picture: Callable[[np.ndarray], np.ndarray]) -> Path:
    """A copy of a sequence with another fourth frame."""
    shutil.copytree(folder, to / folder.name)
    path = to / folder.name / "frame-003.png"
    cv2.imwrite(str(path), picture(cv2.imread(str(path)).astype(int)).astype(np.uint8))
    return to / folder.name


def test_another_picture_is_told_from_rounding(some: Path, tmp_path: Path) -> None:
    """Some pixels by one level are rounding; a picture moved by a pixel is another one."""
    name = sequence_name(11)

    def rounded(image: np.ndarray) -> np.ndarray:
        image[100, 100:110] += np.where(image[100, 100:110] > 128, -1, 1)
        return image

    cases = {
        "same": lambda image: image,
        "rounded": rounded,
        "other pictures": lambda image: np.roll(image, 1, axis=1),
    }
    found = {}
    frozen = Frozen(name="here", sequences={name: content_of(some / name)})
    for word, change in cases.items():
        changed = spoilt(some / name, tmp_path / word.replace(" ", "-"), change)
        found[word] = frozen.likeness(name, content_of(changed))
    assert found == {word: word for word in cases}


@pytest.mark.parametrize(
    ("table", "column", "by", "like"),
    [
        ("markers", "x_px", 1e-7, "same"),
        ("markers", "x_px", 1e-3, "rounded"),
        ("markers", "x_px", 1e-1, "other labels"),
        ("markers", "normal_n", 5e-2, "other labels"),
        ("frames", "normal_n", 1e-3, "rounded"),
        ("frames", "time_s", 1e-12, "same"),
    ],
)
def test_other_labels_are_told_from_rounding(
    some: Path, tmp_path: Path, table: str, column: str, by: float, like: str
) -> None:
    folder = tmp_path / sequence_name(8)
    shutil.copytree(some / folder.name, folder)
    path = folder / f"{table}.parquet"
    rows = pq.read_table(path)
    where = rows.column_names.index(column)
    values = rows[column].to_pylist()
    more = [v + by if table == "frames" else [one + by for one in v] for v in values]
    changed = pa.array(more, rows.schema.field(where).type)
    pq.write_table(rows.set_column(where, column, changed), path)
    frozen = Frozen(name="here", sequences={folder.name: content_of(some / folder.name)})
    assert frozen.likeness(folder.name, content_of(folder)) == like


@pytest.mark.slow
def test_a_benchmark_of_other_pictures_is_refused(
    two: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As if it had been frozen with the two sequences exchanged."""
    assert check(two) == 2
    first, second = (recorded().sequences[sequence_name(k)] for k in (0, 1))
    other = {sequence_name(0): second, sequence_name(1): first}
    monkeypatch.setattr(
        "chromagrip.dataset.check.frozen_as", lambda _: Frozen(name="other", sequences=other)
    )
    with pytest.raises(UserError, match=r"sequence-000000 has other pictures than other was froz"):
        check(two)


@pytest.mark.slow
def test_recipes_that_are_not_frozen_have_no_seal(two: Path) -> None:
    assert frozen_as(load_recipe("tiny")) is None
    assert frozen_as(replace(BENCHMARK, seed=3)) is None
    assert frozen_as(replace(BENCHMARK, sequences=7, truth=("flow",))) is not None
    told = seal(two)
    assert told["frozen"] == "benchmark-v2"
    assert told["as_recorded"] in ("2 same", "1 same, 1 rounded", "2 rounded")


def test_a_benchmark_of_an_earlier_version_is_known_and_not_made(
    tmp_path: Path, typed: Typed
) -> None:
    older = frozen_as(load_recipe("benchmark-v1"))
    assert older is not None
    assert digest_of(older.sequences).startswith("f34c8d76")  # as 0.1 printed it
    assert older.sequences.keys() == recorded().sequences.keys()
    done = typed("dataset", "make", "benchmark-v1", "--out", tmp_path / "old")
    assert done.returncode == 2
    assert "benchmark-v1 has the noise of an earlier version" in done.stderr
    assert not (tmp_path / "old").exists()


@pytest.mark.slow
def test_the_commands_tell_the_digest(two: Path, tmp_path: Path, typed: Typed) -> None:
    words = ["dataset", "make", "benchmark-v2", "--n", "1", "--out", tmp_path / "one", "--json"]
    made = json.loads(typed(*words).stdout)
    checked = json.loads(typed("dataset", "check", tmp_path / "one", "--json").stdout)
    assert made["digest"] == checked["digest"] != seal(two)["digest"]
    assert made["frozen"] == "benchmark-v2"


@pytest.mark.slow
def test_a_tracker_is_run_on_the_benchmark_and_has_intervals(two: Path, typed: Typed) -> None:
    done = typed("score", "lk", two, "--json")
    assert done.returncode == 0, done.stderr
    (told,) = json.loads(done.stdout)["tracks"]
    low, high = told["intervals"]["rms"]
    each = [scores["rms"] for scores in told["sequences"].values()]
    assert (low, high) == pytest.approx((min(each), max(each)))
    assert low < told["scores"]["rms"] < high < 1.0
    assert typed("score", "nobody", two, "--json").returncode == 2


@pytest.mark.slow
def test_the_whole_benchmark_is_as_it_was_frozen(tmp_path: Path) -> None:
    make(BENCHMARK, tmp_path / "whole", workers=os.cpu_count() or 1)
    assert check(tmp_path / "whole") == BENCHMARK.sequences
    told = seal(tmp_path / "whole")
    if told["as_recorded"] == "40 same":
        assert told["digest"] == DIGEST
    size = sum(file.stat().st_size for file in (tmp_path / "whole").rglob("*") if file.is_file())
    assert size < 115e6


@pytest.mark.slow
def test_another_kind_of_processor_makes_it_but_for_rounding(tmp_path: Path) -> None:
    """OpenCV and BLAS without the vector instructions of processors since 2013."""
    old = {
        "OPENCV_CPU_DISABLE": "AVX,AVX2,FP16,FMA3,SSE4.1,SSE4.2,SSSE3",
        "OPENBLAS_CORETYPE": "Nehalem",
    }
    words = ["dataset", "make", "benchmark-v2", "--workers", "1", "--out", str(tmp_path / "old")]
    subprocess.run(
        [sys.executable, "-m", "chromagrip", *words], env={**os.environ, **old}, check=True
    )
    assert check(tmp_path / "old") == BENCHMARK.sequences
    for one in load_sequences(tmp_path / "old"):
        assert np.isfinite(one.places[one.visible]).all()
