"""Runs commands and calls on strangers' files, and judges how each of them ends."""

import os
import random
import re
import shutil
import signal
import stat
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from subprocess import CompletedProcess
from tempfile import TemporaryFile
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from chromagrip.errors import UserError

#: Bounds of one command on files of some kilobytes: time [s], and growth of the memory [MB].
SECONDS, MEGABYTES = 30, 400.0


def few_and_many(few: int, many: int) -> pytest.MarkDecorator:
    """Run a test with some examples by default, and with more of them in the part `fuzz`."""
    counts = [pytest.param(few, id="few"), pytest.param(many, id="many", marks=pytest.mark.fuzz)]
    return pytest.mark.parametrize("count", counts)


def repeated(check: Callable[[random.Random], None], count: int) -> None:
    """Run a check on `count` inputs, each of which it draws by the numbers that it is given."""
    slow = list(HealthCheck)
    often = settings(
        max_examples=count, derandomize=True, database=None, suppress_health_check=slow
    )
    often(given(st.randoms(use_true_random=False))(check))()


class Trap:
    """Leaves a file where it is unpickled."""

    def __reduce__(self) -> tuple[object, tuple[Path]]:
        return Path.touch, (Path("outside/was-run"),)


class Judge:
    """Judges what is done with strangers' files in a folder; `refused` counts the refusals."""

    def __init__(self, typed: Callable[..., CompletedProcess[str]], place: Path) -> None:
        self.typed, self.place, self.refused = typed, place, 0
        self.outside = place / "outside"
        self.outside.mkdir()
        (self.outside / "secret").write_text("kept")

    @contextmanager
    def files(self, copied: Path | None = None) -> Iterator[Path]:
        """Folder `given` of a stranger, empty or a copy of another; it exists inside alone."""
        folder = self.place / "given"
        shutil.copytree(copied, folder, symlinks=True) if copied else folder.mkdir()
        try:
            yield folder
        finally:
            shutil.rmtree(folder)

    def command(
        self, *words: object, names: str = "", makes: tuple[str, ...] = (), leaves: bool = False
    ) -> CompletedProcess[str]:
        """Run a command: it is done, or refused in one line that names something.

        What it makes is removed then; a refusal makes nothing, unless it leaves something.
        """
        with self._judged(makes):
            done = self.typed(*words)
            assert done.returncode in (0, 2), (words, done.stderr)
            if done.returncode == 2:
                lines = [line for line in done.stderr.splitlines() if "compiling" not in line]
                assert len(lines) == 1, (words, done.stderr)
                assert lines[0].startswith("chromagrip: "), lines
                self._sentence(lines[0], names)
                assert leaves or not any((self.place / name).exists() for name in makes), words
        return done

    def call(self, function: Callable[[], Any], names: str = "") -> Any:
        """Result of a call, None where it raises a `UserError`, which is judged as a command's."""
        with self._judged(()), warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                return function()
            except UserError as error:
                self._sentence(str(error), names)
                return None

    def _sentence(self, text: str, names: str) -> None:
        self.refused += 1
        assert text.isprintable(), text
        assert len(text) < 2500, text
        assert "more memory than there is" not in text, text
        assert names in text, (names, text)

    @contextmanager
    def _judged(self, makes: tuple[str, ...]) -> Iterator[None]:
        before = self._entries()
        with bounded(), silent():
            yield
        for name in makes:
            path = self.place / name
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
        assert self._entries() == before

    def _entries(self) -> dict[str, tuple[int, ...]]:
        """Files of the folder with size and time of change; no link is followed."""
        found, pending = {}, [str(self.place)]
        while pending:
            for entry in os.scandir(pending.pop()):
                about = entry.stat(follow_symlinks=False)
                folder = stat.S_ISDIR(about.st_mode)
                pending += [entry.path] * folder
                found[entry.path] = (0,) if folder else (about.st_size, about.st_mtime_ns)
        return found


@contextmanager
def bounded() -> Iterator[None]:
    """Fail where something takes too long, or takes too much memory."""

    def memory(kind: str) -> float:
        found = re.search(rf"Vm{kind}:\s+(\d+)", Path("/proc/self/status").read_text())
        return 1e-3 * int(found[1]) if found else 0.0

    def late(*_: object) -> None:
        pytest.fail(f"no end within {SECONDS} s")  # passes every `except Exception`

    Path("/proc/self/clear_refs").write_text("5")  # the peak begins here
    begin, before = memory("RSS"), signal.signal(signal.SIGALRM, late)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    assert memory("HWM") - begin < MEGABYTES


@contextmanager
def silent() -> Iterator[None]:
    """Fail where a library writes to the terminal below Python."""
    kept = os.dup(2)
    with TemporaryFile() as said:
        os.dup2(said.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
        said.seek(0)
        assert said.read() == b""
