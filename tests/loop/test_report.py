"""Reports say in words what happened, and compare runs."""

import re
from pathlib import Path

import pytest

from chromagrip import UserError, load_scene
from chromagrip.loop.results.report import run_on_page
from chromagrip.loop.results.reports import write_reports
from chromagrip.loop.results.run_folder import RunRead, read_run
from chromagrip.loop.run import run

QUICK = {"duration_s": 0.1, "path": "truth", "load.times_s": [0.02, 0.05]}


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "held"
    run(load_scene("camera-100hz", QUICK), folder)
    return folder


@pytest.fixture(scope="module")
def slid(tmp_path_factory: pytest.TempPathFactory) -> RunRead:
    """Run whose constant grip is far too weak for its load."""
    weak = {"controller": "conservative", "conservative.force_n": 0.3, "load.forces_n": [0.1, 2.0]}
    folder = tmp_path_factory.mktemp("runs")
    (folder / "scene.toml").touch()
    result = run(load_scene("camera-100hz", QUICK | weak))
    told = {"scene": result.scene, "summary": result.summary, "columns": result.trace.columns}
    return RunRead(folder=folder, **told)


def words(read: RunRead) -> str:
    return " ".join(run_on_page(read, "run").words)


def test_a_run_has_its_report(held: Path) -> None:
    page = (held / "report.html").read_text("utf-8")
    assert "the target is 0.30" in page
    assert 'data-video="0"' in page
    assert len(page) < 8e6


def test_words_say_whether_the_object_slid_and_name_the_target(held: Path, slid: RunRead) -> None:
    assert words(read_run(held)).startswith("Held: the object slid by 0.0")
    assert words(slid).startswith("Gross slip: the object slid by ")
    way = float(re.findall(r"slid by ([\d.]+) mm", words(slid))[0])
    assert way > 0.2
    assert "the controller has no target" in words(slid)


def test_the_panels_have_levels_and_the_true_margin(held: Path) -> None:
    panels = run_on_page(read_run(held), "run").panels
    levels = [level for panel in panels for level in panel.levels]
    assert ("gross slip 0.2", 0.2) in levels
    assert ("target 0.3", 0.3) in levels
    assert any(curve.role == "true" for curve in panels[0].curves)


@pytest.mark.loops
def test_runs_beside_each_other_are_told_apart_and_share_plots_by_their_scene(
    held: Path, slid: RunRead, tmp_path: Path
) -> None:
    other = tmp_path / "held"
    run(load_scene("margin-60hz", QUICK), other)
    page = write_reports([held, other], tmp_path / "new" / "compared.html").read_text("utf-8")
    assert "2 runs side by side" in page
    assert f"<th>{held.parent.name}/held</th>" in page
    assert page.count("<video") == 2
    reads = (read_run(held), slid, read_run(other))
    scenes = [run_on_page(read, "run").scene for read in reads]
    assert scenes[0] == scenes[1] != scenes[2]
    assert scenes[0] == load_scene("camera-100hz").description


def test_errors_are_sentences(held: Path, tmp_path: Path) -> None:
    (tmp_path / "leaderboard.html").touch()
    for folders, out, words in (
        ([tmp_path], None, "is not a finished run: .*; it was made by `chromagrip score`"),
        ([held, held], tmp_path / "page.html", "the same folder is given twice"),
        ([held, held], None, "needs a file of its own"),
        ([], None, "1 to 6 runs, not 0"),
    ):
        with pytest.raises(UserError, match=words):
            write_reports(folders, out)
