"""Of two processes that write one folder, one works and the other is refused."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from subprocess import CompletedProcess

import pytest

from chromagrip import folders as folder_module
from chromagrip.cli import options
from chromagrip.errors import UserError
from chromagrip.folders import LOCK, filling, prepared

Typed = Callable[..., CompletedProcess[str]]

#: Holds a folder until it is ended.
HOLD = """
import sys, time
from pathlib import Path
from chromagrip.folders import prepared

with prepared(Path(sys.argv[1]), overwrite=True):
    print("held", flush=True)
    time.sleep(600)
"""
SHORT = ("--path", "truth", "--set", "duration_s=0.05")
#: Commands that fill a folder, without its name.
COMMANDS = {
    "grasp": ("grasp", *SHORT, "--overwrite"),
    "sweep": ("sweep", *SHORT, "--seeds", "1", "--workers", "1", "--overwrite"),
    "dataset make": ("dataset", "make", "tiny", "--n", "1", "--workers", "1"),
}


@contextmanager
def holding(folder: Path) -> "Iterator[subprocess.Popen[str]]":
    """Process that holds a folder."""
    command = [sys.executable, "-c", HOLD, str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        try:
            yield process
        finally:
            process.kill()


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder that another process fills."""
    folder = tmp_path_factory.mktemp("held")
    with holding(folder):
        yield folder


@pytest.mark.parametrize("name", COMMANDS)
def test_the_second_writer_is_refused(
    name: str, typed: Typed, held: Path, bytes_of: Callable[[Path], dict[str, str]]
) -> None:
    before = bytes_of(held)
    done = typed(*COMMANDS[name], "--out", held)
    assert done.returncode == 2
    holder = (held / LOCK).read_text().split()[1]
    assert f"is being filled by process {holder} on" in done.stderr.splitlines()[-1]
    assert bytes_of(held) == before


def test_a_killed_writer_holds_nothing(tmp_path: Path) -> None:
    with holding(tmp_path) as process:
        with pytest.raises(UserError, match=f"process {process.pid} on"), filling(tmp_path):
            pass
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    assert (tmp_path / LOCK).exists()  # which says nothing
    with prepared(tmp_path, overwrite=None):
        pass
    assert not list(tmp_path.iterdir())


def test_of_many_at_once_one_gets_in(tmp_path: Path) -> None:
    """Each removes its file as it ends: no other takes a removed file for the lock."""
    script = """
import sys
from pathlib import Path
from chromagrip.errors import UserError
from chromagrip.folders import filling

folder, got = Path(sys.argv[1]), 0
while got < 50:
    try:
        with filling(folder):
            (folder / "inside").touch(exist_ok=False)
            (folder / "inside").unlink()
            got += 1
    except UserError:
        pass
"""
    command = [sys.executable, "-c", script, str(tmp_path)]
    processes = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(4)]
    said = [process.communicate(timeout=60)[1] for process in processes]
    assert said == [""] * 4
    assert not list(tmp_path.iterdir())


def test_default_names_do_not_collide(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(folder_module, "_made", [])
    names = [options.new_folder("grasp") for _ in range(3)]
    assert [name.name for name in names] == ["grasp-001", "grasp-002", "grasp-003"]
    (names[1] / "trace").touch()
    folder_module.remove_empty()
    assert sorted((tmp_path / "runs").iterdir()) == [names[1].absolute()]
