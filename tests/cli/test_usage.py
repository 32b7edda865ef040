"""Every command's help, and what a wrong command line says."""

import io
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from itertools import chain
from pathlib import Path

import pytest

from chromagrip.cli.app import COMMANDS, STUDIES, commands_of

Typed = Callable[..., subprocess.CompletedProcess[str]]
LISTS = [
    "scenes",
    "sensors",
    "palettes",
    "controllers",
    "renderers",
    "trackers",
    "reconstructors",
    "integrators",
    "recipes",
    "readouts",
]


@pytest.mark.parametrize("name", [*COMMANDS, *chain(*map(commands_of, STUDIES))])
def test_every_help_has_an_example_of_its_own_command(name: str, typed: Typed) -> None:
    done = typed(*name.split(), "--help")
    assert done.returncode == 0
    assert f"usage: chromagrip {name} " in done.stdout
    assert f"Example: chromagrip {name}" in done.stdout


def test_no_word_is_the_front_page_and_no_success(typed: Typed) -> None:
    alone, helped = typed(), typed("--help")
    assert (alone.returncode, helped.returncode) == (2, 0)
    assert alone.stdout == helped.stdout
    lines = [line for line in alone.stdout.splitlines() if " chromagrip " in line[:40]]
    assert len(lines) <= 19
    assert max(map(len, alone.stdout.splitlines())) <= 100
    jobs = [line.split(" chromagrip ") for line in lines[:3]]
    assert [(job.strip(), words.split()[0]) for job, words in jobs] == [
        ("test a tracker", "score"),
        ("make training data", "dataset"),
        ("validate a controller", "grasp"),
    ]


def test_a_number_may_begin_with_its_point(typed: Typed) -> None:
    words = ["grasp", "margin-60hz", "--path", "truth", "--set", "duration_s=.05", "--json"]
    assert json.loads(typed(*words, "--set", "object.friction=.4").stdout)["complete"]


def test_the_help_lists_every_command_and_names_shell_completion(typed: Typed) -> None:
    text = typed("--help").stdout
    assert all(f" {name.split()[0]} " in text for name in (*COMMANDS, *STUDIES))
    assert "--tyro-write-completion bash FILE" in text
    members = [name.split()[1] for name in COMMANDS if name.startswith("dataset ")]
    for words in (["dataset"], ["dataset", "--help"]):
        done = typed(*words)
        assert done.returncode == 0
        assert all(f"• {name}" in done.stdout for name in members)


