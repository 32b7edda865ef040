"""Examples run as they are, headless, and assert what they show."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_example(
    path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", [str(path)])
    runpy.run_path(str(path), run_name="__main__")
    assert capsys.readouterr().out
    assert len(path.read_text(encoding="utf-8").splitlines()) < 80


def test_the_readme_runs() -> None:
    """The Python blocks of the README that need no camera."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    (block,) = [block for block in blocks if "chromagrip.model" in block]
    done = subprocess.run([sys.executable, "-c", block], capture_output=True, text=True, check=True)
    assert 0.3 < float(done.stdout) < 0.45  # 1 − 0.5/(0.4·2), a little friction still to come
