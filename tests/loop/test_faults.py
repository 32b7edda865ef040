"""What fails in a grasp: one sentence, the trace until then, the last safe grip held."""

import csv
import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess
from types import ModuleType

import pyarrow.parquet as pq
import pytest

from chromagrip import UserError, load_scene, run
from chromagrip.control import GripCommand, GripObservation
from chromagrip.output.time_limit import NoAnswerError, TimeLimit

QUICK = {"path": "truth", "duration_s": 0.2}
Typed = Callable[..., CompletedProcess[str]]


class Silent:
    """Commands more and more, and never answers a sample after 0.05 s."""

    def reset(self) -> None:
        self.ask = threading.Event()

    def command(self, observation: GripObservation) -> GripCommand:
        if observation.time > 0.045:
            self.ask.wait(20.0)
        return GripCommand(force=1.0 + observation.time)


class Raises(Silent):
    """The same, but raises there."""

    def command(self, observation: GripObservation) -> GripCommand:
        if observation.time > 0.045:
            raise OSError("the line is down")
        return super().command(observation)


def kept(folder: Path) -> tuple[int, bool]:
    """Rows of the trace, and whether the run was complete."""
    summary = json.loads((folder / "summary.json").read_text())
    return len(pq.read_table(folder / "trace.parquet")), summary["complete"]


def test_a_controller_that_never_answers_is_left_behind(tmp_path: Path) -> None:
    scene = load_scene("camera-100hz", QUICK)
    words = (
        r"^controller .*test_faults:Silent did not answer within 0\.2 s at t = 0\.05 s, sample 5; "
        r"the grip stays at 1\.04 N$"
    )
    begin = time.monotonic()
    with pytest.raises(UserError, match=words):
        run(scene, tmp_path, controller=Silent(), answer_within_s=0.2)
    assert time.monotonic() - begin < 15.0
    assert kept(tmp_path) == (6, False)


def test_the_grip_that_stays_is_named(tmp_path: Path) -> None:
    scene = load_scene("camera-100hz", QUICK)
    words = r"Raises failed at t = 0\.05 s, sample 5: OSError: the line is down \(.*\); the grip "
    with pytest.raises(UserError, match=words + r"stays at 1\.04 N$") as caught:
        run(scene, tmp_path, controller=Raises())
    assert "test_faults.py, line" in str(caught.value)  # also from another thread
    assert isinstance(caught.value.__cause__, OSError)
    assert kept(tmp_path) == (6, False)


def test_a_limit_changes_no_answer() -> None:
    class Proportional(Silent):
        def command(self, observation: GripObservation) -> GripCommand:
            return GripCommand(force=0.5 + 3.0 * observation.field.total_friction)

    scene = load_scene("camera-100hz", QUICK)
    free, limited = (
        run(scene, controller=Proportional(), answer_within_s=limit).trace["grip_n"].tobytes()
        for limit in (math.inf, 5.0)
    )
    assert free == limited
    with pytest.raises(UserError, match="answer_within_s = nan must be above 0"):
        run(scene, answer_within_s=math.nan)


def test_what_was_late_once_is_not_asked_again() -> None:
    limit, done = TimeLimit(0.05), threading.Event()
    assert limit.call(divmod, 7, 3) == (2, 1)
    with pytest.raises(ZeroDivisionError):
        limit.call(divmod, 7, 0)
    with pytest.raises(NoAnswerError):
        limit.call(done.wait, 10.0)
    with pytest.raises(NoAnswerError):
        limit.call(divmod, 7, 3)  # whose answer would be taken for the one before
    done.set()


def test_the_command_line_has_the_limit(typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("silent")
    module.__dict__["Silent"] = Silent
    monkeypatch.setitem(sys.modules, "silent", module)
    line = ["grasp", "--path", "truth", "--controller", "silent:Silent", "--json"]
    done = typed(*line, "--answer-within", "0.2")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("chromagrip: controller silent:Silent did not answer within 0.2")
    assert done.stderr.count("\n") == 1
    done = typed(*line, "--answer-within", "0")
    assert "--answer-within 0.0: expected more than 0" in done.stderr


SLOW = """
import time
from chromagrip.control import GripCommand

class Slow:
    def reset(self): pass
    def command(self, observation):
        time.sleep(0.02)
        return GripCommand(force=2.0)
"""


@pytest.fixture(scope="module", params=["camera-100hz", "pinch-lift"])
def killed(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where a run was killed without warning after some frames, of one finger and of two."""
    folder = tmp_path_factory.mktemp("killed")
    (folder / "slow.py").write_text(SLOW, encoding="utf-8")
    words = ["grasp", "--scene", request.param, "--path", "truth", "--controller", "slow:Slow"]
    words += ["--frames", "png", "--set", "duration_s=600", "--set", "camera.rate_hz=100"]
    process = subprocess.Popen(
        [sys.executable, "-m", "chromagrip", *words, "--out", "run"],
        cwd=folder,
        stderr=subprocess.DEVNULL,
    )
    lines = folder / "run/.parts/trace.csv"
    try:
        for _ in range(1200):
            if lines.exists() and lines.read_text().count("\n") > 5:
                break
            time.sleep(0.05)
        else:
            raise AssertionError("no frame within a minute")
    finally:
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    return folder


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_a_run_that_is_killed_leaves_its_trace(killed: Path) -> None:
    parts = killed / "run/.parts"
    with (parts / "trace.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if None not in row.values()]
    assert [float(row["time_s"]) for row in rows] == [0.01 * k for k in range(len(rows))]
    assert float(rows[-1]["grip_n"]) == 2.0
    listed = list((parts / "frames").rglob("frames.csv"))
    assert len(listed) == (2 if "first_mu_true" in rows[0] else 1)
    for path in listed:
        assert len(list(path.parent.glob("frame-*.png"))) >= len(rows) - 1
    names = {path.name for path in (killed / "run").iterdir()}
    assert names == {"scene.toml", ".parts", ".lock"}  # nothing that looks whole


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_the_next_run_says_so(killed: Path) -> None:
    scene = load_scene("camera-100hz", QUICK)
    words = "holds a run that was killed; its trace until then is .*trace.csv; choose another"
    with pytest.raises(UserError, match=words):
        run(scene, killed / "run")
    run(scene, killed / "run", overwrite=True)
    assert not (killed / "run/.parts").exists()
    assert kept(killed / "run") == (21, True)
