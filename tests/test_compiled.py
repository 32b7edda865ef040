"""Kernels that are kept, and what is said where they are not; each in a process of its own."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

import pytest

from chromagrip import compiled

KERNEL = """
from chromagrip import compiled

@compiled.njit()
def double(x):
    return 2 * x

compiled.announce()
print(double(1.5), double(4))
"""
COMPILING = "chromagrip: compiling its kernels, once; this takes about a minute"

Run = Callable[..., CompletedProcess[str]]


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """Runs a small kernel that lies in a folder of its own."""
    (tmp_path / "code").mkdir()
    (tmp_path / "code/kernel.py").write_text(KERNEL)
    clean = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}

    def start(**changes: object) -> CompletedProcess[str]:
        changed = {k: str(v) for k, v in ({"XDG_CACHE_HOME": tmp_path / "user"} | changes).items()}
        command = [sys.executable, "-P", str(tmp_path / "code/kernel.py")]
        done = subprocess.run(
            command, env=clean | changed, capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stdout) == (0, "3.0 8\n"), done.stderr
        return done

    return start


def kept(folder: Path) -> int:
    return len(list(folder.rglob("*.nbi")))


def test_compiling_is_said_at_the_first_run_only(run: Run, tmp_path: Path) -> None:
    assert run().stderr == f"{COMPILING}\n"
    assert run().stderr == ""
    assert kept(tmp_path / "code/__pycache__") == 1
    assert not (tmp_path / "user").exists()


def test_a_folder_that_is_chosen_is_used(run: Run, tmp_path: Path) -> None:
    assert run(NUMBA_CACHE_DIR=tmp_path / "chosen").stderr == f"{COMPILING}\n"
    assert run(NUMBA_CACHE_DIR=tmp_path / "chosen").stderr == ""
    assert kept(tmp_path / "chosen") == 1
    # Named by the sources, as numba sees no change in another file.
    assert [*(tmp_path / "chosen").rglob(f"kernels-{compiled._sources()}")]


def test_a_chosen_folder_that_cannot_be_written_is_said(run: Run, tmp_path: Path) -> None:
    lost = tmp_path / "code/kernel.py"  # a file, which nobody can write into as a folder
    for _ in range(2):
        (sentence,) = run(NUMBA_CACHE_DIR=lost).stderr.splitlines()
        assert f"NUMBA_CACHE_DIR={lost} cannot be written" in sentence
        assert "compiled at each start" in sentence


def test_a_package_that_cannot_be_written_is_said(run: Run, tmp_path: Path) -> None:
    (tmp_path / "code/__pycache__").write_text("no folder")
    (sentence,) = run().stderr.splitlines()
    assert sentence.startswith(f"{COMPILING} (they are kept in {tmp_path / 'user/chromagrip'}, ")
    assert run().stderr == ""
    assert kept(tmp_path / "user") == 1


def test_nothing_that_can_be_written_is_said(run: Run, tmp_path: Path) -> None:
    (tmp_path / "code/__pycache__").write_text("no folder")
    for _ in range(2):
        (sentence,) = run(XDG_CACHE_HOME=tmp_path / "code/kernel.py").stderr.splitlines()
        assert "cannot be written, so the kernels are compiled at each start" in sentence
        assert "set NUMBA_CACHE_DIR to a folder that can be written" in sentence
