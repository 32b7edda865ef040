"""What a stranger's dataset or address may try, and what --resume finds damaged."""

import importlib
import json
import os
import re
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from msgspec.structs import replace

from chromagrip import UserError
from chromagrip.dataset import load_sequences
from chromagrip.dataset.check import check
from chromagrip.dataset.folder import CARD, FILES, MANIFEST, SHEET, TABLE
from chromagrip.dataset.make import make, merge
from chromagrip.dataset.recipe import load_recipe
from chromagrip.measure.score.points import read_points
from chromagrip.strange_files import read_arrays

from .sealing import digest, sealed

NAME = "sequence-000000"
made_by = importlib.import_module("chromagrip.dataset.make")
Typed = Callable[..., CompletedProcess[str]]


def given(folder: Path, address: str) -> None:
    """Put a folder at an address, with the names that its manifest gives."""
    fs, root = pytest.importorskip("fsspec").core.url_to_fs(address)
    for file in folder.rglob("*"):
        if file.is_file():
            fs.pipe_file(f"{root}/{file.relative_to(folder).as_posix()}", file.read_bytes())


@pytest.mark.parametrize("key", ["files", "sequences"])
@pytest.mark.parametrize(
    "name", ["../../../../victim", "../victim", "/victim", "sequence-000000/../../victim", "victim"]
)
def test_an_address_writes_nothing_outside_its_place(
    seed_dome: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, key: str, name: str
) -> None:
    """Such names wrote files outside of the cache, and emptied folders there."""
    cache = tmp_path / "a" / "b" / "cache"
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    data = shutil.copytree(seed_dome, tmp_path / "data")
    manifest = json.loads((data / MANIFEST).read_text("utf-8"))
    manifest[key][name] = "0" * 64
    (data / MANIFEST).write_text(json.dumps(manifest), "utf-8")
    address = f"memory://strange-{digest(data / MANIFEST)[:12]}"
    given(data, address)
    fs, root = pytest.importorskip("fsspec").core.url_to_fs(address)
    fs.pipe_file(f"{root}/{name}" if key == "files" else f"{root}/{name}/x", b"mine")
    victims = [tmp_path / "victim", tmp_path / "a" / "victim", cache / "chromagrip" / "victim"]
    for victim in victims:
        victim.mkdir(parents=True)
        (victim / "kept").write_text("kept")
    for place in (address, data):
        with pytest.raises(UserError, match=r"names .*victim', which no dataset has"):
            check(place)
    assert all([file.name for file in victim.iterdir()] == ["kept"] for victim in victims)
    assert {path.name for path in tmp_path.iterdir()} == {"data", "a", "victim"}


@pytest.mark.parametrize("where", ["sequence", "file", "camera", "objects"])
def test_links_that_leave_are_followed_on_request_alone(
    seed_dome: Path, tmp_path: Path, typed: Typed, where: str
) -> None:
    """As in caches of hubs, whose files are links to those of a common store."""
    data, store = shutil.copytree(seed_dome, tmp_path / "data"), tmp_path / "store"
    store.mkdir()
    name = {"sequence": NAME, "file": "recipe.toml", "camera": f"{NAME}/camera.yml", "objects": ""}
    if where == "objects":
        (data / "objects").symlink_to(store)
    else:
        (data / name[where]).rename(store / "kept")
        (data / name[where]).symlink_to(store / "kept")
    commands = [
        ("info", data), ("check", data), ("split", data, "--shares", "train=1"),
        ("merge", data, "--out", tmp_path / "merged"),
        ("export", data, "--to", "webdataset", "--out", tmp_path / "tar"),
    ]  # fmt: skip
    (tmp_path / "t.csv").write_text("frame,marker,layer,x,y\n0,0,magenta,320,240\n")
    for words in (*[("dataset", *words) for words in commands],
                  ("score", tmp_path / "t.csv", data, "--json")):  # fmt: skip
        done = typed(*words)
        assert done.returncode == 2, words
        assert "leads out of its folder; give --follow-links" in done.stderr
    assert not (tmp_path / "merged").exists()
    for words in (commands[0], commands[3], commands[4]):
        assert typed("dataset", *words, "--follow-links").returncode == 0, words
    assert typed("dataset", "info", tmp_path / "merged").returncode == 0
    (one,) = load_sequences(data, follow_links=True)
    assert len(one.pictures) == 3


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("recipe.toml", 'sensor = "../../secret.toml"'),
        ("recipe.toml", "\n[[cases]]\nname = 'x'\nscene.sensor = '/secret.toml'"),
        (f"{NAME}/scene.toml", 'sensor = "../../secret.toml"'),
        ("sensors/mine/mine.toml", '[camera]\ncalibration = "../../../secret.yml"'),
        ("sensors/mine/mine.toml", '[layout]\npath = "/etc/hostname"'),
    ],
)
def test_files_outside_are_not_named(seed_dome: Path, tmp_path: Path, file: str, text: str) -> None:
    """A merge copies what a recipe and a sensor name."""
    data = shutil.copytree(seed_dome, tmp_path / "data")
    path = data / file
    path.parent.mkdir(parents=True, exist_ok=True)
    before = path.read_text("utf-8") if path.is_file() else ""
    after = re.sub('^sensor = ".*"', text, before, flags=re.M)
    path.write_text(after if text.startswith("sensor") else before + text, "utf-8")
    manifest = json.loads((data / MANIFEST).read_text("utf-8"))
    manifest["files"] |= {} if file.startswith(NAME) else {file: ""}
    (data / MANIFEST).write_text(json.dumps(manifest), "utf-8")
    sealed(data)
    for use in (lambda: merge([data], tmp_path / "out"), lambda: check(data)):
        with pytest.raises(UserError, match="which is outside of the dataset"):
            use()
    assert not (tmp_path / "out").exists()


