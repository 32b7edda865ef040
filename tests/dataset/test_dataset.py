"""Datasets: nothing half-written, whatever ends a run; checked, split, and gone on with."""

import json
import math
import os
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from msgspec.structs import replace

from chromagrip import UserError
from chromagrip.dataset import folder as dataset_folder
from chromagrip.dataset import load_sequences
from chromagrip.dataset.check import check
from chromagrip.dataset.folder import FILES, MANIFEST, TABLE, sequence_name
from chromagrip.dataset.make import make, merge
from chromagrip.dataset.recipe import Recipe, load_recipe
from chromagrip.dataset.split import split
from chromagrip.folders import filling

Digests = Callable[[Path], dict[str, str]]
Typed = Callable[..., CompletedProcess[str]]
TINY = load_recipe("tiny")
#: Sequences of two frames each of six objects, whose radii are unevenly many.
SHAPES = Recipe(
    sequences=6,
    scene=TINY.scene | {"duration_s": 0.02},
    draw={
        "motion": {"choice": ["press"]}, "grip_n": {"choice": [1.0]},
        "object": {"each": [{"radius_mm": r, "stiffness_kpa": 50.0} for r in (8.0,) * 4 + (20.0,
                                                                               math.inf)]},
        "object.friction": {"uniform": [0.3, 0.8]},
        "renderer": {"choice": ["painter"]}, "camera.rest_frames": {"choice": [4]},
    },
)  # fmt: skip


@pytest.fixture(scope="module")
def shapes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dataset of SHAPES, of two shards that were merged; not to be changed."""
    folder = tmp_path_factory.mktemp("data")
    for first in (2, 1):
        make(SHAPES, folder / f"shard{first}", shard=(first, 2))
    merge([folder / "shard2", folder / "shard1"], folder / "shapes")
    return folder / "shapes"


def radii_of(folder: Path) -> dict[str, float]:
    """Radius of each sequence's object [mm]."""
    return {sequence_name(one.number): one.scene.object.radius_mm for one in load_sequences(folder)}


def test_a_whole_dataset_is_checked_and_has_no_clock_in_it(tiny: Path) -> None:
    assert check(tiny) == 3
    text = "".join(p.read_text("utf-8") for p in tiny.rglob("*") if p.suffix in (".json", ".toml"))
    assert os.uname().nodename not in text
    assert time.strftime("%Y-") not in text
    # No ink touches the border of the sheet, for as many sequences as fill a part of a row.
    sheet = cv2.imread(str(tiny / "contact-sheet.png"))
    assert sheet is not None
    for border in (sheet[:3], sheet[-3:], sheet[:, :3], sheet[:, -3:]):
        assert (border == 255).all()


def test_shards_and_more_sequences_change_no_byte(
    shapes: Path, tmp_path: Path, bytes_of: Digests
) -> None:
    grown = tmp_path / "grown"
    make(replace(SHAPES, sequences=2), grown)
    make(SHAPES, grown, resume=True)
    assert bytes_of(grown) == bytes_of(shapes)
    assert check(shapes) == 6
    rows = pq.read_table(shapes / TABLE).to_pylist()
    assert [row["number"] for row in rows] == [0, 1, 2, 3, 4, 5]
    # Words, whole numbers and infinity are drawn as well.
    assert {(row["renderer"], row["camera.rest_frames"]) for row in rows} == {("painter", 4)}
    assert list(radii_of(shapes).values()) == [8.0] * 4 + [20.0, math.inf]


def test_what_a_killed_run_left_half_written_is_removed(
    shapes: Path, tmp_path: Path, bytes_of: Digests
) -> None:
    """A file and a folder of a process that is gone."""
    folder = shutil.copytree(shapes, tmp_path / "killed")
    (folder / MANIFEST).unlink()
    shutil.rmtree(folder / sequence_name(4))
    (folder / f".part-1-{TABLE}").write_bytes(b"PAR1")
    (folder / ".part-sequence-000001-1").mkdir()
    (folder / ".part-sequence-000001-1" / "rest.png").write_bytes(b"")
    with filling(folder), pytest.raises(UserError, match="is being filled by process"):
        make(SHAPES, folder, resume=True)
    with pytest.raises(UserError, match="is not whole: go on with --resume"):
        check(folder)
    make(SHAPES, folder, resume=True)
    assert bytes_of(folder) == bytes_of(shapes)


