"""Command lines at random: each is done, or refused in one line."""

import inspect
import random
from pathlib import Path

from chromagrip.cli.app import COMMANDS

from .judged import Judge, few_and_many

#: What is typed for anything.
ODD = (
    "nan", "inf", "-inf", "1e308", "-1e308", "1e400", "0", "-1", "-0.0", "1e-320", "9" * 400,
    "", " ", "é", "Γ", "\x1b[31m", "\n", "a=b", "=", "[" * 2000, "{}", "[1,2", "'", '"', "--", "-",
    "None", "true", "../..", "/", ".", "/dev/null", "loop", "loop/x", "a" * 5000, "%s", "$HOME",
    "~", "*", "\u202e", "first:0", "first:99999999999", "camera:999999", "pipe:", "pipe:/dev/null",
    "auto", "\x9b31m", "a\rb", "\u2028", "c \udcc3\udca9", "nested.toml", "large.toml",
    "broken.toml", "binary.toml", "bad.png", "text.png",
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


@few_and_many(30, 600)
def test_odd_command_lines(judged: Judge, count: int) -> None:
    prepare(judged.place)
    for seed in range(count):
        line = command_line(random.Random(seed))
        judged.command(*line, makes=("runs",), leaves=line[0] == "render")
