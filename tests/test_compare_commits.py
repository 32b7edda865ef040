"""The comparison of commits finds what differs, and nothing else."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

TESTS = Path(__file__).parent
ROWS = [
    {"name": "slip/time", "value": 1.39, "unit": "s"},
    {"name": "camera/rate", "value": 300.0, "unit": "frames/s"},
    {"name": "implicit/cpu_2s", "value": 0.04, "unit": "s"},
    {"name": "speed/plan/cheaper", "value": 3.5, "unit": "×"},
    {"name": "speed/27 objects/held", "value": 26.0, "unit": "of 27"},
]


@pytest.fixture(autouse=True)
def _scripts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(TESTS))


def fill(folder: Path) -> None:
    """Write results of every kind."""
    folder.mkdir(parents=True)
    table = {"time_s": [0.0, 0.1], "margin": [0.5, float("nan")], "nodes": [[1, 2], [3]]}
    pq.write_table(pa.table(table), folder / "trace.parquet")
    (folder / "map.csv").write_text("gain,letter\n1.5,a\n2.5,b\n")
    (folder / "scene.toml").write_text("# seen\n[load]\nrate = 1\n")
    summary = {"frames": 2, "frames_per_second": 99.0, "versions": {"numpy": "1"}}
    (folder / "summary.json").write_text(json.dumps(summary))
    (folder / "report.json").write_text(json.dumps({"machine": {"cores": 2}, "rows": ROWS}))
    cv2.imwrite(str(folder / "figure.png"), np.full((4, 4, 3), 7, np.uint8))


def rewrite(name: str, **changed: Any) -> Callable[[Path], None]:
    """Change of a table's columns or of a JSON file's keys; None takes them away."""

    def change(folder: Path) -> None:
        path = folder / name
        table = name.endswith(".parquet")
        held = pq.read_table(path).to_pydict() if table else json.loads(path.read_text())
        held = {key: value for key, value in (held | changed).items() if value is not None}
        if table:
            pq.write_table(pa.table(held), path)
        else:
            path.write_text(json.dumps(held))

    return change


def of_row(number: int) -> Callable[[Path], None]:
    rows = [row | {"value": 9.0} if at == number else row for at, row in enumerate(ROWS)]
    return rewrite("report.json", rows=rows)


def repainted(level: int, packed: int) -> Callable[[Path], object]:
    picture, how = np.full((4, 4, 3), level, np.uint8), [cv2.IMWRITE_PNG_COMPRESSION, packed]
    return lambda folder: cv2.imwrite(str(folder / "figure.png"), picture, how)


@pytest.mark.parametrize(
    ("change", "lines"),
    [
        (lambda _: None, []),
        (rewrite("trace.parquet", time_s=[0, 0.125]), ["trace.parquet: time_s: up to 0.025"]),
        (
            rewrite("trace.parquet", margin=[0.5, 0.5]),
            ["trace.parquet: margin: up to 0, 1 are missing in one"],
        ),
        (rewrite("trace.parquet", nodes=[[1, 2], [7]]), ["trace.parquet: nodes: up to 4"]),
        (rewrite("trace.parquet", force=[1.0, 2.0]), ["+ trace.parquet: force"]),
        (rewrite("trace.parquet", margin=None), ["- trace.parquet: margin"]),
        (rewrite("summary.json", frames=3), ["summary.json: frames: 2 and 3"]),
        (rewrite("summary.json", frames_per_second=1.0, versions={}), []),
        (rewrite("report.json", machine={"cores": 64}), []),
        (of_row(0), ["report.json: rows slip/time value: 1.39 and 9.0"]),
        *((of_row(number), []) for number in (1, 2, 3)),  # of the clock
        (of_row(4), ["report.json: rows speed/27 objects/held value: 26.0 and 9.0"]),
        (lambda folder: (folder / "map.csv").unlink(), ["- map.csv"]),
        (
            lambda folder: (folder / "map.csv").write_text("gain,letter\n1.5,a\n2.75,c\n"),
            ["map.csv: gain: up to 0.25", "map.csv: letter"],
        ),
        (lambda folder: (folder / "more.toml").touch(), ["+ more.toml"]),
        (
            lambda folder: (folder / "scene.toml").write_text("fingers = 2\nload.rate = 2"),
            ["scene.toml: load rate: 1 and 2", "+ scene.toml: fingers"],
        ),
        (repainted(9, 1), ["figure.png: pixels: up to 2", "figure.png: bytes"]),
        (repainted(7, 0), ["figure.png: bytes"]),
    ],
)
def test_every_difference_is_named(
    tmp_path: Path, change: Callable[[Path], None], lines: list[str]
) -> None:
    from compared.computing import Result  # type: ignore[import-not-found]
    from compared.differences import differences  # type: ignore[import-not-found]
    from compared.digests import digests  # type: ignore[import-not-found]

    results = []
    for commit, changed in (("old", lambda _: None), ("new", change)):
        folder = tmp_path / commit / "job"
        fill(folder)
        changed(folder)
        results.append(Result(folder, [], 0.0, files=digests(folder)))
    kinds = {"+": "new      job: ", "-": "gone     job: "}
    told = [kinds[x[0]] + x[2:] if x[0] in kinds else f"changed  job: {x}" for x in lines]
    assert [str(each) for each in differences(*results)] == told


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A checkout whose program knows the words `new` and `old`, but not `later`."""
    package = tmp_path / "tree/src/chromagrip"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    (tmp_path / "tree/.gitignore").write_text("__pycache__/\n")
    (package / "__main__.py").write_text(
        "import sys\n"
        "from pathlib import Path\n"
        "if 'broken' in sys.argv: sys.exit('it broke')\n"
        "if 'later' in sys.argv: print('error: no word later', file=sys.stderr), sys.exit(2)\n"
        "Path(sys.argv[-1], 'said.txt').write_text(' '.join(sys.argv[1:-2]))\n"
    )
    return tmp_path / "tree"


