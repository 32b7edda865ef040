"""Examples run as they are, headless, and assert what they show."""

import runpy
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


#: Examples that take longer than all others together.
LONG = ("learn_to_grip", "rolling_screw", "train_margin", "dome_tolerances")
MARKED = [
    pytest.param(path, id=path.stem, marks=[pytest.mark.slow] if path.stem in LONG else [])
    for path in EXAMPLES
]


@pytest.mark.parametrize("path", MARKED)
def test_example(
    path: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if path.stem == "train_margin":
        pytest.importorskip("sklearn", reason="needs the extra learn")
    monkeypatch.chdir(tmp_path)  # where pictures go
    monkeypatch.setattr(sys, "argv", [str(path)])
    runpy.run_path(str(path), run_name="__main__")
    assert capsys.readouterr().out
    assert len(path.read_text(encoding="utf-8").splitlines()) < 80


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["press", "shear", "pencil"])
def test_scenes_of_the_dome(scene: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    picture = tmp_path / "picture.png"
    monkeypatch.setattr(sys, "argv", ["dome_contact.py", scene, str(picture)])
    runpy.run_path(str(ROOT / "examples/dome_contact.py"), run_name="__main__")
    assert picture.stat().st_size > 20_000
