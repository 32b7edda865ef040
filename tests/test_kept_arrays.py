"""Arrays in the user's cache folder: made once, whole, and by one process for all."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from chromagrip import kept_arrays

#: Makes an array slowly, and says that it did.
MAKER = """
import sys, time
import numpy as np
from chromagrip.kept_arrays import kept_or_made

def make():
    print("made", flush=True)
    time.sleep(1.0)
    return {"numbers": np.arange(5.0)}

print(kept_or_made("kind", "key", make)["numbers"].sum())
"""


def test_of_processes_at_once_one_makes_for_all(tmp_path: Path) -> None:
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
    started = [
        subprocess.Popen(
            [sys.executable, "-P", "-c", MAKER], env=environment, stdout=subprocess.PIPE, text=True
        )
        for _ in range(3)
    ]
    said = [process.communicate(timeout=60)[0].split() for process in started]
    assert sorted(said) == [["10.0"], ["10.0"], ["made", "10.0"]]
    assert [path.name for path in (tmp_path / "chromagrip/kind").iterdir()] == ["key.npz"]


def test_one_that_was_killed_is_not_waited_for(tmp_path: Path) -> None:
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
    command = [sys.executable, "-P", "-c", MAKER]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as killed:
        assert killed.stdout is not None
        assert killed.stdout.readline() == "made\n"
        killed.kill()
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout.split() == ["made", "10.0"]


def test_what_fails_is_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))

    def fail() -> kept_arrays.Arrays:
        raise MemoryError

    with pytest.raises(MemoryError):
        kept_arrays.kept_or_made("kind", "key", fail)
    made = kept_arrays.kept_or_made("kind", "key", lambda: {"numbers": np.arange(3.0)})
    assert made["numbers"].tolist() == [0.0, 1.0, 2.0]
