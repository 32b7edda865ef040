"""Command lines, tables and pictures at random: each is done, or refused in one line."""

import inspect
import random
import shlex
from collections.abc import Callable
from functools import cache
from pathlib import Path
from subprocess import CompletedProcess

import cv2
import numpy as np
import pytest

from chromagrip.cli.app import COMMANDS
from chromagrip.loop.run_files import scene_text
from chromagrip.render import load_sensor, open_renderer, rest_membrane
from chromagrip.scene.scene import load_scene

Typed = Callable[..., CompletedProcess[str]]

#: What is typed for anything.
ODD = (
    "nan", "inf", "-inf", "1e308", "-1e308", "1e400", "0", "-1", "-0.0", "1e-320", "9" * 400,
    "", " ", "é", "Γ", "\x1b[31m", "\n", "a=b", "=", "[" * 2000, "{}", "[1,2", "'", '"', "--", "-",
    "None", "true", "../..", "/", ".", "/dev/null", "loop", "loop/x", "a" * 5000, "%s", "$HOME",
    "~", "*", "\u202e", "first:0", "first:99999999999", "camera:999999", "pipe:", "pipe:/dev/null",
    "auto", "nested.toml", "large.toml", "broken.toml", "binary.toml", "bad.png", "text.png",
)  # fmt: skip
#: Commands that judge their folder before they compute; `dataset` has a fuzz of its own.
NAMES = (
    "grasp", "render", "sweep", "detect", "track", "estimate", "calibrate camera",
    "calibrate sensor", "limit", "score", "report", "list readouts",
)  # fmt: skip
#: Values that end a run early, should all others be right.
TAKEN = {"out": "bad.png", "controller": "nowhere:Class", "renderer": "nosuch"}


def prepare(folder: Path) -> None:
    """Files of strangers."""
    (folder / "loop").symlink_to("loop")
    (folder / "nested.toml").write_text("a = " + "[" * 5000 + "]" * 5000, encoding="utf-8")
    (folder / "large.toml").write_text("a = 1\n" + "#" * 11_000_000, encoding="utf-8")
    (folder / "broken.toml").write_text("[object\nradius = ", encoding="utf-8")
    (folder / "binary.toml").write_bytes(bytes(range(256)))
    (folder / "bad.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(99))
    (folder / "text.png").write_text("no picture", encoding="utf-8")


def check(done: CompletedProcess[str]) -> None:
    """Done, or refused in one line."""
    line = shlex.join(done.args)[:300]
    assert done.returncode in (0, 2), (line, done.stderr)
    if done.returncode == 2:
        told = [each for each in done.stderr.splitlines() if "compiling" not in each]
        assert len(told) == 1, (line, done.stderr)
        assert told[0].startswith("chromagrip: "), line
        assert len(told[0]) < 2500, line
        assert told[0].isprintable(), line


def command_line(rng: random.Random) -> list[str]:
    """Command with one to four odd words, mostly values of options that it has."""
    name = rng.choice(NAMES)
    options = inspect.signature(COMMANDS[name]).parameters
    flags = [f"--{each.replace('_', '-')}" for each in options if each not in TAKEN]
    flags = [{"--changes": "--set", "--json-only": "--json"}.get(flag, flag) for flag in flags]
    words = name.split()
    for _ in range(rng.randint(1, 4)):
        if rng.random() < 0.8:
            words.append(rng.choice(flags))
        words.append(rng.choice(ODD))
    return words + [w for key in TAKEN if key in options for w in (f"--{key}", TAKEN[key])]


def fuzz_lines(seeds: range, typed: Typed, folder: Path) -> None:
    prepare(folder)
    for seed in seeds:
        rng = random.Random(seed)
        check(typed(*command_line(rng)))


def test_odd_command_lines(typed: Typed, tmp_path: Path) -> None:
    fuzz_lines(range(60), typed, tmp_path)


@pytest.mark.fuzz
@pytest.mark.parametrize("first", range(60, 660, 60))
def test_more_odd_command_lines(first: int, typed: Typed, tmp_path: Path) -> None:
    fuzz_lines(range(first, first + 60), typed, tmp_path)


def damaged_scene(rng: random.Random) -> str:
    """Text of a shipped scene with values, keys or characters changed."""
    name = rng.choice(("camera-100hz", "dome-1", "pinch-lift", "patchy-1", "worn-1"))
    lines = scene_text(load_scene(name, {}), "").splitlines()
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(lines))
        key, equals, value = lines[at].partition("=")
        odd = rng.choice((
            "nan", "inf", "-inf", "-1", "1e400", "9" * 5000, '"\\u0000"', '""', "[]", "{}", "true",
            "1979-05-27", "[" * 3000, '"' + "a" * 5000 + '"', "0x7fffffffffffffff", "1e-320",
            '"é\\u001b"', "[nan]", "[[[]]]", '"nowhere:Class"', "{a = {b = {}}}", "1" + "0" * 300,
        ))  # fmt: skip
        how = rng.random()
        if equals and how < 0.7:
            lines[at] = f"{key}= {odd}"
        elif how < 0.8:
            lines[at] = f"{key[:-2]}{odd}{equals}{value}"
        elif how < 0.9:
            lines.insert(at, lines[rng.randrange(len(lines))])
        else:
            del lines[at]
    return "\n".join(lines)


def fuzz_scenes(seeds: range, typed: Typed, folder: Path) -> None:
    for seed in seeds:
        rng = random.Random(seed)
        path = folder / f"{seed}.toml"
        path.write_text(damaged_scene(rng), encoding="utf-8")
        check(typed("grasp", "--scene", path, "--renderer", "nosuch", "--json"))


def test_odd_scenes(typed: Typed, tmp_path: Path) -> None:
    fuzz_scenes(range(40), typed, tmp_path)


@pytest.mark.fuzz
@pytest.mark.parametrize("first", range(40, 340, 60))
def test_more_odd_scenes(first: int, typed: Typed, tmp_path: Path) -> None:
    fuzz_scenes(range(first, first + 60), typed, tmp_path)


@cache
def at_rest() -> bytes:
    sensor = load_sensor("flat-2019")
    image = open_renderer("painter", sensor).render(rest_membrane(sensor))
    return cv2.imencode(".jpg", image[..., ::-1])[1].tobytes()


def fuzz_pictures(seeds: range, typed: Typed, folder: Path) -> None:
    for seed in seeds:
        rng = np.random.default_rng(seed)
        data = bytearray(at_rest())
        for at in rng.integers(0, len(data), rng.integers(1, 9)):
            data[at] = rng.integers(0, 256)
        path = folder / f"{seed}.jpg"
        path.write_bytes(data[: int(rng.integers(1, len(data)))] if seed % 2 else data)
        check(typed("detect", path, "--json"))


def test_odd_pictures(typed: Typed, tmp_path: Path) -> None:
    fuzz_pictures(range(8), typed, tmp_path)


@pytest.mark.fuzz
@pytest.mark.parametrize("first", range(8, 128, 20))
def test_more_odd_pictures(first: int, typed: Typed, tmp_path: Path) -> None:
    fuzz_pictures(range(first, first + 20), typed, tmp_path)
