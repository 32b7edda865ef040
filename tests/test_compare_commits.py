"""The comparison of commits finds what differs, and nothing else."""

import json
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

#: A program that writes what it was told, or breaks.
PROGRAM = """
import sys
from pathlib import Path
if 'later' in sys.argv: print('error: no word later', file=sys.stderr), sys.exit(2)
Path(sys.argv[-1], 'said.txt').write_text(' '.join(sys.argv[1:-2]))
"""


def fill(folder: Path, time: float, rows: str, level: int) -> Path:
    folder.mkdir(parents=True)
    table = {"time_s": [0.0, time], "margin": [0.5, float("nan")], "nodes": [[1, 2], [3]]}
    pq.write_table(pa.table(table), folder / "trace.parquet")
    (folder / "map.csv").write_text(f"gain,letter\n1.5,a\n{rows}\n")
    speed = {"name": "camera/rate", "value": time, "unit": "frames/s"}  # of the clock
    report = {"machine": {"cores": level}, "rows": [speed]}
    (folder / "report.json").write_text(json.dumps(report))
    cv2.imwrite(str(folder / "figure.png"), np.full((4, 4, 3), level, np.uint8))
    return folder


def test_every_difference_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    from compared.computing import Result  # type: ignore[import-not-found]
    from compared.differences import differences  # type: ignore[import-not-found]
    from compared.digests import digests  # type: ignore[import-not-found]

    old = fill(tmp_path / "old/job", 0.1, "2.5,b", 7)
    new = fill(tmp_path / "new/job", 0.125, "2.75,b", 9)
    (new / "more.toml").touch()
    one, other = (Result(each, [], 0.0, files=digests(each)) for each in (old, new))
    assert [str(each) for each in differences(one, one)] == []
    assert sorted(str(each) for each in differences(one, other)) == [
        "changed  job: figure.png: bytes",
        "changed  job: figure.png: pixels: up to 2",
        "changed  job: map.csv: gain: up to 0.25",
        "changed  job: trace.parquet: time_s: up to 0.025",
        "new      job: more.toml",
    ]


@pytest.mark.environments
def test_a_checkout_is_compared_with_its_commit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    import compare_commits  # type: ignore[import-not-found]
    from compared.jobs import job

    tree = tmp_path / "tree"
    main = tree / "src/chromagrip/__main__.py"
    main.parent.mkdir(parents=True)
    (main.parent / "__init__.py").touch()
    main.write_text(PROGRAM)
    (tree / ".gitignore").write_text("__pycache__/\n")
    who = ["-c", "user.name=a", "-c", "user.email=a@b"]
    for words in (["init", "-q"], ["add", "."], [*who, "commit", "-qm", "first"]):
        subprocess.run(["git", "-C", str(tree), *words], check=True)
    jobs = [job("one", "later", "old", quick=True), job("two", "a")]
    monkeypatch.setattr(compare_commits, "JOBS", jobs)
    words = ["HEAD", "--here", str(tree), "--keep", str(tmp_path / "kept")]
    assert compare_commits.main(words) == 0
    assert compare_commits.main([*words, "--tier", "quick"]) == 0
    said = capsys.readouterr().out
    assert "0 changed, 0 new, 0 gone in 2 jobs" in said
    assert said.count("kept") == 2
    main.write_text(PROGRAM.replace("' '.join", "'!' + ' '.join"))
    assert compare_commits.main(words) == 1
    assert "changed  two: said.txt: bytes" in capsys.readouterr().out.splitlines()
