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
    {"name": "camera/margin_rmse", "value": 0.05, "unit": ""},
    {"name": "camera/rate", "value": 300.0, "unit": "frames/s"},
    {"name": "slip/time", "value": 1.39, "unit": "s"},
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


@pytest.fixture
def found(tmp_path: Path) -> Callable[[Callable[[Path], None]], list[str]]:
    """Differences that a change of a folder makes, as lines."""

    def find(change: Callable[[Path], None]) -> list[str]:
        from compared.computing import Result  # type: ignore[import-not-found]
        from compared.differences import differences  # type: ignore[import-not-found]
        from compared.digests import digests  # type: ignore[import-not-found]

        results = []
        for commit in ("old", "new"):
            folder = tmp_path / commit / "job"
            fill(folder)
            if commit == "new":
                change(folder)
            results.append(Result(folder, [], 0.0, files=digests(folder)))
        return [str(each) for each in differences(*results)]

    return find


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


@pytest.mark.parametrize(
    ("change", "lines"),
    [
        (lambda _: None, []),
        (
            rewrite("trace.parquet", time_s=[0.0, 0.125]),
            ["changed  job: trace.parquet: time_s: up to 0.025"],
        ),
        (
            rewrite("trace.parquet", margin=[0.5, 0.5]),
            ["changed  job: trace.parquet: margin: up to 0, 1 are missing in one"],
        ),
        (
            rewrite("trace.parquet", nodes=[[1, 2], [7]]),
            ["changed  job: trace.parquet: nodes: up to 4"],
        ),
        (rewrite("trace.parquet", force=[1.0, 2.0]), ["new      job: trace.parquet: force"]),
        (rewrite("trace.parquet", margin=None), ["gone     job: trace.parquet: margin"]),
        (rewrite("summary.json", frames=3), ["changed  job: summary.json: frames: 2 and 3"]),
        (rewrite("summary.json", frames_per_second=1.0, versions={}), []),
        (rewrite("report.json", machine={"cores": 64}), []),
        (
            lambda folder: (folder / "map.csv").write_text("gain,letter\n1.5,a\n2.75,b\n"),
            ["changed  job: map.csv: gain: up to 0.25"],
        ),
        (
            lambda folder: (folder / "map.csv").write_text("gain,letter\n1.5,a\n2.5,c\n"),
            ["changed  job: map.csv: letter"],
        ),
        (lambda folder: (folder / "map.csv").unlink(), ["gone     job: map.csv"]),
        (lambda folder: (folder / "more.toml").touch(), ["new      job: more.toml"]),
        (
            lambda folder: (folder / "scene.toml").write_text("fingers = 2\nload.rate = 2"),
            ["changed  job: scene.toml: load rate: 1 and 2", "new      job: scene.toml: fingers"],
        ),
    ],
)
def test_every_difference_is_named(
    found: Callable[..., list[str]], change: Callable[[Path], None], lines: list[str]
) -> None:
    assert found(change) == lines


@pytest.mark.parametrize(
    ("number", "same"), [(0, False), (1, True), (2, False), (3, True), (4, True), (5, False)]
)
def test_rows_of_the_clock_are_left_out(
    found: Callable[..., list[str]], number: int, same: bool
) -> None:
    rows = [row | {"value": 9.0} if at == number else row for at, row in enumerate(ROWS)]
    lines = found(rewrite("report.json", rows=rows))
    name, value = ROWS[number]["name"], ROWS[number]["value"]
    told = f"changed  job: report.json: rows {name} value: {value} and 9.0"
    assert lines == ([] if same else [told])


def test_a_picture_differs_by_its_pixels(found: Callable[..., list[str]]) -> None:
    def repaint(folder: Path) -> None:
        cv2.imwrite(str(folder / "figure.png"), np.full((4, 4, 3), 9, np.uint8))

    assert found(repaint)[0] == "changed  job: figure.png: pixels: up to 2"


def test_other_bytes_of_the_same_picture_are_told(found: Callable[..., list[str]]) -> None:
    def pack_otherwise(folder: Path) -> None:
        path = folder / "figure.png"
        cv2.imwrite(str(path), cv2.imread(str(path)), [cv2.IMWRITE_PNG_COMPRESSION, 0])

    assert found(pack_otherwise) == ["changed  job: figure.png: bytes"]