def test_completion_knows_commands_of_two_words(typed: Typed) -> None:
    script = typed("--tyro-print-completion", "bash").stdout
    assert "dataset" in script
    assert "export" in script


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("squeeze", "no command 'squeeze'; there is score, dataset, grasp, "),
        ("grap", "no command 'grap' (did you mean grasp?); there is score, "),
        ("trackers", "`chromagrip trackers` is `chromagrip list trackers` now"),
        ("train thesis", "`chromagrip train` is `chromagrip calibrate readout` now"),
        ("list scene", "list scene (did you mean scenes?): there is scenes, sensors, "),
        ("grasp --sceen thesis", "unrecognized options: --sceen, thesis (did you mean --scene?)"),
        ("grasp margin60hz", "no scene 'margin60hz' (did you mean margin-60hz?); there is "),
        ("grasp thesis --scene thesis", "a scene is given twice: thesis and --scene thesis"),
        ("grasp --controller a --controller b", "--controller is given 2 times; give it once; `sw"),
        ("grasp --set object.mass_g=3", "unknown key object.mass_g (did you mean pinch.mass_g?)"),
        (
            "grasp --set object.fricton=3",
            "unknown key object.fricton (did you mean object.friction",
        ),
        ("grasp --set object.friction=soft", "expected a number, got text, such as 0.5"),
        ("grasp --set load.forces_n=3", "expected a list, got a whole number, such as [0.2, 0.5]"),
        ("grasp --controller nowhere:C", "ModuleNotFoundError: No module named 'nowhere'\n"),
        ("dataset dance", "dataset dance: there is make, check, "),
        ("grasp --grip 3", "unrecognized options: --grip, 3"),
        ("grasp --fps fast", "--fps 'fast': expected a number"),
        ("grasp --path mirror", "path 'mirror': allowed are camera, truth"),
        ("grasp --scene", "'--scene'"),
        ("bench banana", "bench banana: there is control, force, loop, "),
        ("bench --quick", "bench --quick: there is control, force, loop, "),
        ("stability track --controller mine:C", "unrecognized options: --controller, mine:C"),
        ("bench loop --world moon", "world 'moon': allowed are dome"),
        ("bench track --tracker fit(gain=2)", "expected module:Class(name=value), such as"),
        (
            "dataset make",
            "missing: RECIPE|FILE.toml, --out DIR|URL; see `chromagrip dataset make --help`",
        ),
        ("grasp --latency 1.5", "--latency '1.5': expected a whole number"),
        ("grasp --arg gain --json", "--arg gain: expected name=value"),
        pytest.param(
            "limit --grip 300",
            "markers do not determine forces at this grip and load",
            marks=pytest.mark.slow,
        ),
        ("live pinch-lift", "the live page shows one finger; this scene is a pinch of two"),
        (
            "grasp --scene pinch-lift --source camera:0 --json",
            "--source is for one finger; this scene is a pinch of two",
        ),
    ],
)
def test_a_wrong_command_line_is_one_sentence(line: str, words: str, typed: Typed) -> None:
    done = typed(*line.split())
    assert done.returncode == 2
    assert words in done.stderr
    assert done.stderr.startswith("chromagrip: ")
    assert len(done.stderr.splitlines()) == 1
    assert done.stdout == ""


@pytest.mark.parametrize("name", LISTS)
def test_lists_are_the_same_in_json(name: str, typed: Typed) -> None:
    lines = typed("list", name).stdout.splitlines()
    entries = json.loads(typed("list", name, "--json").stdout)
    assert [line.split()[0] for line in lines] == list(entries)
    assert all(line.endswith(text) for line, text in zip(lines, entries.values(), strict=True))


@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
def test_a_screen_without_greek_letters_shows_something_else(
    encoding: str, typed: Typed, monkeypatch: pytest.MonkeyPatch
) -> None:
    screen = io.TextIOWrapper(io.BytesIO(), encoding)
    monkeypatch.setattr(sys, "stdout", screen)
    done = typed("limit", "--help")
    assert done.returncode == 0
    screen.flush()
    assert b"Smallest errors of ?Fn" in screen.buffer.getvalue()
    assert done.stderr == ""


TELLING = """
from pathlib import Path
from chromagrip.control import GripCommand

class Telling:
    def reset(self): self.told = 0
    def command(self, seen):
        self.told += 1
        if self.told == 3:  # one frame is kept by then
            Path("begun").touch()
        return GripCommand(force=1.0)
"""


def test_a_terminated_run_keeps_its_results_and_says_so(tmp_path: Path) -> None:
    """Terminated once its controller has left a sign that the run has begun."""
    (tmp_path / "telling.py").write_text(TELLING, encoding="utf-8")
    words = ["grasp", "--path", "truth", "--set", "duration_s=600", "--out", "cut"]
    process = subprocess.Popen(
        [sys.executable, "-m", "chromagrip", *words, "--controller", "telling:Telling"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
    )
    deadline = time.monotonic() + 300.0
    while not (tmp_path / "begun").exists():
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.02)
    process.send_signal(signal.SIGTERM)
    _, stderr = process.communicate(timeout=300.0)
    assert process.returncode == 143
    assert "chromagrip: terminated" in stderr
    assert json.loads((tmp_path / "cut" / "summary.json").read_text())["complete"] is False
