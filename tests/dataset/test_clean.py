"""Datasets without noise give back, bit for bit, the pictures of those with noise."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from chromagrip import UserError
from chromagrip.dataset import load_sequences
from chromagrip.dataset.check import check
from chromagrip.dataset.export.layouts import export
from chromagrip.dataset.folder import CARD, FILES, sequence_name
from chromagrip.dataset.frozen import content_of
from chromagrip.dataset.make import make, merge
from chromagrip.dataset.pictures import CLEAN, NOISE, pictures_in, shown
from chromagrip.dataset.recipe import Recipe, load_recipe
from chromagrip.sources.picture_files import read_picture

Digests = Callable[[Path], dict[str, str]]
Typed = Callable[..., subprocess.CompletedProcess[str]]
TINY = load_recipe("tiny")
CLEAN_TINY = replace(TINY, store="clean")
#: A worn camera whose frames differ in light, colour and photon noise, of both bodies.
WORN = Recipe(
    sequences=2,
    reading="auto",
    scene={
        "duration_s": 0.2,
        "camera": {"rate_hz": 20.0},
        "defects": {
            "gain_step": 0.1, "white_balance_drift": 0.05, "shot_noise_electrons": 8000.0,
            "defocus_px": 0.5, "motion_blur": 0.5, "missing_markers": 0.02, "vignette": 0.2,
        },
    },
    draw={"camera.noise_levels": {"each": [0.0, 1.5]}},
    cases=(),
)  # fmt: skip
DOME = replace(
    WORN,
    sequences=1,
    reading="",
    scene={**WORN.scene, "body": "dome", "sensor": "dome-2022"},
    draw={
        "motion": {"choice": ["move"]},
        "pose.press_share": {"choice": [0.25]},
        "camera.noise_levels": {"choice": [30.0]},
    },
)


@pytest.fixture(scope="module")
def both(tiny: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The tiny dataset with noise and without it."""
    clean = tmp_path_factory.mktemp("data") / "clean"
    make(CLEAN_TINY, clean)
    return tiny, clean


def assert_same(noisy: Path, clean: Path) -> None:
    """Pictures and labels are those of the other dataset."""
    for one, other in zip(load_sequences(noisy), load_sequences(clean), strict=True):
        assert (one.pictures.store, other.pictures.store) == ("noisy", "clean")
        np.testing.assert_array_equal(one.pictures.rest, other.pictures.rest)
        for image, again in zip(one.images(), other.images(), strict=True):
            np.testing.assert_array_equal(image, again)
        np.testing.assert_array_equal(one.pictures[-1], other.pictures[-1])
        for name in ("frames.parquet", "markers.parquet", "camera.yml", "scene.toml"):
            files = [two.pictures.folder / name for two in (one, other)]
            assert files[0].read_bytes() == files[1].read_bytes(), name


def test_pictures_and_labels_are_those_with_noise(both: tuple[Path, Path]) -> None:
    noisy, clean = both
    assert_same(noisy, clean)
    assert check(clean) == 3
    for name in map(sequence_name, range(3)):
        assert content_of(noisy / name) == content_of(clean / name)
        sizes = [
            sum(file.stat().st_size for file in (folder / name).glob("*-0*.png")) for folder in both
        ]
        assert sizes[1] < 0.1 * sizes[0]
    assert (clean / CARD).read_text() == (noisy / CARD).read_text()
    assert (clean / "contact-sheet.png").read_bytes() == (noisy / "contact-sheet.png").read_bytes()


def test_what_is_kept_has_no_noise(both: tuple[Path, Path]) -> None:
    """The untouched sensor's dark rim is even; with noise it is not."""
    folder = both[1] / sequence_name(0)
    clean, noisy = read_picture(folder / CLEAN), pictures_in(folder).rest
    assert clean[:20, :20].std(axis=(0, 1)).max() == 0.0
    sigma = json.loads((folder / NOISE).read_text())["sigma"]
    assert (noisy[:20, :20] - clean[:20, :20].astype(float)).std() == pytest.approx(
        np.sqrt(sigma**2 + 1 / 12), rel=0.1
    )


@pytest.mark.slow
@pytest.mark.parametrize("recipe", [WORN, DOME], ids=["chain", "dome"])
def test_worn_cameras_and_readings_are_the_same(recipe: Recipe, tmp_path: Path) -> None:
    make(recipe, tmp_path / "noisy")
    make(replace(recipe, store="clean"), tmp_path / "clean")
    assert_same(tmp_path / "noisy", tmp_path / "clean")
    assert check(tmp_path / "clean") == recipe.sequences


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["coco", "tapvid", "webdataset", "lerobot"])
def test_exports_have_the_same_bytes(
    both: tuple[Path, Path], layout: str, tmp_path: Path, bytes_of: Digests
) -> None:
    for folder, name in zip(both, ("noisy", "clean"), strict=True):
        export(folder, layout, tmp_path / name)
    assert bytes_of(tmp_path / "noisy") == bytes_of(tmp_path / "clean")