def test_the_speed_on_a_page_is_left_out(tmp_path: Path) -> None:
    from compared.digests import of_file

    page = "<p>margin 0.5</p>\n<tr><td>speed of the loop</td><td>99</td></tr>\n" + "x" * 2_000_000
    texts = page, page.replace("99", "98"), page.replace("0.5", "0.6")
    pages = [tmp_path / f"{number}.html" for number in range(3)]
    for path, text in zip(pages, texts, strict=True):
        path.write_text(text)
    one, same, other = map(of_file, pages)
    assert one == same != other


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


def test_a_job_that_breaks_is_not_said_in_another_way(tmp_path: Path, tree: Path) -> None:
    from compared.computing import compute, kept
    from compared.jobs import job

    asked = job("one", "broken", "old")
    assert compute(asked, tree, tmp_path / "results", tmp_path / "cache").failed == "it broke"
    assert kept(asked, tmp_path / "results") is None


def test_what_fails_in_one_commit_is_a_difference(tmp_path: Path, tree: Path) -> None:
    from compared.computing import compute, kept
    from compared.differences import differences
    from compared.jobs import job

    results = [tmp_path / "old", tmp_path / "new"]
    good = compute(job("one", "old"), tree, results[0], tmp_path / "cache")
    bad = compute(job("one", "later"), tree, results[1], tmp_path / "cache")
    assert kept(job("one", "later"), results[1]) is None
    assert [str(each) for each in differences(good, bad)] == [
        "changed  one: fails: error: no word later"
    ]
    assert [str(each) for each in differences(bad, bad)] == [
        "changed  one: fails in both: error: no word later"
    ]


def test_other_rules_make_other_digests_of_the_same_files(tmp_path: Path, tree: Path) -> None:
    from compared.computing import compute, kept
    from compared.jobs import job

    compute(job("one", "old"), tree, tmp_path, tmp_path / "cache")
    again = kept(job("one", "old", ignored=("*.txt",)), tmp_path)
    assert again is not None
    assert again.files == {}


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


def test_many_new_files_hide_no_change(compare: Callable[..., tuple[int, str]], tree: Path) -> None:
    main = tree / "src/chromagrip/__main__.py"
    many = "[Path(sys.argv[-1], f'{n}.txt').touch() for n in range(99)]\n"
    main.write_text(main.read_text().replace("' '.join", "'!' + ' '.join") + many)
    lines = compare("--only", "two", "--allow-new")[1].splitlines()
    assert "changed  two: said.txt: bytes" in lines
    assert "… two: 70 more" in lines


@pytest.mark.parametrize(("words", "code"), [((), 1), (("--allow-new",), 0)])
def test_what_is_new_may_be_allowed(
    compare: Callable[..., tuple[int, str]], tree: Path, words: tuple[str, ...], code: int
) -> None:
    with (tree / "src/chromagrip/__main__.py").open("a") as file:
        file.write("Path(sys.argv[-1], 'more.txt').touch()\n")
    found, said = compare("--tier", "quick", *words)
    assert (found, "new      one: more.txt" in said.splitlines()) == (code, True)


def test_a_document_is_no_reason_to_compute_again(
    compare: Callable[..., tuple[int, str]], tree: Path
) -> None:
    compare("--only", "one")
    (tree / "README.md").touch()
    assert compare("--only", "one")[1].count("kept") == 2


def test_what_a_checkout_computes_while_it_is_changed_is_not_kept(
    compare: Callable[..., tuple[int, str]], tree: Path, tmp_path: Path
) -> None:
    source = tree / "src/chromagrip/__main__.py"
    source.write_text(source.read_text() + f"Path({str(source)!r}).open('a').write('#')\n")
    with pytest.raises(SystemExit, match="was changed while one ran"):
        compare("--only", "one")
    assert len(list((tmp_path / "kept").glob("*/one/digests.json"))) == 1


def test_jobs_have_names_of_their_own() -> None:
    from compared.jobs import JOBS

    names = [job.name for job in JOBS]
    assert len(set(names)) == len(names)
