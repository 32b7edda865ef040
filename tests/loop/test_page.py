"""The examples of docs/environments.md run as they are."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs/environments.md"
EXAMPLES = dict(re.findall(r"^```python\n# (\w+\.py)\n(.*?)^```$", PAGE.read_text(), re.M | re.S))


@pytest.mark.loops
@pytest.mark.parametrize("name", EXAMPLES)
def test_example(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(EXAMPLES[name], name, "exec"), {"__name__": "__main__"})
    assert capsys.readouterr().out
