"""Datasets of strangers: each command answers, or refuses in one sentence and leaves nothing."""

import importlib
import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from random import Random

import pytest

from chromagrip import UserError
from chromagrip.dataset import load_sequences
from chromagrip.dataset.check import check as check_dataset
from chromagrip.dataset.folder import CARD, FILES, MANIFEST, SHEET, TABLE
from chromagrip.dataset.make import make
from chromagrip.dataset.recipe import Recipe

from ..dataset.sealing import sealed
from .damages import harmed
from .judged import Judge, few_and_many, repeated

made_by = importlib.import_module("chromagrip.dataset.make")
NAME, SECOND = "sequence-000000", "sequence-000001"
#: Parts of which some are none, or those of others.
PARTS = (
    "[]", '{"../../../x": ["sequence-000000"]}', '{"a": ["sequence-000000", "sequence-000000"]}',
    '{"a": [3]}', '{"": ["sequence-000000"]}', '{"..": ["sequence-000000"]}', '{"a": ["../x"]}',
)  # fmt: skip
SCENE = {"body": "dome", "sensor": "dome-2022", "duration_s": 0.1, "camera": {"rate_hz": 20.0}}
DRAW = {"motion": {"choice": ["move"]}, "pose.press_share": {"uniform": [0.2, 0.3]}}
RECIPES = {
    "dome": Recipe(sequences=1, scene=SCENE, draw=DRAW),
    "chain": Recipe(sequences=2, scene={"duration_s": 0.05}),
}
#: Commands with their words, and what they make.
MAKES = ("merged", "exported", "given/split.json")
COMMANDS = (
    ("dataset", "check", "given"), ("dataset", "info", "given"),
    ("dataset", "split", "given", "--shares", "train=1"),
    ("dataset", "merge", "given", "--out", "merged/deep"),
    *(("dataset", "export", "given", "--out", "exported", "--to", kind)
      for kind in ("coco", "tapvid", "webdataset", "lerobot")),
    ("score", "t.csv", "given", "--json"),
)  # fmt: skip


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of each body; not to be changed."""
    place = tmp_path_factory.mktemp("whole")
    for name, recipe in RECIPES.items():
        make(recipe, place / name)
    return place


@pytest.fixture(autouse=True)
def _tracks(judged: Judge) -> None:
    (judged.place / "t.csv").write_text("frame,marker,layer,x,y\n0,0,magenta,320,240\n")


def harm(data: Path, draw: Random) -> None:
    """Damage a file of a dataset, the folder of its sequence, or its split."""
    what = draw.random()
    if what < 0.05:
        (data / "split.json").write_text(draw.choice(PARTS))
    elif what < 0.1:
        shutil.rmtree(data / NAME)
        draw.choice((Path.mkdir, Path.touch))(data / NAME)
    else:
        files = [path.relative_to(data).as_posix() for path in data.rglob("*") if path.is_file()]
        tables = [name for name in files if not name.endswith("png")]
        harmed(data / draw.choice(sorted(draw.choice((files, tables)))), draw)


@few_and_many(6, 300)
def test_damaged_datasets_are_read_or_refused(judged: Judge, whole: Path, count: int) -> None:
    def check(draw: Random) -> None:
        with judged.files(whole / draw.choice(list(RECIPES))) as folder:
            harm(folder, draw)
            if draw.random() < 0.7:
                sealed(folder)
            had = (folder / "split.json").exists()  # which a split replaces
            words = draw.choice([each for each in COMMANDS if not (had and "split" in each)])
            judged.command(*words, names="given", makes=MAKES[: 3 - had])

    with judged.files(whole / "dome"):
        for words in (COMMANDS[0], COMMANDS[3], COMMANDS[-1]):
            assert judged.command(*words, makes=MAKES).returncode == 0, words
    repeated(check, count)
    assert judged.refused > count // 3


@pytest.mark.parametrize(
    ("key", "name"),
    [("files", "../../../../outside"), ("sequences", "/outside"),
     ("sequences", f"{NAME}/../../outside")],
)  # fmt: skip
def test_a_manifest_names_nothing_outside_its_place(
    judged: Judge, whole: Path, monkeypatch: pytest.MonkeyPatch, key: str, name: str
) -> None:
    """Such names wrote files outside of the cache of an address, and emptied folders there."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(judged.place / "a/b/cache"))
    address, told = f"memory://{key}{len(name)}", "outside', which no dataset has"
    with judged.files(whole / "dome") as folder:
        manifest = json.loads((folder / MANIFEST).read_text("utf-8"))
        manifest[key][name] = "0" * 64
        (folder / MANIFEST).write_text(json.dumps(manifest), "utf-8")
        fs, root = pytest.importorskip("fsspec").core.url_to_fs(address)
        for file in filter(Path.is_file, folder.rglob("*")):
            fs.pipe_file(f"{root}/{file.relative_to(folder).as_posix()}", file.read_bytes())
        fs.pipe_file(f"{root}/{name}" if key == "files" else f"{root}/{name}/x", b"mine")
        judged.call(lambda: check_dataset(Path("given")), names=told)
        with pytest.raises(UserError, match=told):
            check_dataset(address)
        assert [path.name for path in judged.outside.iterdir()] == ["secret"]


