"""Every command's help, and what a wrong command line says."""

import io
import json
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks.__main__ import load
from chromagrip.cli.app import COMMANDS, OF_CHECKOUT, STUDIES
from chromagrip.measure.study import studies

Typed = Callable[..., subprocess.CompletedProcess[str]]


@pytest.mark.parametrize("name", ["score", "dataset make", "doctor"])
def test_a_help_has_an_example_of_its_own_command(name: str, typed: Typed) -> None:
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


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("grap", "no command 'grap' (did you mean grasp?); there is score, "),
        ("train thesis", "`chromagrip train` is `chromagrip calibrate readout` now"),
        ("grasp --sceen thesis", "no option --sceen (did you mean --scene?)"),
        ("track --rest a.png --source b", "no option --rest: its value is a word without an opt"),
        ("grasp --controller a --controller b", "--controller is given 2 times; give it once; `sw"),
        ("grasp thesis --duration 0.2", "no option --duration (did you mean --set duration_s=…?)"),
        ("grasp thesis margin-60hz", "one word too many: margin-60hz after thesis"),
        ("track dots.mp4", "missing: SOURCE in `chromagrip track REST SOURCE`; REST is the unload"),
        ("estimate a b --calibration thesys", "no calibration 'thesys' (did you mean thesis?); "),
        ("grasp --controller my_pi.PI", "no controller 'my_pi.PI' (did you mean my_pi:PI?); the"),
        ("report", "no run is given: give one to six folders that `chromagrip grasp` made, such"),
        ("sweep", "nothing is varied: give --vary, --arg, --controller or a scene, such as `chrom"),
        ("stability model", "(in a checkout it is `./run bench stability-model`): there is "),
        (
            "grasp --overwrite",
            "--overwrite is for the folder of --out: give --out, or leave it out",
        ),
        (f"render --object {__file__} --press-mm 1", "no mesh file ends in '.py'; formats are "),
        ("--versoin", "no option --versoin (did you mean --version?)"),
        ("grasp thesis --set seed 3", "--set seed 3: expected key=value, as seed=3"),
        ("sweep --vary seed=1,2 --set seed=4", "seed is both varied and set; give it once"),
        ("grasp --out=", "the value of --out is empty: give a value in `chromagrip grasp --out=`"),
        ("render --object ball --tilt-deg 200 0", "--tilt-deg 200: expected -90 to 90 about each "),
        ("plan --tolerance 5%", "expected a number without %, such as 0.05 for 5 %"),
        ("grasp thesis --scene thesis", "a scene is given twice: thesis and --scene thesis"),
        ("dataset make", "missing: RECIPE|FILE.toml, --out DIR|URL; see `chromagrip dataset make "),
        ("grasp --arg gain --json", "--arg gain: expected name=value"),
        pytest.param(
            "limit --grip 300",
            "markers do not determine forces at this grip and load",
            marks=pytest.mark.loops,
        ),
        ("grasp --set object.sharpness=3", "key object.sharpness (did you mean object.shape?); al"),
        ("grasp --scene banana", "no scene 'banana'; there is camera-100hz, "),
        ("grasp --controller nowhere:C", "controller 'nowhere:C': there is no module nowhere"),
        ("grasp --out /proc/chromagrip", "folder /proc/chromagrip cannot be written"),
        ("detect 0.png --value-range 5,5", "--value-range 5,5: expected BLACK,WHITE, such as"),
        ("live pinch-lift", "the live page shows one finger; this scene is a pinch of two"),
    ],
)
def test_a_wrong_command_line_is_one_sentence(line: str, words: str, typed: Typed) -> None:
    done = typed(*shlex.split(line))
    assert done.returncode == 2
    assert words in done.stderr
    assert done.stderr.startswith("chromagrip: ")
    told = [line for line in done.stderr.splitlines() if "compiling" not in line]
    assert len(told) == 1
    assert done.stdout == ""


PI = """from chromagrip.control import GripCommand
class PI:
    def __init__(self, gain=1.0, desired_margin=0.3):
        pass
    def reset(self):
        pass
    def command(self, observation):
        return GripCommand(force=2.0)
"""


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("grasp --controller blobs.py", "no controller 'blobs.py' (did you mean blobs:Class?); "),
        ("grasp --controller blobs:PI --arg gian=2", "gian (did you mean gain?); it has gain, des"),
        ("grasp --controller blobs:PI --arg desired_margin=1.5", "1.5: expected 0 or more and bel"),
        ("grasp empty.toml", "scene file empty.toml has no keys: give at least one, such as dura"),
        ("limit --sensor empty.toml", "empty.toml: the key description is missing"),
        pytest.param("render --object ball --press-mm 200", "a press of 200 mm: expected less than",
                     marks=pytest.mark.loops),
        pytest.param("render --object ball --force 0 0 900", "and 900 N down: expected less than",
                     marks=pytest.mark.loops),
    ],
)  # fmt: skip
def test_what_is_known_once_a_file_or_a_press_has_been_looked_at_is_refused(
    line: str, words: str, typed: Typed, tmp_path: Path
) -> None:
    """In the last line: tables may be solved before, and say so."""
    (tmp_path / "blobs.py").write_text(PI, encoding="utf-8")
    (tmp_path / "empty.toml").touch()
    done = typed(*line.split())
    assert (done.returncode, done.stdout) == (2, "")
    assert words in done.stderr.splitlines()[-1]
    left = {path.name for path in tmp_path.iterdir()} - {"__pycache__"}
    assert left == {"blobs.py", "empty.toml"}


def test_what_a_checkout_measures_is_known() -> None:
    load()
    assert sorted(studies("project")) == sorted(OF_CHECKOUT)


@pytest.mark.parametrize("name", ["scenes", "trackers"])
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
    assert b"smallest errors of ?Fn" in screen.buffer.getvalue()
    assert done.stderr == ""
