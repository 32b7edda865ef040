"""Without the extras `data` and `video` the main jobs make less, not nothing."""

import csv
import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest

from chromagrip import UserError, load_scene, run
from chromagrip.live.record import Recorder
from chromagrip.live.session import Session, Shown
from chromagrip.loop.results.reports import write_reports
from chromagrip.loop.results.run_folder import read_run
from chromagrip.loop.results.trace_file import write_trace
from chromagrip.loop.run_files import FILES
from chromagrip.measure.score.points import read_points
from chromagrip.output.parquet import FORCES
from chromagrip.sources import open_source

Typed = Callable[..., CompletedProcess[str]]
#: A grasp that needs no tables, with one change to follow.
GRASP = ("grasp", "camera-100hz", "--path", "truth", "--set")
#: Files that a folder has with the extras alone.
PARTED = {"trace.parquet", "tactile.mp4", "tracks.parquet", "estimates.parquet", "overlay.mp4"}


@pytest.fixture
def without(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Takes both extras away until the test ends."""

    def take() -> None:
        for module in ("pyarrow", "av"):
            monkeypatch.setitem(sys.modules, module, None)

    return take


def check_told(done: CompletedProcess[str], table: str, video: str) -> None:
    """The command ended well, and told in a line each what is missing."""
    assert done.returncode == 0, done.stderr
    first, second = done.stderr.splitlines()
    whole = Path(table).with_suffix(".parquet")
    assert first == (
        f"chromagrip: {table} is written, as {whole} needs the extra `data`: "
        "pip install 'chromagrip[data]'"
    )
    assert second == (
        f"chromagrip: there is no {video}, as a video needs the extra `video`: "
        "pip install 'chromagrip[video]'"
    )


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_a_grasp_leaves_a_run_that_our_readers_read(
    typed: Typed, without: Callable[[], None], tmp_path: Path
) -> None:
    words = (*GRASP, "duration_s=0.1", "--json", "--out")
    assert typed(*words, "whole").stderr == ""
    whole = read_run(tmp_path / "whole")
    without()
    done = typed(*words, "less")
    check_told(done, "trace.npz", "tactile.mp4")
    assert names(tmp_path / "less") == {*FILES, "trace.npz"} - PARTED
    (tmp_path / "less/report.html").unlink()
    assert typed("report", "less").returncode == 0
    assert (tmp_path / "less/report.html").is_file()
    less = read_run(tmp_path / "less")
    assert less.video is None
    assert list(less.columns) == list(whole.columns)
    for name, values in less.columns.items():
        assert values.dtype == np.float64
        assert values.tobytes() == whole.columns[name].tobytes(), name
    with pytest.raises(UserError, match="is a run, whose frames are in"):
        open_source("less")
    refused = typed("report", "whole")
    assert refused.returncode == 2
    assert "pip install 'chromagrip[data]'" in refused.stderr


def test_a_folder_that_is_run_again_has_one_trace(
    typed: Typed, without: Callable[[], None], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    words = (*GRASP, "duration_s=0.05", "--out", "run", "--overwrite")
    assert typed(*words).returncode == 0
    with monkeypatch.context() as absent:
        for module in ("pyarrow", "av"):
            absent.setitem(sys.modules, module, None)
        refused = typed(*words, "--frames", "ffv1")
        assert refused.returncode == 2
        assert "writing pictures as ffv1 needs the extra `video`" in refused.stderr
        assert names(tmp_path / "run") == set(FILES)  # a refusal removes nothing
        check_told(typed(*words), "trace.npz", "tactile.mp4")
        assert names(tmp_path / "run") == {*FILES, "trace.npz"} - PARTED
    assert typed(*words).returncode == 0
    assert names(tmp_path / "run") == set(FILES)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"margin_true": None}, "has no column margin_true"),
        ({"time_s": np.zeros(0)}, "has columns of different lengths"),
        ({"margin_true": np.zeros((3, 2))}, "has columns of different lengths"),
        ({"margin_true": np.array(["a"] * 4)}, "column margin_true holds '<U1', not numbers"),
        ({"margin_true": np.array([None] * 4)}, "column margin_true holds 'object', not numbers"),
        ({"margin_true": np.full(4, 1e15)}, "column margin_true is 1e+15 at row 0"),
        ({"time_s": np.array([0.0, 0.2, 0.1, 0.3])}, "column time_s does not rise at row 2"),
    ],
)
def test_a_damaged_npz_is_one_sentence(
    change: dict[str, np.ndarray | None], told: str, tmp_path: Path
) -> None:
    """It is checked as the Parquet table is."""
    folder, path = tmp_path / "run", tmp_path / "run/trace.npz"
    run(load_scene("camera-100hz", {"path": "truth", "duration_s": 0.03}), folder)
    columns = read_run(folder).columns
    (folder / "trace.parquet").unlink()
    with pytest.raises(UserError, match=r"it has no trace\.parquet or trace\.npz"):
        read_run(folder)
    write_trace(path, columns, dict.fromkeys(columns, ""))
    for name, values in read_run(folder).columns.items():
        np.testing.assert_array_equal(values, columns[name])
    with pytest.raises(UserError, match=r"trace\.npz has 4 rows; a run has 1 to 3; for more give"):
        read_run(folder, max_rows=3)
    assert len(columns["time_s"]) == 4
    kept = {name: values for name, values in {**columns, **change}.items() if values is not None}
    np.savez(path, allow_pickle=True, **kept)
    with pytest.raises(UserError) as caught:
        read_run(folder)
    assert str(caught.value).startswith(str(path))
    assert told in str(caught.value)
    path.write_bytes(path.read_bytes()[:900])
    with pytest.raises(UserError, match=r"trace\.npz cannot be read"):
        write_reports([folder])


@pytest.fixture(scope="module")
def press(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Rest picture and frames of a run of the thesis's fingertip."""
    folder = tmp_path_factory.mktemp("press")
    run(load_scene("camera-100hz", {"duration_s": 0.03}), folder / "run", frames="png")
    frames = folder / "run/frames"
    shutil.copytree(frames, folder / "frames", ignore=shutil.ignore_patterns("rest.png", "*.csv"))
    shutil.copyfile(frames / "rest.png", folder / "rest.png")
    return folder


def test_tracks_as_csv_are_scored_alike(
    press: Path, typed: Typed, without: Callable[[], None], tmp_path: Path
) -> None:
    hidden = tmp_path / "frames"
    shutil.copytree(press / "frames", hidden)
    last = max(hidden.iterdir())
    image = cv2.imread(str(last))
    assert image is not None
    image[200:260, 330:420] = 128  # some markers are lost
    assert cv2.imwrite(str(last), image)
    words = ("track", press / "rest.png", hidden, "--palette", "thesis", "--out")
    assert typed(*words, "whole").returncode == 0
    scored = typed("score", "whole/tracks.parquet", "whole/tracks.parquet", "--json", "--out", "a")
    table = pq.read_table("whole/tracks.parquet").to_pylist()
    points = read_points(Path("whole/tracks.parquet"))
    assert not points.visible.all()
    without()
    done = typed(*words, "less")
    check_told(done, "tracks.csv", "overlay.mp4")
    assert done.stdout.splitlines()[-1] == "folder less"
    assert names(tmp_path / "less") == {"summary.json", "tracks.csv"}
    less = read_points(Path("less/tracks.csv"))
    assert less.names == points.names
    assert less.position.tobytes() == points.position.tobytes()
    np.testing.assert_array_equal(less.visible, points.visible)
    with Path("less/tracks.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [*rows[0]] == [*table[0]]
    for row, true in zip(rows, table, strict=True):
        assert row == {name: "" if v is None else str(v) for name, v in true.items()}
    again = typed("score", "less/tracks.csv", "less/tracks.csv", "--json", "--out", "b")
    assert (scored.returncode, again.returncode) == (0, 0)
    scores = [json.loads(one.stdout)["tracks"][0]["scores"] for one in (scored, again)]
    assert scores[0] == scores[1]


def test_estimates_are_csv(
    press: Path, typed: Typed, without: Callable[[], None], tmp_path: Path
) -> None:
    words = ("estimate", press / "rest.png", press / "frames", "--calibration", "thesis", "--out")
    assert typed(*words, "whole").returncode == 0
    table = pq.read_table("whole/estimates.parquet").to_pylist()
    without()
    done = typed(*words, "less")
    check_told(done, "estimates.csv", "overlay.mp4")
    assert done.stdout.splitlines()[-1] == "folder less, see figure.png"
    assert names(tmp_path / "less") == {"summary.json", "estimates.csv", "figure.png"}
    with Path("less/estimates.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    plain = [name for name, (kind, _) in FORCES.items() if kind != "list"]
    assert [*rows[0]] == plain
    for row, true in zip(rows, table, strict=True):
        assert row == {name: "" if true[name] is None else str(true[name]) for name in plain}


def test_a_recording_is_kept_too(
    without: Callable[[], None], until: Callable[..., None], tmp_path: Path
) -> None:
    without()
    shown: list[Shown] = []
    told: list[str] = []
    recorder = Recorder(tmp_path, told.append, wanted=True)
    scene = load_scene("camera-100hz", {"path": "truth"})
    with Session(scene, shown.append, lambda _: None, recorder):
        until(lambda: len(shown) > 40)
    assert names(tmp_path / "001") == {*FILES, "trace.npz", "sliders.csv"} - PARTED
    assert "; there is no tactile.mp4, as a video needs the extra `video`: pip" in told[-1]
    assert len(read_run(tmp_path / "001").columns["time_s"]) >= 40
