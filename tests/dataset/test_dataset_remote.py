"""Datasets at addresses: in memory, and in a bucket of a local server where moto is installed."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from msgspec.structs import replace

from chromagrip import UserError
from chromagrip.dataset import load_sequences
from chromagrip.dataset.check import check
from chromagrip.dataset.export.layouts import export
from chromagrip.dataset.make import make, merge
from chromagrip.dataset.recipe import load_recipe
from chromagrip.dataset.split import split

fsspec = pytest.importorskip("fsspec")
TINY = load_recipe("tiny")
TINY = replace(TINY, sequences=2, scene=TINY.scene | {"duration_s": 0.02})


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same dataset in a folder."""
    folder = tmp_path_factory.mktemp("data") / "here"
    make(TINY, folder)
    return folder


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    """Address of a server that speaks S3, where moto is installed."""
    pytest.importorskip("s3fs")
    server = pytest.importorskip("moto.server").ThreadedMotoServer("127.0.0.1", port=0)
    server.start()
    host, port = server.get_host_and_port()
    yield f"http://{host}:{port}"
    server.stop()


@pytest.fixture(params=["memory", "s3"])
def bucket(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Address of an empty place."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    name = tmp_path.name.replace("_", "-")[-40:].strip("-")
    if request.param == "memory":
        return f"memory://{name}"
    for key, value in (
        ("AWS_ACCESS_KEY_ID", "x"), ("AWS_SECRET_ACCESS_KEY", "x"),
        ("AWS_DEFAULT_REGION", "us-east-1"),
        ("AWS_ENDPOINT_URL", request.getfixturevalue("server")),
    ):  # fmt: skip
        monkeypatch.setenv(key, value)
    fsspec.filesystem("s3").mkdir(name)
    return f"s3://{name}/tiny"


def _files(address: str) -> dict[str, bytes]:
    fs, root = fsspec.core.url_to_fs(address)
    return {path.removeprefix(root).lstrip("/"): fs.cat_file(path) for path in fs.find(root)}


def _of_folder(folder: Path) -> dict[str, bytes]:
    found = (f for f in folder.rglob("*") if f.is_file() and not f.name.startswith("."))
    return {f.relative_to(folder).as_posix(): f.read_bytes() for f in found}


def test_an_address_holds_what_a_folder_does(bucket: str, here: Path, tmp_path: Path) -> None:
    for k in (1, 2):
        make(TINY, f"{bucket}-{k}", shard=(k, 2))
    merge([f"{bucket}-2", f"{bucket}-1"], bucket)
    assert _files(bucket) == _of_folder(here)
    with pytest.raises(UserError, match="is not empty; go on with --resume"):
        make(TINY, bucket)
    # From a machine that has nothing of it yet.
    (tmp_path / "cache").rename(tmp_path / "gone")
    assert check(bucket) == 2
    split(bucket, {"train": 0.5, "test": 0.5})
    assert "split.json" in _files(bucket)
    (one,) = load_sequences(bucket, "test")
    (same,) = (s for s in load_sequences(here) if s.number == one.number)
    assert (next(one.images()) == next(same.images())).all()
    export(bucket, "webdataset", f"{bucket}-tar")
    assert {name.split("/")[0] for name in _files(f"{bucket}-tar")} == {"train", "test"}


def test_an_interrupted_run_goes_on_where_it_was_begun(
    bucket: str, here: Path, tmp_path: Path
) -> None:
    def stop(done: int, total: int) -> None:
        if done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make(TINY, bucket, progress=stop)
    assert not _files(bucket)
    with pytest.raises(UserError, match="is no dataset, or not whole"):
        check(bucket)
    seen: list[int] = []
    make(TINY, bucket, resume=True, progress=lambda done, total: seen.append(done))
    assert seen == [1, 2]
    assert _files(bucket) == _of_folder(here)
    # From another machine, more sequences are added to what is whole.
    (tmp_path / "cache").rename(tmp_path / "gone")
    assert len(make(replace(TINY, sequences=3), bucket, resume=True)["sequences"]) == 3
    assert check(bucket) == 3


def test_an_address_that_does_not_answer_is_said() -> None:
    with pytest.raises(UserError, match="nowhere://x cannot be used: Protocol not known"):
        check("nowhere://x")