@pytest.mark.parametrize("name", [NAME, f"{NAME}/camera.yml"])
def test_links_that_leave_are_followed_on_request_alone(
    judged: Judge, whole: Path, name: str
) -> None:
    """As in caches of hubs, whose files are links to those of a common store."""
    with judged.files(whole / "dome") as folder:
        (folder / name).rename(judged.outside / "kept")
        (folder / name).symlink_to(judged.outside / "kept")
        for words in COMMANDS[:5] + COMMANDS[-1:]:
            judged.command(*words, names="leads out of its folder; give --follow-links")
        assert judged.refused == 6
        assert judged.command(*COMMANDS[3], "--follow-links", makes=MAKES).returncode == 0
        (one,) = load_sequences(folder, follow_links=True)
        assert len(one.pictures) == 3


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("recipe.toml", "\n[[cases]]\nname = 'x'\nscene.sensor = '/secret.toml'"),
        (f"{NAME}/scene.toml", 'sensor = "../../secret.toml"'),
        ("sensors/mine/mine.toml", '[camera]\ncalibration = "../../../secret.yml"'),
    ],
)
def test_files_outside_are_not_named(judged: Judge, whole: Path, file: str, text: str) -> None:
    """A merge copies what a recipe and a sensor name."""
    with judged.files(whole / "dome") as folder:
        path = folder / file
        path.parent.mkdir(parents=True, exist_ok=True)
        before = path.read_text("utf-8") if path.is_file() else ""
        after = re.sub('^sensor = ".*"', text, before, flags=re.M)
        path.write_text(after if text.startswith("sensor") else before + text, "utf-8")
        manifest = json.loads((folder / MANIFEST).read_text("utf-8"))
        manifest["files"] |= {} if file.startswith(NAME) else {file: ""}
        (folder / MANIFEST).write_text(json.dumps(manifest), "utf-8")
        sealed(folder)
        for words in (COMMANDS[0], COMMANDS[3]):
            judged.command(*words, names="which is outside of the dataset")
    assert judged.refused == 2


def test_score_blames_a_broken_truth_and_no_tracker(judged: Judge, whole: Path) -> None:
    """Also where the checksums were made to fit."""
    with judged.files(whole / "chain") as folder:
        (folder / SECOND / "rest.png").write_bytes(b"\x89PNG nothing")
        words = ("score", "t.csv", f"given/{SECOND}", "--json")
        judged.command(*words, names="rest.png has changed")
        sealed(folder)
        judged.command(*words, names="rest.png cannot be read")
    assert judged.refused == 2


@pytest.fixture
def made(whole: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A dataset of a chain; sequences and their card are made as fast as copies."""
    made = whole / "chain"

    def put_back(recipe: bytes, out: str, number: int) -> int:
        name = f"sequence-{number:06d}"
        shutil.copytree(made / name, Path(out) / name)
        return number

    def card(folder: Path, *_: object) -> None:
        for name in (TABLE, CARD, SHEET):
            shutil.copy(made / name, folder / name)

    monkeypatch.setattr(made_by, "_make", put_back)
    monkeypatch.setattr(made_by, "write_card", card)
    return made


@few_and_many(3, 40)
def test_resume_makes_again_what_is_damaged(
    judged: Judge, made: Path, bytes_of: Callable[[Path], dict[str, str]], count: int
) -> None:
    """With a manifest and without: the second sequence is damaged, found and put back."""
    expected = bytes_of(made)

    def mended(folder: Path) -> list[str]:
        again: list[str] = []
        make(RECIPES["chain"], folder, resume=True, damaged=again.extend)
        assert bytes_of(folder) == expected
        return again

    def check(draw: Random) -> None:
        with judged.files(made) as folder:
            if draw.random() < 0.5:
                (folder / MANIFEST).unlink()
            path = draw.choice(sorted((folder / SECOND).iterdir()))
            before = path.read_bytes()
            harmed(path, draw, 0.3)
            odd = path.is_symlink() or path.is_fifo()
            same = not odd and path.is_file() and path.read_bytes() == before
            try:
                assert mended(folder) == [SECOND] * (not same)
            except UserError:
                assert odd

    repeated(check, count)
    for name in (FILES, "new.txt"):  # no list, and a file too many
        with judged.files(made) as folder:
            (folder / SECOND / name).write_text("")
            assert mended(folder) == [SECOND]


def test_what_is_called_whole_was_synced_before(
    judged: Judge, made: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A power cut after the manifest loses nothing."""
    synced, sync = [], os.fsync
    with judged.files(made) as folder:

        def noted(handle: int) -> None:
            sync(handle)
            path = Path(os.readlink(f"/proc/self/fd/{handle}"))
            if path.is_relative_to(folder):
                synced.append(re.sub(r"\.part-\d+-", "", path.relative_to(folder).as_posix()))

        monkeypatch.setattr(os, "fsync", noted)
        make(RECIPES["chain"], folder, resume=True)
        files = {file.relative_to(folder).as_posix() for file in folder.rglob("*")}
        manifest = synced.index(MANIFEST)
        assert files - {MANIFEST} == set(synced[:manifest])
        assert synced[manifest + 1 :] == ["."]


def test_a_failed_merge_leaves_nothing(
    judged: Judge, whole: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither sequences without a manifest nor folders that were made for it."""

    def fail(*_: object) -> None:
        raise UserError("the disk is full")

    monkeypatch.setattr(made_by, "write_card", fail)
    with judged.files(whole / "dome"):
        merge = ("dataset", "merge", "given", "--out", "new/deeper")
        assert judged.command(*merge, names="the disk is full").returncode == 2
