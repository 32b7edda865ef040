"""Reports say in words what happened, and compare runs."""

import re
from pathlib import Path
from typing import Any

import pytest

from chromagrip import UserError, load_scene
from chromagrip.loop.results.report import run_on_page
from chromagrip.loop.results.reports import write_reports
from chromagrip.loop.results.run_folder import read_run
from chromagrip.loop.run import run

QUICK = {"duration_s": 0.4, "path": "truth", "load.times_s": [0.02, 0.2]}


def a_run(folder: Path, **changes: Any) -> Path:
    run(load_scene("camera-100hz", QUICK | changes), folder)
    return folder


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return a_run(tmp_path_factory.mktemp("runs") / "held")


@pytest.fixture(scope="module")
def slid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run whose constant grip is far too weak for its load."""
    weak = {"controller": "conservative", "conservative.force_n": 0.3}
    changes = weak | {"load.forces_n": [0.1, 2.0]}
    return a_run(tmp_path_factory.mktemp("runs") / "slid", **changes)


def words(folder: Path) -> str:
    return " ".join(run_on_page(read_run(folder), "run").words)


def test_a_run_has_its_report(held: Path) -> None:
    page = (held / "report.html").read_text("utf-8")
    assert "the target is 0.30" in page
    assert 'data-video="0"' in page
    assert len(page) < 8e6


def test_words_say_whether_the_object_slid_and_name_the_target(held: Path, slid: Path) -> None:
    assert words(held).startswith("Held: the object slid by 0.0")
    assert words(slid).startswith("Gross slip: the object slid by ")
    way = float(re.findall(r"slid by ([\d.]+) mm", words(slid))[0])
    assert way > 0.2
    assert "the controller has no target" in words(slid)


def test_what_gross_slip_is_stands_in_the_panel(held: Path) -> None:
    panels = run_on_page(read_run(held), "run").panels
    levels = [level for panel in panels for level in panel.levels]
    assert ("gross slip 0.2", 0.2) in levels
    assert ("target 0.3", 0.3) in levels


def test_the_panel_of_margins_has_the_true_one(held: Path) -> None:
    (margins, *_) = run_on_page(read_run(held), "run").panels
    assert any(curve.role == "true" for curve in margins.curves)


def test_runs_beside_each_other(held: Path, slid: Path, tmp_path: Path) -> None:
    path = write_reports([held, slid], tmp_path / "new" / "compared.html")
    page = path.read_text("utf-8")
    assert "2 runs side by side" in page
    assert "<th>held</th><th>slid</th>" in page
    assert page.count("<video") == 2


def test_runs_of_one_name_are_told_apart(held: Path, tmp_path: Path) -> None:
    other = a_run(tmp_path / "held")
    page = write_reports([held, other], tmp_path / "both.html").read_text("utf-8")
    assert f"<th>{held.parent.name}/held</th>" in page


@pytest.mark.parametrize(
    ("file", "said"),
    [
        ("estimates.parquet", "made by `chromagrip estimate`: open its figure.png"),
        ("tracks.parquet", "made by `chromagrip track`: `chromagrip score` reads it"),
        ("manifest.json", "made by `chromagrip dataset make`: `chromagrip dataset info` reads it"),
        ("leaderboard.html", "made by `chromagrip score`: open leaderboard.html"),
    ],
)
def test_a_folder_of_another_command_is_called_by_it(file: str, said: str, tmp_path: Path) -> None:
    (tmp_path / file).touch()
    with pytest.raises(UserError, match=f"is not a finished run: .*; it was {said}"):
        write_reports([tmp_path])


def test_errors_are_sentences(held: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"is not a finished run: it has no summary\.json"):
        write_reports([tmp_path])
    with pytest.raises(UserError, match="the same folder is given twice"):
        write_reports([held, held], tmp_path / "page.html")
    with pytest.raises(UserError, match="needs a file of its own"):
        write_reports([held, held])
    with pytest.raises(UserError, match="1 to 6 runs, not 0"):
        write_reports([])
    broken = tmp_path / "broken"
    a_run(broken)
    table = (broken / "trace.parquet").rename(broken / "trace.npz")  # as of a run of before
    with pytest.raises(UserError, match=r"is not a finished run: it has no trace\.parquet"):
        write_reports([broken])
    table.rename(broken / "trace.parquet")
    (broken / "summary.json").write_text("{")
    with pytest.raises(UserError, match="broken cannot be read"):
        write_reports([broken])


def test_runs_share_plots_by_their_scene(held: Path, slid: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    run(load_scene("margin-60hz", QUICK), other)
    scenes = [run_on_page(read_run(folder), "run").scene for folder in (held, slid, other)]
    assert scenes[0] == scenes[1] != scenes[2]
    assert scenes[0] == load_scene("camera-100hz").description
