"""What tests of strangers' files share."""

from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

import pytest

from .judged import Judge


@pytest.fixture
def judged(
    typed: Callable[..., CompletedProcess[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Judge:
    """Runs commands and calls on strangers' files in a test's folder, and judges them."""
    place = tmp_path / "work"
    place.mkdir()
    monkeypatch.chdir(place)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return Judge(typed, place)
