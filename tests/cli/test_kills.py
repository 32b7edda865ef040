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

#: Starts each command in a fork, so that modules are imported once. `train` is a small training.
FORKS = """
import os, sys
from dataclasses import replace
from pathlib import Path
import numpy as np
from msgspec.structs import replace as changed
import chromagrip.dataset.make, chromagrip.loop.run_files, chromagrip.measure.sweep.sweep
import chromagrip.calibrate.readout as training
from chromagrip.__main__ import main
from chromagrip.tracking import load_calibration

known = load_calibration("thesis")
sparse = changed(known.sensor.layout, count=100, meridian_pitch_mm=1.5)
known = replace(known, sensor=changed(known.sensor, layout=sparse), readout=None)
training.PART, training.BASIS = 5, 25
made = training._basis  # takes longer than all else; the first training keeps it for the others

def train(out):
    kept = Path(out).with_name("basis.npz")

    def basis(*given):
        if not kept.exists():
            training.write_arrays(kept, vars(made(*given)))
        return training.Basis(**training._read(kept))

    training._basis = basis
    training.train(known, 2.0, 20, 3, Path(out), 1, lambda text: None)

for line in sys.stdin:
    words = line.split()
    child = os.fork()
    if child == 0:
        sys.argv[1:], sys.stdout = words, sys.stderr
        if words[0] == "train":
            train(words[1])
            os._exit(0)
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


def timed(run: Callable[[], int]) -> float:
    begin = time.monotonic()
    assert run() == 0
    return time.monotonic() - begin


def delays(most: float, count: int, seed: int) -> list[float]:
    """Times of kills: over the whole command, and as many in its last tenth, where files end."""
    random = np.random.default_rng(seed)
    spread = random.uniform(0.0, 1.05 * most, count - count // 2)
    late = random.uniform(0.9 * most, 1.05 * most, count // 2)
    return [float(delay) for delay in np.concatenate([spread, late])]


def test_fifty_kills_of_a_dataset(tmp_path: Path, killing: Killing, bytes_of: Digests) -> None:
    make = "dataset make tiny --workers 1 --n 2 --json --out"
    spent = timed(lambda: killing(f"{make} {tmp_path / 'whole'}"))
    whole = bytes_of(tmp_path / "whole")
    for number, delay in enumerate(delays(spent, 50, seed=1)):
        out = tmp_path / f"killed-{number}"
        killing(f"{make} {out}", after=delay)
        if (out / MANIFEST).exists():
            assert check(out) == 2
        elif out.exists():
            with pytest.raises(UserError):
                check(out)
        assert killing(f"{make} {out} --resume") == 0
        assert bytes_of(out) == whole


@pytest.mark.parametrize("scene", ["camera-100hz", "pinch-lift"])
def test_ten_kills_of_a_grasp(
    scene: str, tmp_path: Path, killing: Killing, bytes_of: Digests
) -> None:
    run = f"grasp --scene {scene} --path truth --set duration_s=0.3 --frames png --out"
    spent = timed(lambda: killing(f"{run} {tmp_path / 'whole'}"))
    whole = computed(bytes_of(tmp_path / "whole"))
    for number, delay in enumerate(delays(spent, 10, seed=2)):
        out = tmp_path / f"killed-{number}"
        ended = killing(f"{run} {out}", after=delay)
        if (out / "summary.json").exists():
            read_run(out)
            assert json.loads((out / "summary.json").read_text())["complete"]
        elif ended and out.exists():
            with pytest.raises(UserError, match="is not a finished run"):
                read_run(out)
        assert killing(f"{run} {out} --overwrite") == 0
        assert computed(bytes_of(out)) == whole


def computed(files: dict[str, str]) -> dict[str, str]:
    """Files without those that hold a speed."""
    return {
        name: digest
        for name, digest in files.items()
        if name not in ("summary.json", "report.html", "tactile.mp4")
    }


def test_ten_kills_of_a_sweep(tmp_path: Path, killing: Killing, bytes_of: Digests) -> None:
    sweep = "sweep --path truth --set duration_s=0.1 --vary object.friction=0.3,0.4,0.5 --seeds 2"
    run = f"{sweep} --workers 1 --out"
    spent = timed(lambda: killing(f"{run} {tmp_path / 'whole'}"))
    whole = bytes_of(tmp_path / "whole")["runs.csv"]
    for number, delay in enumerate(delays(spent, 10, seed=3)):
        out = tmp_path / f"killed-{number}"
        killing(f"{run} {out}", after=delay)
        finished = (out / "runs.csv").exists() and not (out / "unfinished.jsonl").exists()
        assert killing(f"{run} {out}" + " --overwrite" * finished) == 0
        assert bytes_of(out)["runs.csv"] == whole
        assert not list(out.glob("*unfinished*"))


def test_ten_kills_of_a_training(tmp_path: Path, killing: Killing) -> None:
    killing(f"train {tmp_path / 'first.npz'}")
    spent = timed(lambda: killing(f"train {tmp_path / 'whole.npz'}"))
    whole = dict(np.load(tmp_path / "whole.npz"))
    for number, delay in enumerate(delays(spent, 10, seed=4)):
        out = tmp_path / f"killed-{number}.npz"
        killing(f"train {out}", after=delay)
        if not out.exists() or out.with_name(f"{out.name}.parts").exists():
            assert killing(f"train {out}") == 0
        learned = np.load(out)
        assert all(np.array_equal(learned[name], whole[name]) for name in whole)