def test_a_job_is_computed_once_and_never_half(tmp_path: Path, tree: Path) -> None:
    from compared.computing import DIGESTS, compute, kept
    from compared.jobs import job

    asked, results = job("one", "later", "old"), tmp_path / "results"
    assert kept(asked, results) is None
    result = compute(asked, tree, results, tmp_path / "cache")
    assert result.words == ["chromagrip", "old", "--out", "OUT"]
    assert not result.failed
    assert (result.folder / "said.txt").read_text() == "old"
    assert kept(asked, results) == result
    assert [each.name for each in results.iterdir()] == ["one"]
    assert kept(job("one", "other"), results) is None
    whole = (result.folder / DIGESTS).read_text()
    (result.folder / DIGESTS).write_text(whole[:-9])
    assert kept(asked, results) is None
    (result.folder / DIGESTS).unlink()
    assert kept(asked, results) is None


def test_what_fails_in_one_commit_is_a_difference(tmp_path: Path, tree: Path) -> None:
    """What breaks is not said in another way, and is not kept."""
    from compared.computing import compute, kept
    from compared.differences import differences
    from compared.jobs import job

    good = compute(job("one", "old"), tree, tmp_path / "good", tmp_path / "cache")
    asked = job("one", "broken", "old")
    bad = compute(asked, tree, tmp_path / "bad", tmp_path / "cache")
    assert kept(asked, tmp_path / "bad") is None
    assert [str(each) for each in differences(good, bad)] == ["changed  one: fails: it broke"]
    assert [str(each) for each in differences(bad, bad)] == [
        "changed  one: fails in both: it broke"
    ]


@pytest.fixture
def compare(
    tmp_path: Path, tree: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str]]:
    """Compares the checkout `tree` with its first commit: exit code and what is printed."""
    import compare_commits  # type: ignore[import-not-found]
    from compared.jobs import job

    who = ["-c", "user.name=a", "-c", "user.email=a@b"]
    for words in (["init", "-q"], ["add", "."], [*who, "commit", "-qm", "first"]):
        subprocess.run(["git", "-C", str(tree), *words], check=True)
    monkeypatch.setattr(compare_commits, "JOBS", [job("one", "grasp", quick=True), job("two", "a")])

    def run(*words: str) -> tuple[int, str]:
        keep = ["--here", str(tree), "--keep", str(tmp_path / "kept")]
        code = compare_commits.main(["HEAD", *keep, *words])
        return code, capsys.readouterr().out

    return run


def test_a_commit_is_compared_with_itself(compare: Callable[..., tuple[int, str]]) -> None:
    code, said = compare()
    assert (code, said.splitlines()[-1]) == (0, "0 changed, 0 new, 0 gone in 2 jobs")
    assert compare("--tier", "quick")[1].count("kept") == 2


def test_a_change_that_is_not_committed_is_found(
    compare: Callable[..., tuple[int, str]], tree: Path
) -> None:
    main = tree / "src/chromagrip/__main__.py"
    main.write_text(main.read_text().replace("' '.join", "'!' + ' '.join"))
    code, said = compare("--only", "two")
    assert code == 1
    assert "changed  two: said.txt: bytes" in said.splitlines()
    assert said.splitlines()[-1] == "1 changed, 0 new, 0 gone in 1 jobs"
