"""A disk that fills: one sentence, and no file of a run under its final name."""

import errno
import os
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import pytest

from chromagrip import UserError, load_scene, run
from chromagrip.loop.run_files import FILES, RunFiles

Typed = Callable[..., CompletedProcess[str]]
QUICK = {"path": "truth", "duration_s": 0.1, "controller": "conservative"}


def test_a_run_leaves_its_files_and_nothing_else(tmp_path: Path) -> None:
    run(load_scene("camera-100hz", QUICK), tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == set(FILES)
    with pytest.raises(UserError, match="is not empty"):
        run(load_scene("camera-100hz", QUICK), tmp_path)
    run(load_scene("camera-100hz", QUICK), tmp_path, overwrite=True)
    assert {path.name for path in tmp_path.iterdir()} == set(FILES)


def test_a_run_that_ends_before_its_first_frame_leaves_no_folder(tmp_path: Path) -> None:
    scene = load_scene("camera-100hz", QUICK)
    with RunFiles(tmp_path / "new", False, scene):
        assert (tmp_path / "new" / "scene.toml").is_file()
    assert not (tmp_path / "new").exists()
    kept = tmp_path / "mine.txt"
    kept.write_text("mine")
    with RunFiles(tmp_path, True, scene):
        pass
    assert kept.read_text() == "mine"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of an earlier run."""
    folder = tmp_path_factory.mktemp("whole")
    run(load_scene("camera-100hz", QUICK), folder)
    return folder


FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize(
    "target",
    [
        "chromagrip.loop.shown.figure.draw_figure",
        "chromagrip.loop.shown.tactile_video.TactileVideo.show",
        "chromagrip.loop.shown.tactile_video.TactileVideo._finish",
        "pyarrow.parquet.write_table",
        "pathlib.Path.write_text",
    ],
)
def test_a_full_disk_leaves_no_results(
    target: str, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise FULL

    out = tmp_path / "run"
    shutil.copytree(whole, out)
    monkeypatch.setattr(target, full)
    words = f"^(folder )?{out}.* cannot be written: No space left on device$"
    with pytest.raises(UserError, match=words):
        run(load_scene("camera-100hz", QUICK), out, overwrite=True)
    assert not out.exists()


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of file sizes")
@pytest.mark.usefixtures("whole")  # kernels are compiled and cached
@pytest.mark.parametrize("limit", [65536, 4096])
def test_files_that_cannot_grow_are_one_sentence(
    limit: int, tmp_path: Path, typed: Typed, small_files: Callable[[int], None]
) -> None:
    """Video, figure and table are written by three libraries; each of them must say so."""
    small_files(limit)
    line = ["grasp", "--path", "truth", "--set", "duration_s=0.5", "--out"]
    done = typed(*line, f"run-{limit}")
    assert (done.returncode, done.stdout) == (2, "")
    words = f"chromagrip: .*run-{limit}.* cannot be written: File too large"
    assert re.fullmatch(words, done.stderr.strip()), done.stderr
    assert not (tmp_path / f"run-{limit}").exists()