def test_a_full_disk_leaves_nothing_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = Path.write_bytes

    def full(path: Path, data: bytes) -> int:
        if path.name == "frame-001.png":
            raise OSError(28, os.strerror(28))
        return write(path, data)

    one, folder = replace(SHAPES, sequences=1), tmp_path / "full"
    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(UserError, match="cannot be written: No space left on device"):
        make(one, folder)
    assert not [path for path in folder.iterdir() if "sequence-" in path.name]
    monkeypatch.undo()
    make(one, folder, resume=True)
    assert check(folder) == 1


@pytest.mark.data
def test_a_dask_worker_that_is_killed_loses_nothing(
    tiny: Path, tmp_path: Path, bytes_of: Digests
) -> None:
    distributed = pytest.importorskip("distributed")
    options = {"threads_per_worker": 1, "dashboard_address": None, "host": "127.0.0.1"}
    with (
        distributed.LocalCluster(n_workers=2, **options) as cluster,
        distributed.Client(cluster) as client,
    ):
        victims = list(client.run(os.getpid).values())
        killed = []

        def kill(done: int, total: int) -> None:
            if done == 1 and not killed:
                killed.append(victims[0])
                os.kill(victims[0], signal.SIGKILL)

        to = {"backend": "dask", "address": cluster.scheduler_address}
        make(TINY, tmp_path / "dask", progress=kill, **to)
    assert killed
    made, wanted = bytes_of(tmp_path / "dask"), bytes_of(tiny)
    for sheet in (made, wanted):  # blank in the one, which its manifest says, too
        del sheet["contact-sheet.png"], sheet[MANIFEST]
    assert made == wanted


def test_labels_are_what_opencv_projects_and_the_pictures_show(tiny: Path) -> None:
    """The thesis' camera sits in the centre of the port, which bends no ray."""
    for one in load_sequences(tiny):
        store = cv2.FileStorage(str(one.pictures.folder / "camera.yml"), cv2.FILE_STORAGE_READ)
        matrix, bent = (
            store.getNode(f"{k}").mat() for k in ("camera_matrix", "distortion_coefficients")
        )
        centres = np.stack([one.markers[f"centre_{axis}_mm"] for axis in "xyz"], axis=-1)[-1]
        centres[:, 2] -= store.getNode("position_mm").real()
        none = np.zeros(3)
        places = centres[:, None].astype(float)
        pixels, _ = cv2.fisheye.projectPoints(places, none, none, matrix, bent)
        told = [one.markers[f"projected_{axis}_px"][-1] for axis in "xy"]
        seen = one.markers["visible"][-1].astype(bool)
        np.testing.assert_allclose(pixels[seen, 0], np.stack(told, axis=-1)[seen], atol=1e-3)
        # A label's pixel is a marker's colour, and the skin's between markers is lighter.
        image = list(one.images())[-1].astype(float)
        for layer, channel in ((0, 1), (1, 2)):  # magenta takes green, yellow takes blue
            x, y = np.rint(one.places[-1, layer, one.visible[-1, layer]]).astype(int).T
            assert image[y, x, channel].mean() < 0.6 * image[240, 320 - 9].max()


def test_what_was_changed_is_named(shapes: Path, tmp_path: Path) -> None:
    spoils: list[tuple[Callable[[Path], Any], str, str]] = [
        (lambda d: (d / "sequence-000001/frame-001.png").write_bytes(b"x"), "has changed", ""),
        (lambda d: (d / "sequence-000001/frame-001.png").unlink(), "frame-001.png is missing", ""),
        (lambda d: (d / "sequence-000001/new.txt").write_text("x"), "does not belong there", ""),
        (lambda d: (d / "sequence-000002" / FILES).write_text("{}"), "has changed", ""),
        (lambda d: (d / "sequence-000001").rename(d / "e"), "json is missing", "json is missing"),
        (lambda d: (d / "recipe.toml").write_text("["), "has changed", "is not valid TOML"),
    ]
    for number, (spoil, said, of_shard) in enumerate(spoils):
        folder = shutil.copytree(shapes, tmp_path / f"spoilt{number}")
        spoil(folder)
        with pytest.raises(UserError, match=said):
            check(folder)
        if of_shard:
            with pytest.raises(UserError, match=of_shard):
                merge([folder], tmp_path / "merged")
            assert not (tmp_path / "merged").exists()