def test_items_for_pytorch_are_the_same(both: tuple[Path, Path]) -> None:
    pytest.importorskip("torch")
    from chromagrip.dataset.torch import Frames

    one, other = (Frames(folder, labels=("margin",), with_rest=True) for folder in both)
    assert len(one) == len(other) == 21
    for index in (0, 8, 20):
        for name in ("image", "rest"):
            assert bool((one[index][name] == other[index][name]).all())


@pytest.mark.slow
def test_scores_are_the_same(both: tuple[Path, Path], typed: Typed) -> None:
    said = []
    for folder in both:
        with shown(folder / sequence_name(1)) as files:
            found = [read_picture(files / name) for name in ("rest.png", "frame-003.png")]
        said.append(found)
    np.testing.assert_array_equal(said[0], said[1])
    scores = []
    for folder in both:
        done = typed("score", "centroid", str(folder), "--json")
        assert done.returncode == 0, done.stderr
        scores.append({k: v for k, v in json.loads(done.stdout).items() if k != "truth"})
    assert scores[0] == scores[1]
    assert "centroid" in str(scores[0])


@pytest.mark.slow
def test_workers_shards_and_kills_change_no_byte(
    both: tuple[Path, Path], tmp_path: Path, bytes_of: Digests
) -> None:
    expected = bytes_of(both[1])
    for first in (1, 2):
        make(CLEAN_TINY, tmp_path / f"shard{first}", shard=(first, 2), workers=first)
    merge([tmp_path / "shard1", tmp_path / "shard2"], tmp_path / "whole")
    assert bytes_of(tmp_path / "whole") == expected
    words = ["dataset", "make", "tiny", "--store", "clean", "--workers", "1", "--json"]
    command = [sys.executable, "-P", "-m", "chromagrip", *words, "--out", str(tmp_path / "killed")]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, start_new_session=True)
    until = time.monotonic() + 120.0
    while not list((tmp_path / "killed").glob("sequence-*")) and time.monotonic() < until:
        time.sleep(0.01)
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    subprocess.run([*command, "--resume"], check=True, stdout=subprocess.DEVNULL)
    assert bytes_of(tmp_path / "killed") == expected


@pytest.mark.slow
def test_another_store_is_another_dataset(both: tuple[Path, Path], tmp_path: Path) -> None:
    shutil.copytree(both[1], tmp_path / "clean")
    with pytest.raises(UserError, match="holds a dataset of another recipe"):
        make(TINY, tmp_path / "clean", resume=True)
    make(CLEAN_TINY, tmp_path / "first", shard=(1, 2))
    make(TINY, tmp_path / "second", shard=(2, 2))
    with pytest.raises(UserError, match="is of another recipe"):
        merge([tmp_path / "first", tmp_path / "second"], tmp_path / "whole")


def test_what_has_changed_is_named(both: tuple[Path, Path], tmp_path: Path) -> None:
    for name in (CLEAN, NOISE, "change-002.png"):
        folder = tmp_path / name
        shutil.copytree(both[1], folder)
        path = folder / sequence_name(1) / name
        path.write_bytes(path.read_bytes()[:-1] + b" ")
        with pytest.raises(UserError, match=f"{name} has changed"):
            check(folder)
    folder = tmp_path / "gone"
    shutil.copytree(both[1], folder)
    (folder / sequence_name(2) / NOISE).unlink()
    with pytest.raises(UserError, match=f"{NOISE} is missing"):
        check(folder)


def test_noise_of_another_version_is_refused(both: tuple[Path, Path], tmp_path: Path) -> None:
    """Rather than other pictures are given back, a key whose noise is another one is refused."""
    shutil.copytree(both[1] / sequence_name(0), tmp_path / "one")
    path = tmp_path / "one" / NOISE
    key = json.loads(path.read_text())
    for change in ({"sample": key["sample"] + 1}, {"sigma": 1.25}, {"seed": 1}):
        path.write_text(json.dumps(key | change))
        with pytest.raises(UserError, match="noise that this version of chromagrip does not make"):
            pictures_in(tmp_path / "one")[0]
    path.write_text("{}")
    with pytest.raises(UserError, match="missing or damaged"):
        _ = pictures_in(tmp_path / "one").rest
    path.write_text(json.dumps(key))
    cv2.imwrite(str(tmp_path / "one" / "change-000.png"), np.zeros((8, 8, 3), np.uint8))
    with pytest.raises(UserError, match="another size"):
        pictures_in(tmp_path / "one")[0]
    assert (tmp_path / "one" / FILES).is_file()


@pytest.mark.parametrize(
    "change",
    [
        {"scene": TINY.scene | {"defects": {"jpeg_quality": 80}}},
        {"draw": TINY.draw | {"defects.h264_crf": {"choice": [0, 20]}}},
    ],
    ids=["set", "drawn"],
)
def test_compressed_pictures_are_not_kept_without_noise(
    change: dict[str, object], tmp_path: Path
) -> None:
    with pytest.raises(UserError, match=r'compresses them with it: use store = "noisy"'):
        make(replace(CLEAN_TINY, **change), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_command_refuses_in_one_sentence(typed: Typed) -> None:
    done = typed("dataset", "make", "benchmark-v1", "--store", "clean", "--out", "out")
    assert done.returncode == 2
    assert "defects.jpeg_quality compresses them with it" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
