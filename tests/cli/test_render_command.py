"""`chromagrip render` as it is typed: what it says, and how its pictures are taken again."""

import json
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import pytest

from chromagrip.cli import readouts
from chromagrip.cli.options import counting, status
from chromagrip.tracking import sensor_as_designed

Typed = Callable[..., CompletedProcess[str]]
#: A coarse and thin dome, so that a command takes a second.
COARSE = ("--set", "dome.pitch_mm=0.8", "--noise", "1", "--seed", "3")


def _poses(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "poses.json").read_text(encoding="utf-8")))


@pytest.mark.loops
def test_a_folder_is_repeated_by_the_command_that_it_names(
    tmp_path: Path, typed: Typed, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    pose = shlex.split("--object ball --press-mm 0.1 0.2 --twist-deg -5 --shear-mm .05")
    done = typed("render", *COARSE, *pose, "--out", first)
    assert done.returncode == 0, done.stderr
    # Nothing pulls along y: what the solver leaves of it is not said.
    assert not re.search(r"\de-\d", done.stdout)
    told = _poses(first)
    assert told["poses"][0]["torque_nmm"][:2] != [0.0, 0.0]
    assert told["again"] in (first / "scene.toml").read_text(encoding="utf-8")
    monkeypatch.chdir(first)
    done = typed(*shlex.split(told["again"])[1:], "--out", second)
    assert done.returncode == 0, done.stderr
    assert _poses(second) == told
    for name in ("image-000.png", "image-001.png", "truth-001.npz", "rest.png", "scene.toml"):
        assert (first / name).read_bytes() == (second / name).read_bytes(), name


@pytest.mark.loops
def test_a_pure_press_has_no_friction_of_the_solver(tmp_path: Path, typed: Typed) -> None:
    done = typed(
        "render", *COARSE, "--object", "ball", "--press-mm", "0.3", "--out", tmp_path / "o"
    )
    assert "friction_n 0," in done.stdout
    entry = _poses(tmp_path / "o")["poses"][0]
    assert entry["force_n"][:2] == [0.0, 0.0]
    assert entry["torque_nmm"] == [0.0, 0.0, 0.0]
    assert entry["friction_n"] == 0.0
    assert (entry["margin"], entry["limit_margin"]) == (1.0, 1.0)


@pytest.mark.loops
def test_a_press_beyond_what_was_compared_is_said(tmp_path: Path, typed: Typed) -> None:
    hard = (*COARSE, "--object", "ball", "--set", "object.stiffness_kpa=20000")
    done = typed("render", *hard, "--press-mm", "0.4", "--out", tmp_path / "shallow")
    assert "finite elements" not in done.stderr
    entry = _poses(tmp_path / "shallow")["poses"][0]
    assert entry["deepest_mm"] == pytest.approx(0.4, rel=0.1)
    done = typed("render", *hard, "--press-mm", "1.15", "--out", tmp_path / "deep")
    assert "of the silicone's thickness; markers and forces" in done.stderr


def test_long_work_is_told_in_lines_where_there_is_no_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = 0.0
    monkeypatch.setattr("chromagrip.cli.options.time.monotonic", lambda: now)
    with counting("rendering", "poses") as move, status() as report:
        for now in (9.0, 11.0, 15.0, 20.0, 22.0):
            move(int(now), 80)
            report(f"round {now:g}")
    assert capsys.readouterr().err.splitlines() == [
        "chromagrip: rendering: 11 of 80 poses",
        "chromagrip: round 11",
        "chromagrip: rendering: 22 of 80 poses",
        "chromagrip: round 22",
    ]


def test_tables_of_a_dome_are_solved_before_its_pictures_are_read(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    solved: list[tuple[object, tuple[float, ...]]] = []
    trained: list[str] = []
    monkeypatch.setattr(readouts, "_solve", lambda dome, depths: solved.append((dome, depths)))
    monkeypatch.setattr(readouts, "train_if_missing", lambda known, name: trained.append(name))
    known = sensor_as_designed("dome-2022")
    readouts.prepare(known, "auto")
    assert [dome for dome, _ in solved] == [known.sensor.dome]
    assert solved[0][1][0] == pytest.approx(1e-3)  # the magenta layer
    readouts.prepare(sensor_as_designed("thesis"), "auto")
    readouts.prepare(known, "sequential")
    assert len(solved) == 1
    assert trained == ["auto", "sequential"]
