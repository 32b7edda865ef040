"""What the documentation says exists: pages, commands, flags, files; and its examples run."""

import re
import runpy
import shlex
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import msgspec
import pytest

import chromagrip
from benchmarks.__main__ import load
from chromagrip.cli.app import STUDIES
from chromagrip.dataset.labels import columns_of
from chromagrip.loop.column import Mechanics
from chromagrip.loop.columns import columns_of as trace_of
from chromagrip.loop.poses.dome_poses import DOME_ARRAYS
from chromagrip.loop.poses.poses import ARRAYS
from chromagrip.measure.study import studies
from chromagrip.output.parquet import DISPLACEMENTS, FORCES, TRACKS
from chromagrip.render import load_sensor

ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), ROOT / "fixtures/README.md"])
Typed = Callable[..., CompletedProcess[str]]


def blocks(text: str) -> list[tuple[str, str]]:
    """Language and text of every code block between fences."""
    return re.findall(r"^```(\w*)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


def anchor(heading: str) -> str:
    """Anchor of a heading as GitHub makes it."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


def typed_commands(text: str) -> Iterator[list[str]]:
    """Words of every `chromagrip` command in a page, in code blocks and between back quotes."""
    typed = [block for language, block in blocks(text) if language in ("", "bash")]
    lines = [line for block in typed for line in block.split("\n")]
    inline = re.findall(
        r"(?<!`)`([^`]+)`(?!`)", re.sub(r"^```.*?^```$", "", text, flags=re.S | re.M)
    )
    for line in [*lines, *inline]:
        found = re.match(r"\s*(?:\S*bin/)?chromagrip ([a-z].*)", line.split(" #")[0])
        if found and not re.match(r"\w+ \d", found[1]):  # `chromagrip dataset 1` is a format
            yield found[1].split()


def test_links_lead_somewhere() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)]+)\)", page.read_text(encoding="utf-8")):
            if "://" in target:
                continue
            file, _, part = target.partition("#")
            linked = page.parent / file if file else page
            assert linked.exists(), f"{page.name} links to {target}"
            if part:
                text = linked.read_text(encoding="utf-8")
                headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
                assert part in map(anchor, headings), f"{page.name} links to {target}"


def test_the_index_lists_every_page_and_architecture_every_room() -> None:
    index = (ROOT / "docs/README.md").read_text(encoding="utf-8")
    found = (ROOT / "docs").rglob("*.md")
    pages = {page.relative_to(ROOT / "docs").as_posix() for page in found} - {"README.md"}
    assert {page for page in pages if f"]({page})" not in index} == set()
    text = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    paths = [path for path in (ROOT / "src/chromagrip").iterdir() if path.name[0] not in "_."]
    rooms = {path.stem for path in paths if path.is_dir() or path.suffix == ".py"}
    assert {room for room in rooms if f"`{room}`" not in text} == set()


def test_the_pages_that_one_reads_stay_few_and_short() -> None:
    read = [page for page in (ROOT / "docs").rglob("*.md") if page.parent.name != "appendix"]
    assert len(read) <= 20
    for pages, most in ((read, 30_000), ((ROOT / "docs/appendix").glob("*.md"), 25_000)):
        texts = [page.read_text(encoding="utf-8") for page in pages]
        # A bar or a rule of a table is no word.
        assert sum(len(re.findall(r"\S*\w\S*", text)) for text in texts) <= most
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 80


def test_files_of_the_code_exist() -> None:
    rooms = "|".join(path.name for path in (ROOT / "src/chromagrip").iterdir() if path.is_dir())
    paths = rf"`((?:{rooms}|src|tests|docs|examples|fixtures)/[\w./-]*(?:\.(?:py|toml|csv|md)|/))`"
    for page in PAGES:
        for path in re.findall(paths, page.read_text(encoding="utf-8")):
            known = (ROOT / path).exists() or (ROOT / "src/chromagrip" / path).exists()
            assert known, f"{page.name} names {path}"


def test_commands_and_flags_exist(typed: Typed) -> None:
    helps: dict[str, str] = {}
    for page in PAGES:
        for words in typed_commands(page.read_text(encoding="utf-8")):
            two = words[0] in ("dataset", "calibrate", "list", *STUDIES)
            if ":" in "".join(words[1:2]):  # a study of the page itself
                continue
            name = words[: 2 if two and len(words) > 1 else 1]
            key = " ".join(name)
            if key not in helps:
                done = typed(*name, "--help")
                assert done.returncode == 0, f"{page.name}: chromagrip {key}"
                helps[key] = done.stdout
            for flag in re.findall(r"(?<!\S)--[a-z][a-z-]*", " ".join(words)):
                assert re.search(rf"{flag}\b", helps[key]), f"{page.name}: {key} {flag}"
    assert len(helps) > 20


def scene_keys(kind: type, prefix: str = "") -> Iterator[str]:
    for field in msgspec.structs.fields(kind):
        if isinstance(field.type, type) and issubclass(field.type, msgspec.Struct):
            yield from scene_keys(field.type, f"{prefix}{field.encode_name}.")
        else:
            yield prefix + field.encode_name


def test_the_page_on_files_names_every_key_and_column() -> None:
    text = (ROOT / "docs/file-formats.md").read_text(encoding="utf-8")
    tables = (trace_of("dome"), trace_of("pinch"), TRACKS, FORCES, DISPLACEMENTS)
    tables += (ARRAYS, DOME_ARRAYS)
    tables += (*columns_of("chain"), *columns_of("dome", reading=True))
    columns = (name for table in tables for name in table)
    fingers = ("first_", "second_")  # whose columns are those of a dome
    names = {*scene_keys(chromagrip.Scene), *(c for c in columns if not c.startswith(fingers))}
    assert {name for name in names if f"`{name}`" not in text} == set()


def test_the_page_on_measuring_has_every_study() -> None:
    load()
    text = (ROOT / "docs/measuring.md").read_text(encoding="utf-8")
    listed = text.split("<!-- studies -->")[1].split("<!-- end of studies")[0]
    for verb in ("bench", "chart", "stability", "project"):
        for part, entries in studies(verb).items():
            for entry in entries:
                assert f"| {entry.text} |" in listed, f"docs/make.py studies ({verb} {part})"


@pytest.mark.parametrize("body", ["chain", "dome", "pinch"])
def test_the_page_on_files_has_the_columns_of_the_table(body: Mechanics) -> None:
    text = (ROOT / "docs/file-formats.md").read_text(encoding="utf-8")
    _, rest = text.split(f"<!-- columns of a {body} -->")
    table, told = rest.split("<!-- end of columns")[0], {}
    for names, meaning, unit in re.findall(r"^\| (`.*?) \| (.*?) \| (.*?) *\|$", table, re.M):
        told |= {name.strip("`"): (meaning, unit) for name in names.split(", ")}
    chain, dome, columns = (
        {name: (each.meaning, each.unit) for name, each in trace_of(one).items()}
        for one in ("chain", "dome", body)
    )
    if body == "dome":  # its table has what a chain lacks
        columns = {name: each for name, each in columns.items() if name not in chain}
    if body == "pinch":  # each finger has columns of a dome
        fingers = [name for name in columns if name.startswith(("first_", "second_"))]
        assert all(columns.pop(name) == dome[name.partition("_")[2]] for name in fingers)
        assert len(fingers) > 40
    assert told == columns


def sections() -> dict[str, str]:
    """Sections of the page on extensions that have commands, by their headings."""
    text = (ROOT / "docs/extend.md").read_text(encoding="utf-8")
    _, *parts = re.split(r"^## ", text, flags=re.MULTILINE)
    return {part.split("\n")[0]: part for part in parts}


def write_files(heading: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Write the files of a section where they can be imported; returns its commands."""
    monkeypatch.syspath_prepend(str(folder))
    commands = []
    for language, block in blocks(sections()[heading]):
        if not language:
            commands += block.splitlines()
            continue
        file = re.match(r"# (\w+\.(?:py|toml))\n", block)
        assert file, f"a block of {heading!r} does not begin with the name of its file"
        (folder / file[1]).write_text(block, encoding="utf-8")
        monkeypatch.delitem(sys.modules, file[1].removesuffix(".py"), raising=False)
    return commands


@pytest.mark.loops
@pytest.mark.parametrize("heading", sections())
def test_examples_of_extensions_run(
    heading: str, typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for line in write_files(heading, tmp_path, monkeypatch):
        done = typed(*shlex.split(line)[1:])
        assert done.returncode == 0, done.stderr
    if heading == "A controller":
        result = runpy.run_path(str(tmp_path / "sweep.py"))["result"]
        assert result.summary["final_margin_true"] > 0.4  # Γ = 1 − 1/(gain·µ) when settled


def test_an_extension_runs_and_the_others_are_read(
    typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = [line for heading in sections() for line in write_files(heading, tmp_path, monkeypatch)]
    named = set(re.findall(r"(my_\w+):(\w+)", " ".join(said)))
    assert len(named) >= 6
    for module, name in named:
        assert callable(getattr(import_module(module), name))
    assert load_sensor(str(tmp_path / "my_sensor.toml")).description
    (line,) = [line for line in said if line.startswith("chromagrip grasp")]
    done = typed(*shlex.split(line)[1:], "--set", "duration_s=0.3")
    assert done.returncode == 0, done.stderr


def python_of(page: str) -> list[str]:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    return [block for language, block in blocks(text) if language == "python"]


def test_the_mechanics_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    exec(python_of("node-models.md")[0], {})
    assert 0.3 < float(capsys.readouterr().out) < 0.45  # 1 − 0.5/(0.4·2), a little friction to come


def test_the_scene_of_the_pinch_is_one(tmp_path: Path) -> None:
    text = (ROOT / "docs/pinch.md").read_text(encoding="utf-8")
    (block,) = [block for language, block in blocks(text) if language == "toml"]
    (tmp_path / "own.toml").write_text(block, encoding="utf-8")
    scene = chromagrip.load_scene(str(tmp_path / "own.toml"), {"path": "truth", "duration_s": 0.1})
    assert chromagrip.run(scene).summary["outcome"] == "held"


@pytest.mark.loops
@pytest.mark.parametrize(
    ("page", "first", "last", "printed"),
    [
        ("pinch.md", 0, None, ["held 0.49 N"]),
        ("dome.md", 0, None, ["with torsion 0.", "force 1.50 N"]),
        ("simulators.md", 0, 2, ["read force"]),
        ("simulators.md", 2, None, ["(4, 288, 288, 3)"]),
    ],
)
def test_examples_of_pages_run(
    page: str, first: int, last: int | None, printed: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """In one space of names; what is read is what is true."""
    space: dict[str, Any] = {}
    for block in python_of(page)[first:last]:
        exec(block, space)
    said = capsys.readouterr().out
    assert all(one in said for one in printed)
    if "reading" in space and "data" in space:
        true, read = space["data"], space["reading"]
        assert read.wrench[:3] == pytest.approx(true.wrench[:3], abs=0.05 * abs(true.wrench[2]))
        assert read.margin == pytest.approx(true.margin, abs=0.15)
