"""Every way in which a command ends, without a traceback."""

import errno
import io
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from chromagrip.__main__ import main as start
from chromagrip.cli.ending import finish
from chromagrip.errors import UserError, one_line

Typed = Callable[..., subprocess.CompletedProcess[str]]


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (UserError("no"), 2, "no"),
        (MemoryError("Unable to allocate 8 TiB"), 2, "more memory than there is: Unable"),
        (RecursionError(), 2, "nested too deeply"),
        (OSError(errno.ELOOP, "Too many levels of symbolic links", "a"), 2, "a: Too many levels"),
        (OSError(errno.ENOSPC, "No space left on device"), 2, "output: No space left"),
        (UnicodeEncodeError("ascii", "é", 0, 1, "no"), 2, "as ascii"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (KeyboardInterrupt(signal.SIGTERM), 143, "terminated"),
        (BrokenPipeError(), 141, ""),
    ],
)
def test_each_kind_of_error_is_one_line(
    error: BaseException, code: int, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def work() -> int:
        raise error

    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(SystemExit) as ended:
        finish(work)
    signal.signal(signal.SIGINT, before)
    told = capsys.readouterr().err
    assert ended.value.code == code
    assert words in told
    assert len(told.splitlines()) == bool(words)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux")
@pytest.mark.parametrize("words", ["--help", "list sensors --json"])
def test_a_full_output_is_one_line(
    words: str, typed: Typed, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open("/dev/full", "w", encoding="utf-8") as full:
        copy = os.fdopen(os.dup(full.fileno()), "w", encoding="utf-8")
        monkeypatch.setattr(sys, "stdout", copy)
        done = typed(*words.split(), start=start)
        monkeypatch.undo()
        copy.close()
    assert done.returncode == 2
    assert done.stderr == "chromagrip: input or output: No space left on device\n"


def test_streams_that_are_closed(typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
    """An output that does not exist, and a reader of errors that has left."""
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", None)
        assert typed("list", "sensors").returncode == 0
    read, write = os.pipe()
    os.close(read)
    stream = io.TextIOWrapper(io.FileIO(write, "w"), write_through=True)
    monkeypatch.setattr(sys, "stderr", stream)
    assert typed("nosuch").returncode == 2


@pytest.mark.fuzz
@pytest.mark.parametrize("after_s", [0.12, 0.25, 0.45])
def test_ctrl_c_while_modules_are_loaded(after_s: float) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "chromagrip", "grasp", "--set", "duration_s=900", "--json"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    time.sleep(after_s)
    process.send_signal(signal.SIGINT)
    told = process.communicate(timeout=60.0)[1]
    if "runpy" not in told:  # Python itself was still starting
        assert process.returncode == 130
        assert told in ("", "chromagrip: interrupted\n")


def test_a_message_is_shortened_once() -> None:
    for text in ("a" * 9999, "ab 'c d' " * 999, "\0\x1b", "it's 'short', isn't it? " * 20):
        assert one_line(one_line(text)) == one_line(text)
    kept = "the sensor's markers are " + "far apart " * 40 + "on this finger's dome"
    assert one_line(kept) == kept


@pytest.mark.parametrize(
    "words",
    [
        "render --grip 1000", "render --sensor flat-2019 --press-mm 1e9",
        "render --object ball --shear-mm 1e9", "render --set object.radius_mm=1e308",
        "track a.png a.png", "sweep --scene nowhere --path truth", "grasp --controller nowhere:C",
    ],
)  # fmt: skip
def test_what_is_refused_leaves_nothing(words: str, typed: Typed, tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"none")
    for out in (["--out", "deep/out"], []):
        assert typed(*words.split(), *out).returncode == 2
    assert [each.name for each in tmp_path.iterdir()] == ["a.png"]
