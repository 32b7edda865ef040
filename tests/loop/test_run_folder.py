"""A disk that fills: one sentence, and no file of a run under its final name."""

import errno
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import pytest

from chromagrip import UserError, load_scene, run
from chromagrip.loop.run_folder import FILES

QUICK = {"path": "truth", "duration_s": 0.1, "controller": "conservative"}


def test_a_run_leaves_its_files_and_nothing_else(tmp_path: Path) -> None:
    run(load_scene("camera-100hz", QUICK), tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == set(FILES)
    with pytest.raises(UserError, match="is not empty"):
        run(load_scene("camera-100hz", QUICK), tmp_path)
    run(load_scene("camera-100hz", QUICK), tmp_path, overwrite=True)
    assert {path.name for path in tmp_path.iterdir()} == set(FILES)


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
        "chromagrip.loop.figure.draw_figure",
        "chromagrip.loop.tactile_video.TactileVideo.add",
        "chromagrip.loop.tactile_video.TactileVideo._finish",
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
    assert {path.name for path in out.iterdir()} <= {"scene.toml"}


LIMITED = """
import resource, sys
from chromagrip.cli.app import main
line = sys.argv[1:]
for limit in (65536, 4096):
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    sys.argv = ["chromagrip", *line, f"run-{limit}"]
    try:
        main()
    except SystemExit as ended:
        print(limit, ended.code)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of file sizes")
@pytest.mark.usefixtures("whole")  # kernels are compiled and cached
def test_files_that_cannot_grow_are_one_sentence(tmp_path: Path) -> None:
    """Video, figure and table are written by three libraries; each of them must say so."""
    line = ["grasp", "--path", "truth", "--set", "duration_s=0.5", "--out"]
    done: CompletedProcess[str] = subprocess.run(
        [sys.executable, "-c", LIMITED, *line],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert done.stdout.splitlines() == ["65536 2", "4096 2"], done.stderr
    told = done.stderr.strip().splitlines()
    for limit, sentence in zip((65536, 4096), told, strict=True):
        words = f"chromagrip: .*run-{limit}.* cannot be written: File too large"
        assert re.fullmatch(words, sentence), done.stderr
        assert {path.name for path in (tmp_path / f"run-{limit}").iterdir()} <= {"scene.toml"}
