"""A disk that fills: one sentence, and no file of a run under its final name."""

import errno
import os
import re
import subprocess
import sys
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import pytest

from chromagrip import UserError, load_scene, run
from chromagrip.loop.run_folder import FILES

QUICK = {"path": "truth", "duration_s": 0.3, "controller": "conservative"}


def test_a_run_leaves_its_files_and_nothing_else(tmp_path: Path) -> None:
    run(load_scene("camera-100hz", QUICK), tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == set(FILES)
    with pytest.raises(UserError, match="is not empty"):
        run(load_scene("camera-100hz", QUICK), tmp_path)
    run(load_scene("camera-100hz", QUICK), tmp_path, overwrite=True)
    assert {path.name for path in tmp_path.iterdir()} == set(FILES)


FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize(
    "target",
    [
        "chromagrip.loop.figure.draw_figure",
        "chromagrip.loop.tactile_video.TactileVideo.add",
        "chromagrip.loop.tactile_video.TactileVideo._finish",
        "pyarrow.parquet.write_table",
        "pathlib.Path.write_text",
    ],
)
def test_a_full_disk_leaves_no_results(
    target: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise FULL

    run(load_scene("camera-100hz", QUICK), tmp_path)
    monkeypatch.setattr(target, full)
    words = f"^(folder )?{tmp_path}.* cannot be written: No space left on device$"
    with pytest.raises(UserError, match=words):
        run(load_scene("camera-100hz", QUICK), tmp_path, overwrite=True)
    assert {path.name for path in tmp_path.iterdir()} <= {"scene.toml"}


LIMITED = """
import resource, sys
from chromagrip.cli.app import main
limit = int(sys.argv.pop(1))
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
main()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of file sizes")
@pytest.mark.parametrize("limit", [4096, 65536])
def test_files_that_cannot_grow_are_one_sentence(limit: int, tmp_path: Path) -> None:
    """Video, figure and table are written by three libraries; each of them must say so."""
    run(load_scene("camera-100hz", QUICK), tmp_path / "here")  # kernels are compiled and cached
    line = ["grasp", "--path", "truth", "--set", "duration_s=0.5", "--out", "run"]
    done: CompletedProcess[str] = subprocess.run(
        [sys.executable, "-c", LIMITED, str(limit), *line],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert done.returncode == 2, done.stderr
    words = "chromagrip: .*run.* cannot be written: File too large"
    assert re.fullmatch(words, done.stderr.strip()), done.stderr
    assert {path.name for path in (tmp_path / "run").iterdir()} <= {"scene.toml"}
