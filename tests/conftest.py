"""The command line as it is typed, in this process: a new one takes seconds to start."""

import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from subprocess import CompletedProcess

import pytest
from hypothesis import settings

from chromagrip.cli import main

# No test is timed: first calls compile.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


@pytest.fixture
def typed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Iterator[Callable[..., CompletedProcess[str]]]:
    """Runs a command in the test's folder; what is raised but an exit fails the test."""
    before = signal.getsignal(signal.SIGINT)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])

    def run(*words: object) -> CompletedProcess[str]:
        arguments = [str(word) for word in words]
        monkeypatch.setattr(sys, "argv", ["chromagrip", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        return CompletedProcess(arguments, int(ended.value.code or 0), *capsys.readouterr())

    yield run
    signal.signal(signal.SIGINT, before)