TINY = replace(load_recipe("tiny"), sequences=2)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sequences of a chain."""
    folder = tmp_path_factory.mktemp("data") / "tiny"
    make(TINY, folder)
    return folder


def flipped(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def replaced(old: str, new: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(path.read_text("utf-8").replace(old, new), "utf-8")


DAMAGES: list[tuple[str, Callable[[Path], object]]] = [
    ("frame-003.png", flipped),
    ("markers.parquet", lambda path: path.unlink()),
    ("scene.toml", lambda path: (path.unlink(), path.mkdir())),
    ("new.txt", lambda path: path.write_text("x")),
    (FILES, lambda path: path.write_bytes(b"")),
    (FILES, replaced('"grip_n":', '"grip":')),
    (FILES, replaced('"number": 1', '"number": 0')),
    (FILES, replaced('"numpy":', '"other":')),
    ("", lambda path: (shutil.rmtree(path), path.write_text("x"))),
]


@pytest.fixture
def remade(made: Path, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of the sequences that are made, as fast as a copy; so is the card."""
    numbers = []

    def put_back(recipe: bytes, out: str, number: int) -> int:
        numbers.append(number)
        shutil.copytree(made / f"sequence-{number:06d}", Path(out) / f"sequence-{number:06d}")
        return number

    def card(folder: Path, *_: object) -> None:
        for name in (TABLE, CARD, SHEET):
            shutil.copy(made / name, folder / name)

    monkeypatch.setattr(made_by, "_make", put_back)
    monkeypatch.setattr(made_by, "write_card", card)
    return numbers


def test_resume_makes_again_what_is_damaged(
    made: Path,
    remade: list[int],
    tmp_path: Path,
    bytes_of: Callable[[Path], dict[str, str]],
) -> None:
    """With a manifest and without: the second sequence is damaged, found and put back."""
    expected = bytes_of(made)
    for k, (name, damage) in enumerate(DAMAGES):
        folder = shutil.copytree(made, tmp_path / f"{k}")
        if k % 3:
            (folder / MANIFEST).unlink()
        damage(folder / "sequence-000001" / name)
        again: list[str] = []
        make(TINY, folder, resume=True, damaged=again.extend)
        assert again == ["sequence-000001"], name
        assert remade == [1], name
        remade.clear()
        assert bytes_of(folder) == expected
        shutil.rmtree(folder)


