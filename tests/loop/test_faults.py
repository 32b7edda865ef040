"""What fails in a grasp: one sentence, the trace until then, the last safe grip held."""

import csv
import json
import math
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

import pyarrow.parquet as pq
import pytest

from chromagrip import UserError, load_scene, run
from chromagrip.control import GripCommand, GripObservation, SafetyMarginControl
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


@pytest.mark.parametrize(
    ("controller", "words"),
    [
        (Silent(), "did not answer within 0.8 s at t = 0.05 s, sample 5; the"),
        (
            Raises(),
            "failed at t = 0.05 s, sample 5: OSError: the line is down .*test_faults.py, .*",
        ),
    ],
)
def test_the_grip_stays_where_a_controller_fails(
    controller: Silent, words: str, tmp_path: Path
) -> None:
    scene, name = load_scene("camera-100hz", QUICK), type(controller).__name__
    out = tmp_path if name == "Silent" else None
    begin = time.monotonic()
    with pytest.raises(UserError, match=rf":{name} {words} grip stays at 1\.04 N$") as caught:
        run(scene, out, controller=controller, answer_within_s=0.8)
    assert time.monotonic() - begin < 15.0
    assert isinstance(caught.value.__cause__, OSError) == (name == "Raises")
    if out is not None:  # the trace until then is kept
        assert not json.loads((out / "summary.json").read_text())["complete"]
        times = pq.read_table(out / "trace.parquet")["time_s"].to_pylist()
        assert times == pytest.approx([0.01 * k for k in range(6)])


def test_a_limit_changes_no_answer() -> None:
    scene = load_scene("camera-100hz", QUICK)
    controller = SafetyMarginControl(scene.safety_margin)
    free, limited = (
        run(scene, controller=controller, answer_within_s=limit).trace["grip_n"].tobytes()
        for limit in (math.inf, 5.0)
    )
    assert free == limited
    for limit in (math.nan, -1.0):
        with pytest.raises(UserError, match=r"answer_within_s = .* must be above 0; inf is no lim"):
            run(scene, answer_within_s=limit)


def test_what_was_late_once_is_not_asked_again() -> None:
    limit, done = TimeLimit(0.05), threading.Event()
    assert limit.call(divmod, 7, 3) == (2, 1)
    with pytest.raises(ZeroDivisionError):
        limit.call(divmod, 7, 0)
    for call in ((done.wait, 10.0), (divmod, 7, 3)):  # whose answer would be that of the first
        with pytest.raises(NoAnswerError):
            limit.call(*call)
    done.set()


#: A run that is killed without warning after eight frames.
KILLED = """
import os, signal
from chromagrip import load_scene, run

def kill(done, _):
    if done == 8:
        os.kill(os.getpid(), signal.SIGKILL)

changes = {"path": "truth", "controller": "conservative", "conservative.force_n": 2.0}
run(load_scene("SCENE", changes), "run", frames="png", progress=kill)
"""


@pytest.mark.loops
@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
@pytest.mark.parametrize("scene", ["camera-100hz", "pinch-lift"])
def test_a_run_that_is_killed_leaves_its_trace(scene: str, tmp_path: Path) -> None:
    """The next run says so, and may overwrite it."""
    script = KILLED.replace("SCENE", scene)
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, check=False)
    assert done.returncode == -signal.SIGKILL
    folder, period = tmp_path / "run", load_scene(scene).period
    with (folder / ".parts/trace.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if None not in row.values()]
    assert [float(row["time_s"]) for row in rows] == pytest.approx([period * k for k in range(8)])
    assert float(rows[-1]["grip_n"]) == 2.0
    listed = list((folder / ".parts/frames").rglob("frames.csv"))
    assert len(listed) == (2 if scene == "pinch-lift" else 1)
    for path in listed:
        assert len(list(path.parent.glob("frame-*.png"))) >= 7
    # Nothing looks whole.
    assert {path.name for path in folder.iterdir()} == {"scene.toml", ".parts", ".lock"}
    quick = load_scene("camera-100hz", QUICK)
    words = "holds a run that was killed; its trace until then is .*trace.csv; choose another"
    with pytest.raises(UserError, match=words):
        run(quick, folder)
    run(quick, folder, overwrite=True)
    assert not (folder / ".parts").exists()
