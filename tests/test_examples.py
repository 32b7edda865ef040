"""Examples run as they are, headless, and assert what they show."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
#: Examples with a test of their own: two that work together, one that needs ROS 2, and one of
#: several processes.
APART = ("learn_to_grip", "compare_policy", "ros2_node", "three_processes")
EXAMPLES = sorted(p for p in (ROOT / "examples").glob("*.py") if p.stem not in APART)


pytestmark = pytest.mark.loops


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for stem, module in (("train_margin", "sklearn"), ("mujoco_gripper", "mujoco")):
        if path.stem == stem:
            pytest.importorskip(module, reason="needs an extra")
    monkeypatch.chdir(tmp_path)  # where pictures go
    monkeypatch.setattr(sys, "argv", [str(path)])
    runpy.run_path(str(path), run_name="__main__")
    assert capsys.readouterr().out
    assert len(path.read_text(encoding="utf-8").splitlines()) < 80


def test_three_processes_hold_the_margin_and_grip_on_while_the_reader_is_dead() -> None:
    path = str(ROOT / "examples/three_processes.py")
    words = [sys.executable, path, "24", "0.5"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    held = re.search(r"before the kill: .* in (\d+)% of", done.stdout)
    after = re.search(r"after the kill: .* smallest (\S+),", done.stdout)
    assert held is not None
    assert after is not None
    assert int(held[1]) >= 80, done.stdout
    assert float(after[1]) >= 0.2, done.stdout  # it is never dropped


def test_a_gripper_of_mujoco_lifts_a_box_at_the_desired_margin(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("mujoco", reason="needs the extra mujoco")
    monkeypatch.chdir(tmp_path)
    left = runpy.run_path(str(ROOT / "examples/mujoco_gripper.py"))
    assert left["height"] == pytest.approx(0.05, abs=0.004)
    grip, read, *true = left["margins"][-1]
    assert read == pytest.approx(0.3, abs=0.05)
    assert true == pytest.approx([0.3, 0.3], abs=0.08)
    assert grip < 1.5
    assert (tmp_path / "gripper.mp4").stat().st_size > 20_000


def test_policy_from_markers(tmp_path: Path) -> None:
    """A short training already holds objects that it never saw, and not by a firm grip."""

    def run(name: str, *arguments: str) -> str:
        command = [sys.executable, str(ROOT / f"examples/{name}.py"), *arguments]
        return subprocess.run(
            command, cwd=tmp_path, check=True, text=True, stdout=subprocess.PIPE
        ).stdout

    assert "policy.npz: learnt in" in run("learn_to_grip", "8")
    table = run("compare_policy", "policy.npz", "1", "13").split("\n\n")[0]  # of three objects
    cells = {line.split(" | ")[0][2:]: line.split(" | ")[1:] for line in table.splitlines()}
    # A policy that has learnt nothing grips with 1 N and drops two of the three.
    assert int(cells["policy"][1].split()[0]) <= 1
    errors = [float(cells[name][3].split()[0]) for name in ("policy", "conservative")]
    assert errors[0] < errors[1]