def test_a_failed_merge_leaves_nothing(
    seed_dome: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither sequences without a manifest nor folders that were made for it."""

    def fail(*_: object) -> None:
        raise UserError("the disk is full")

    monkeypatch.setattr(made_by, "write_card", fail)
    (tmp_path / "empty").mkdir()
    for out in ("new/deeper", "empty"):
        with pytest.raises(UserError, match="the disk is full"):
            merge([seed_dome], tmp_path / out)
    assert [path.name for path in tmp_path.rglob("*")] == ["empty"]


@pytest.mark.usefixtures("remade")
def test_what_is_called_whole_was_synced_before(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A power cut after the manifest loses nothing."""
    folder, synced = shutil.copytree(made, tmp_path / "data"), []
    sync = os.fsync

    def noted(handle: int) -> None:
        sync(handle)
        path = Path(os.readlink(f"/proc/self/fd/{handle}"))
        if path.is_relative_to(folder):
            name = path.relative_to(folder).as_posix()
            synced.append(re.sub(r"\.part-\d+-", "", name))

    monkeypatch.setattr(os, "fsync", noted)
    make(TINY, folder, resume=True)
    files = {file.relative_to(folder).as_posix() for file in folder.rglob("*")}
    manifest = synced.index(MANIFEST)
    assert files - {MANIFEST} == set(synced[:manifest])
    assert synced[manifest + 1 :] == ["."]


@pytest.mark.usefixtures("remade")
def test_an_address_with_a_damaged_sequence_is_mended(
    made: Path, tmp_path: Path, typed: Typed, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command tells how many were made again."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr("chromagrip.dataset.frozen.seal", lambda folder: {})
    data = shutil.copytree(made, tmp_path / "data")
    flipped(data / "sequence-000001" / "frame-003.png")
    address = f"memory://{tmp_path.name}"
    given(data, address)
    words = ("dataset", "make", "tiny", "--n", 2, "--workers", 1, "--out", address, "--json")
    assert json.loads(typed(*words, "--resume").stdout)["damaged_and_made_again"] == 1
    shutil.rmtree(tmp_path / "cache")
    assert check(address) == 2


@pytest.mark.parametrize("number", ["1e300", "100000000", "99999999"])
def test_a_huge_frame_number_is_a_sentence(tmp_path: Path, number: str) -> None:
    (tmp_path / "t.csv").write_text(f"frame,marker,x,y\n0,0,1,1\n{number},0,1,1\n")
    kind = float if "e" in number else int
    columns = {"marker": [0, 0], "x": [1.0, 1.0], "y": [1.0, 1.0]}
    pq.write_table(pa.table({"frame": [kind(0), kind(number)], **columns}), tmp_path / "t.parquet")
    for name in ("t.csv", "t.parquet"):
        with pytest.raises(UserError, match=r"no whole number below 100000000|give --max-rows"):
            read_points(tmp_path / name)


def test_a_long_table_is_refused_by_its_metadata(tmp_path: Path) -> None:
    """A hundred million rows of zeros take a few kilobytes."""
    zeros = pa.array(np.zeros(3_000_000))
    table = pa.table(dict.fromkeys(("frame", "marker", "x", "y"), zeros))
    pq.write_table(table, tmp_path / "t.parquet")
    with pytest.raises(UserError, match="3000000 rows, more than 2000000; give --max-rows"):
        read_points(tmp_path / "t.parquet", most=2_000_000)


def test_an_array_that_claims_more_than_it_holds_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "t.npz"
    for shape, held, told in (
        ((1_000_000, 1_000_000, 2), 100, "claims 16000000000000 bytes"),
        ((-5, 2, 2), 100, "claims"),
        ((1_000, 200, 2), 3_200_000, "values, too many to read"),
    ):
        text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}\n"
        header = (
            b"\x93NUMPY\x01\x00" + len(text + "\n").to_bytes(2, "little") + text.encode() + b"\n"
        )
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
            with file.open("tracks.npy", "w") as stream:
                stream.write(header + bytes(held))
            file.writestr("visibles.npy", b"")
        with pytest.raises(UserError, match=told):
            read_arrays(path, ["tracks"], 100_000)
        with pytest.raises(UserError, match=rf"^tracks {path}: .*(?:{told}|visibles)"):
            read_points(path, most=50_000)


@pytest.mark.parametrize(("tracker", "name"), [("t.csv", "rest.png"), ("fit", "frame-002.png")])
def test_score_does_not_blame_a_tracker_for_a_broken_truth(
    made: Path, tmp_path: Path, typed: Typed, tracker: str, name: str
) -> None:
    """Also where the checksums were made to fit."""
    data = shutil.copytree(made, tmp_path / "data")
    if tracker == "t.csv":
        tracker = str(tmp_path / "t.csv")
        Path(tracker).write_text("frame,marker,layer,x,y\n0,0,magenta,320,240\n")
    truth = data / "sequence-000001"
    (truth / name).write_bytes(b"\x89PNG nothing")
    done = typed("score", tracker, truth, "--json")
    assert done.returncode == 2
    assert f"{name} has changed" in done.stderr
    sealed(data)
    done = typed("score", tracker, truth, "--json")
    assert done.returncode == 2
    assert f"{name} cannot be read" in done.stderr
