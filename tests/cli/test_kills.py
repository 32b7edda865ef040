"""Commands that are killed without warning: what they leave is gone on with, or refused."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from chromagrip.dataset.check import check
from chromagrip.dataset.folder import MANIFEST
from chromagrip.errors import UserError
from chromagrip.loop.results.run_folder import read_run

pytestmark = [
    pytest.mark.fuzz,
    pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL"),
]
Digests = Callable[[Path], dict[str, str]]
#: Runs a command, after a delay kills it, and returns its exit code.
Killing = Callable[..., int]

#: Starts each command in a fork, so that modules are imported once.
FORKS = """
import os, sys
import chromagrip.dataset.make, chromagrip.loop.run_files, chromagrip.measure.sweep.sweep
from chromagrip.__main__ import main

for line in sys.stdin:
    child = os.fork()
    if child == 0:
        sys.argv[1:], sys.stdout = line.split(), sys.stderr
        main()
    print(child, flush=True)
    print(os.waitpid(child, 0)[1], flush=True)
"""


@pytest.fixture(scope="module")
def killing(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Killing]:
    said = tmp_path_factory.mktemp("said") / "stderr"
    with (
        said.open("w") as errors,
        subprocess.Popen(
            [sys.executable, "-P", "-c", FORKS],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            bufsize=1,
            env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        ) as process,
    ):
        assert process.stdin is not None
        assert process.stdout is not None
        to, of = process.stdin, process.stdout

        def kill(line: str, after: float | None = None) -> int:
            to.write(f"{line}\n")
            child = int(of.readline())
            if after is not None:
                time.sleep(after)
                with suppress(ProcessLookupError):
                    os.kill(child, signal.SIGKILL)
            return int(of.readline())

        yield kill
        to.close()
    assert "Traceback" not in said.read_text()


def killed(
    killing: Killing, line: str, place: Path, count: int, seed: int
) -> Iterator[tuple[int, Path]]:
    """Exit codes and outputs of commands that are killed; the first one, `whole`, is not.

    Half of the kills are spread over the whole command, half over its last tenth, where files end.
    """
    begin = time.monotonic()
    assert killing(f"{line} {place / 'whole'}") == 0
    most, random = time.monotonic() - begin, np.random.default_rng(seed)
    late = random.uniform(0.9, 1.05, count // 2)
    for number, share in enumerate([*random.uniform(0.0, 1.05, count - count // 2), *late]):
        out = place / f"killed-{number}"
        yield killing(f"{line} {out}", after=share * most), out


def test_kills_of_a_dataset(tmp_path: Path, killing: Killing, bytes_of: Digests) -> None:
    make = "dataset make tiny --workers 1 --n 2 --json --out"
    for _, out in killed(killing, make, tmp_path, 12, seed=1):
        if (out / MANIFEST).exists():
            assert check(out) == 2
        elif out.exists():
            with pytest.raises(UserError):
                check(out)
        assert killing(f"{make} {out} --resume") == 0
        assert bytes_of(out) == bytes_of(tmp_path / "whole")


def computed(files: dict[str, str]) -> dict[str, str]:
    """Files without those that hold a speed."""
    speeds = ("summary.json", "report.html", "tactile.mp4")
    return {name: digest for name, digest in files.items() if name not in speeds}


@pytest.mark.parametrize("scene", ["camera-100hz", "pinch-lift"])
def test_kills_of_a_grasp(scene: str, tmp_path: Path, killing: Killing, bytes_of: Digests) -> None:
    run = f"grasp --scene {scene} --path truth --set duration_s=0.3 --frames png --out"
    for ended, out in killed(killing, run, tmp_path, 4, seed=2):
        if (out / "summary.json").exists():
            read_run(out)
            assert json.loads((out / "summary.json").read_text())["complete"]
        elif ended and out.exists():
            with pytest.raises(UserError, match="is not a finished run"):
                read_run(out)
        assert killing(f"{run} {out} --overwrite") == 0
        assert computed(bytes_of(out)) == computed(bytes_of(tmp_path / "whole"))


def test_kills_of_a_sweep(tmp_path: Path, killing: Killing, bytes_of: Digests) -> None:
    sweep = "sweep --path truth --set duration_s=0.1 --vary object.friction=0.3,0.4,0.5 --seeds 2"
    run = f"{sweep} --workers 1 --out"
    for _, out in killed(killing, run, tmp_path, 6, seed=3):
        finished = (out / "runs.csv").exists() and not (out / "unfinished.jsonl").exists()
        assert killing(f"{run} {out}" + " --overwrite" * finished) == 0
        assert bytes_of(out)["runs.csv"] == bytes_of(tmp_path / "whole")["runs.csv"]
        assert not list(out.glob("*unfinished*"))
