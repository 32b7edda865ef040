"""Run folders of strangers: each is shown, or refused in one sentence."""

import os
import shutil
from pathlib import Path
from random import Random

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from chromagrip.folders import part_of
from chromagrip.live.replay import _video, not_repeated
from chromagrip.live.strips import rows_of
from chromagrip.loop.results.log import log_of
from chromagrip.loop.results.reports import write_logs_again, write_reports
from chromagrip.loop.results.run_folder import MOST_ROWS, NEEDED, VIDEO, read_run
from chromagrip.output.frames import FrameFiles
from chromagrip.output.video import VideoFile
from chromagrip.render import Frame

from .damages import harmed
from .judged import Judge, few_and_many, repeated

WRITTEN = Path(__file__).parents[2] / "fixtures/written-before"
RUNS = ("chain", "dome", "pinch", "live")
FILES = (NEEDED[0], VIDEO, "frames/frames.csv", "frames/frame-000000.png")
#: Files that a command makes in a run folder.
REPORT, LOG = "given/report.html", "given/run.mcap"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run folders with a video and pictures; no run of today is needed for them."""
    place = tmp_path_factory.mktemp("whole")
    for name in RUNS:
        shutil.copytree(WRITTEN / name, place / name)
        with VideoFile(place / name / VIDEO, 25) as video:
            for k in range(4):
                video.append(np.full((64, 800, 3), 40 * k, np.uint8))
        for finger in ("first", "second") if name == "pinch" else ("",):
            inner = place / name / "frames" / finger
            inner.parent.mkdir(exist_ok=True)
            files = FrameFiles(inner, "png", 60.0)
            for k in range(2):
                files.add(k, Frame(image=np.zeros((8, 8, 3), np.uint8), time=k / 60))
            files.close()
    return place


def opened() -> None:
    """Everything that reads a run folder; errors but the refusal pass."""
    folder = Path("given")
    run = read_run(folder)
    try:
        write_reports([folder])
    finally:
        Path(REPORT).unlink(missing_ok=True)
    if run.scene.fingers == 1:
        assert rows_of(run.columns)
        if not_repeated(run):
            list(_video(run))
    for pictures in log_of(run).pictures:
        for _ in pictures.read():
            pass


@few_and_many(16, 1000)
def test_damaged_runs_are_shown_or_refused(judged: Judge, whole: Path, count: int) -> None:
    def check(draw: Random) -> None:
        with judged.files(whole / draw.choice(RUNS)) as folder:
            files = [str(path.relative_to(folder)) for path in sorted(folder.rglob("*.*"))]
            files = [name for name in files if (folder / name).is_file()]
            names = files if draw.random() < 0.15 else [*NEEDED, VIDEO]
            harmed(folder / draw.choice(names), draw)
            judged.call(opened, names="given")
            if draw.random() < 0.1:
                judged.command("report", "given", names="given", makes=(REPORT,))

    for name in RUNS:
        with judged.files(whole / name):
            judged.call(opened)
    assert judged.refused == 0
    repeated(check, count)
    assert judged.refused > count // 3


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("summary.json", b"{}", "Object missing required field `controller`"),
        ("tactile.mp4", b"root:x:0:0", "cannot be read as a video"),
        ("scene.toml", b"a = ", "is not valid TOML"),
    ],
)
def test_every_command_refuses_alike(
    judged: Judge, whole: Path, name: str, content: bytes, told: str
) -> None:
    with judged.files(whole / "chain") as folder:
        (folder / name).write_bytes(content)
        said = {
            judged.command(*words, names=told, makes=(REPORT, LOG)).stderr
            for words in (
                ("report", "given"), ("report", "given", "--log", "mcap"),
                ("live", "--run", "given"),
            )
        }  # fmt: skip
    assert len(said) == 1


@pytest.mark.parametrize("name", FILES)
def test_links_pipes_and_huge_files(judged: Judge, whole: Path, name: str) -> None:
    with judged.files(whole / "chain") as folder:
        kept = (folder / name).read_bytes()
        (folder / name).unlink()
        (judged.outside / "file").write_bytes(kept)
        (folder / name).symlink_to(judged.outside / "file")
        for words in ((), ("--follow-links",)):
            done = judged.command(
                "report", "given", "--log", "mcap", *words, makes=(REPORT, LOG),
                # issue 81: a report stands before the log is refused
                leaves=name.startswith("frames"),
            )  # fmt: skip
            assert done.returncode == (0 if words else 2)
            assert words or "leads out of its folder; give --follow-links" in done.stderr
        (folder / name).unlink()
        os.mkfifo(folder / name)
        refused = judged.refused
        judged.call(opened, names=Path(name).name)
        # A run may have no video and no list of pictures.
        assert judged.refused - refused == (name not in (VIDEO, "frames/frames.csv"))
        (folder / name).unlink()
        with (folder / name).open("wb") as file:
            file.truncate(2**40)  # takes no place on the disk
        refused = judged.refused
        judged.call(opened, names=Path(name).name)
        assert judged.refused == refused + 1


def test_frames_have_names_inside_their_folder(judged: Judge, whole: Path) -> None:
    with judged.files(whole / "chain") as folder:
        for name in ("../../outside/secret", "/etc/passwd", "..", "../frames.csv"):
            (folder / "frames/frames.csv").write_text(f"frame,time_s,file\n0,0.0,{name}\n")
            judged.call(
                lambda: write_logs_again([Path("given")], ["mcap"]),
                names="expected a name inside the folder",
            )
    assert judged.refused == 4


@pytest.mark.parametrize("name", ["report.html", "run.mcap"])
def test_nothing_is_written_through_a_link(judged: Judge, whole: Path, name: str) -> None:
    """Neither the file nor the one that is written until it is whole."""
    with judged.files(whole / "chain") as folder:
        for link in (name, part_of(folder / name).name):
            (folder / link).symlink_to(judged.outside / "secret")
            assert judged.typed("report", "given", "--log", "mcap").returncode == 0
            assert not (folder / name).is_symlink()
            assert (judged.outside / "secret").read_text() == "kept"
            (folder / name).unlink()


def test_a_long_trace_is_refused_before_it_is_read(
    judged: Judge, whole: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert MOST_ROWS <= 10**8
    with judged.files(whole / "chain") as folder:
        told = "given/trace.parquet has 7 rows; a run has 1 to 6; for more give --max-rows"
        judged.command("report", "given", "--max-rows", "6", names=told)
        rows = pa.table({"time_s": pa.array(np.zeros(MOST_ROWS + 1, "int8"))})
        pq.write_table(rows, folder / "trace.parquet")
        monkeypatch.setattr(pq.ParquetFile, "read", None)
        judged.call(lambda: read_run(Path("given")), names=f"has {MOST_ROWS + 1} rows")
    assert judged.refused == 2