def test_a_value_out_of_its_range_is_named(
    shapes: Path, tmp_path: Path, respelled: Callable[..., None]
) -> None:
    for number, (table, column, value, said) in enumerate((
        ("frames", "normal_n", -0.1, "normal_n is -0.1; allowed: 0 to inf"),
        ("frames", "margin", 1.5, "margin is 1.5; allowed: -0.001 to 1, or NaN"),
        ("frames", "grip_n", math.nan, "grip_n is nan; allowed: -inf to inf"),
        ("markers", "overlap", 2.0, r"overlap\[0\] is 2; allowed: 0 to 1, or NaN"),
    )):  # fmt: skip
        folder = shutil.copytree(shapes, tmp_path / f"wrong{number}")
        respelled(folder, table, column, 1, value)
        with pytest.raises(UserError, match=rf"sequence-000000, {table}\.parquet, frame 1: {said}"):
            check(folder)


def test_parts_share_what_they_are_split_by_and_none_is_empty(
    shapes: Path, tmp_path: Path, typed: Typed
) -> None:
    made = shutil.copytree(shapes, tmp_path / "split")
    radii = radii_of(made)
    for seed in range(3):  # by shapes alone, halves could have five sequences and one
        parts = split(made, {"train": 0.5, "test": 0.5}, seed)
        assert sorted(len(names) for names in parts.values()) == [2, 4]
        first, second = ({radii[n] for n in part} for part in parts.values())
        assert not first & second
        # As many parts as shapes, of which one is to have nearly all.
        parts = split(made, {"a": 0.98, "b": 0.01, "c": 0.01}, seed)
        assert sorted(len(names) for names in parts.values()) == [1, 1, 4]
    # Six objects that differ in their friction have three shapes; a network would know them.
    words = ("dataset", "split", made, "--shares", "train=0.7,test=0.3")
    assert "in several parts" not in typed(*words).stdout
    for by in ("object", "object.friction"):
        assert "of 3 shapes are in several parts: --by sh" in typed(*words, "--by", by).stdout
    parts = json.loads((made / "split.json").read_text("utf-8"))
    assert sorted(name for names in parts.values() for name in names) == sorted(radii)
    assert [len(parts[name]) for name in ("train", "test")] == [4, 2]


def test_what_does_not_fit_is_refused(
    shapes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = shutil.copytree(shapes, tmp_path / "other")
    make(replace(SHAPES, seed=1, sequences=1), tmp_path / "seed1")
    refused: list[tuple[Callable[[], Any], str]] = [
        (lambda: make(replace(SHAPES, seed=1), folder, resume=True), "a dataset of another recipe"),
        (lambda: make(SHAPES, folder), "holds a dataset already; go on with --resume"),
        (lambda: make(SHAPES, tmp_path), r"is not empty; choose another$"),
        (lambda: make(replace(SHAPES, sequences=2), folder, resume=True), "can get more, not few"),
        (lambda: make(SHAPES, tmp_path / "no", shard=(7, 8)), "shard 7/8 of 6 sequences has none"),
        (
            lambda: merge([folder, tmp_path / "seed1"], tmp_path / "no"),
            r"another recipe than .*: sequences is 1, and there 6",
        ),
        (lambda: merge([shapes, folder], tmp_path / "no"), "sequence-000000 is in"),
        (lambda: split(folder, {"train": 0.6, "test": 0.3}), "add up to 1"),
        (
            lambda: split(folder, dict.fromkeys("abcd", 0.25)),
            "in 3 of shape, too few for 4",
        ),
        (lambda: list(load_sequences(folder, "dev")), "no part 'dev'|has no split"),
        (lambda: make(replace(TINY, truth=("contact",)), tmp_path / "no"), "'contact' needs a rec"),
    ]
    for call, said in refused:
        with pytest.raises(UserError, match=said):
            call()
    assert not (tmp_path / "no").exists()
    monkeypatch.setattr(dataset_folder, "made_with", lambda: {"numpy": "9.9"})
    with pytest.raises(UserError, match=r"begun with other versions: .*numpy .*, now 9.9"):
        make(SHAPES, folder, resume=True)
    monkeypatch.undo()
    assert check(folder) == 6


def test_the_command_line_answers_in_a_sentence(typed: Typed, tmp_path: Path) -> None:
    for words, code, said in (
        ("make --help", 0, "usage: chromagrip dataset make "),
        ("make none --out x", 2, "no recipe 'none'; there is benchmark-v2"),
        ("make tiny --out x --shard 3/2", 2, "--shard 3/2: expected"),
        ("check nowhere", 2, "nowhere is no dataset; there is no such folder"),
        ("split nowhere --shares a=0.5,a=1", 2, "--shares a=0.5,a=1: the part a is given twice"),
    ):
        done = typed("dataset", *words.split())
        assert done.returncode == code
        assert said in done.stdout + done.stderr
        assert not (tmp_path / "x").exists()
