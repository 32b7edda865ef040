"""Damaged run folders: each is refused in one sentence, or shown; nothing else."""

import json
import os
import random
import shutil
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from chromagrip import UserError
from chromagrip.folders import part_of
from chromagrip.live.replay import _video, not_repeated
from chromagrip.live.strips import rows_of
from chromagrip.loop.results.log import log_of
from chromagrip.loop.results.report import _facts, _words, run_on_page
from chromagrip.loop.results.reports import write_logs_again, write_reports
from chromagrip.loop.results.run_folder import (
    MOST_ROWS,
    NEEDED,
    VIDEO,
    _One,
    _read_summary,
    _Two,
    read_run,
    read_trace,
)
from chromagrip.output.frames import FrameFiles
from chromagrip.output.video import VideoFile
from chromagrip.render import Frame

from ..damages import damage

WRITTEN = Path(__file__).parents[2] / "fixtures/written-before"
RUNS = ("chain", "dome", "pinch", "live")


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
            (place / name / "frames").mkdir(exist_ok=True)
            inner = place / name / "frames" / (finger or "x")
            files = FrameFiles(inner, "png", 60.0)
            for k in range(2):
                files.add(k, Frame(image=np.zeros((8, 8, 3), np.uint8), time=k / 60))
            files.close()
            if not finger:
                for file in inner.iterdir():
                    file.rename(inner.parent / file.name)
                inner.rmdir()
    return place


def opened(folder: Path) -> None:
    """Everything that reads a run folder; errors but the refusal pass."""
    write_reports([folder])
    run = read_run(folder)
    if run.scene.fingers == 1:
        assert rows_of(run.columns)
        if not_repeated(run):
            list(_video(run))
    log = log_of(run)
    for pictures in log.pictures:
        for _ in pictures.read():
            pass


def damages(whole: Path, seed: int, count: int, place: Path) -> Iterator[tuple[str, Path]]:
    for index in range(count):
        draw = random.Random(f"{seed} {index}")
        name = draw.choice(RUNS)
        copy = place / f"{index}"
        shutil.copytree(whole / name, copy)
        files = [path.relative_to(copy) for path in sorted(copy.rglob("*")) if path.is_file()]
        names = [str(file) for file in files] if draw.random() < 0.15 else [*NEEDED, VIDEO]
        yield f"{seed} {index}: {name}, {damage(copy, names, draw)}", copy
        shutil.rmtree(copy)


def check_damages(whole: Path, seed: int, count: int, place: Path) -> int:
    """Refusals; anything else that is raised fails."""
    refused = 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for what, folder in damages(whole, seed, count, place):
            try:
                opened(folder)
            except UserError as error:
                refused += 1
                text = str(error)
                assert "\n" not in text.strip(), f"{what}: {text}"
                assert len(text) < 1000, f"{what}: {text}"
                assert str(place) in text, f"{what}: {text}"  # the file
            except Exception as error:
                raise AssertionError(what) from error
    return refused


def told(folder: Path, **limits: Any) -> str:
    """Sentence that a folder is refused with, alike by all that read it."""
    with pytest.raises(UserError) as caught:
        read_run(folder, **limits)
    sentence = str(caught.value)
    for write in (write_reports, lambda of, **more: write_logs_again(of, ["mcap"], **more)):
        with pytest.raises(UserError) as again:
            write([folder], **limits)
        assert str(again.value) == sentence
    assert not (folder / "report.html").exists()
    assert not (folder / "run.mcap").exists()
    return sentence


@pytest.fixture
def copy(whole: Path, tmp_path: Path) -> Path:
    return shutil.copytree(whole / "chain", tmp_path / "chain")


def test_runs_that_are_whole_are_shown(whole: Path) -> None:
    for name in RUNS:
        opened(whole / name)
        (whole / name / "report.html").unlink()


def test_damages_are_refused_or_shown(
    whole: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert check_damages(whole, 1, 80, tmp_path) > 40
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("name", ["chain", "pinch"])
def test_every_key_and_column_is_needed_or_not(whole: Path, tmp_path: Path, name: str) -> None:
    """Without it, or with another type, it is refused, or said in the report and logged."""
    run = read_run(whole / name)
    refused = 0
    path, kind = tmp_path / "summary.json", _Two if run.scene.fingers == 2 else _One
    for key in run.summary:
        rest = {other: value for other, value in run.summary.items() if other != key}
        for summary in (rest, *(rest | {key: value} for value in (None, "x", [1.0]))):
            path.write_text(json.dumps(summary), encoding="utf-8")
            try:
                read = _read_summary(path, kind)
            except UserError:
                refused += 1
                continue
            assert list(_words(run.scene, read, run.columns))
            assert list(_facts(run.scene, read))
    assert refused > 30
    table, path = pq.read_table(whole / name / "trace.parquet"), tmp_path / "trace.parquet"
    for at, column in enumerate(table.column_names):
        pq.write_table(table.remove_column(at), path)
        try:
            columns = read_trace(path, table.column_names)
        except UserError as refusal:
            sentence = str(refusal)
            assert f"has no column {column}" in sentence
        else:
            run_on_page(replace(run, columns=columns), "run")
            log_of(replace(run, columns=columns))


@pytest.mark.fuzz
@pytest.mark.parametrize("seed", [2, 3, 4])
def test_many_damages_are_refused_or_shown(whole: Path, tmp_path: Path, seed: int) -> None:
    assert check_damages(whole, seed, 500, tmp_path) > 250


@pytest.mark.parametrize("name", [*NEEDED, VIDEO, "frames/frames.csv", "frames/frame-000000.png"])
def test_a_link_that_leaves_is_read_only_where_that_is_asked_for(copy: Path, name: str) -> None:
    secret = copy.parent / "secret"
    (copy / name).rename(secret)
    (copy / name).symlink_to(secret)
    if name.startswith("frames"):
        with pytest.raises(UserError) as caught:
            write_logs_again([copy], ["mcap"])
        sentence = str(caught.value)
        assert not (copy / "run.mcap").exists()
    else:
        sentence = told(copy)
    assert sentence.startswith(
        f"{copy / name} is a link that leads out of its folder; give --follow"
    )
    write_reports([copy], follow_links=True)
    write_logs_again([copy], ["mcap"], follow_links=True)
    assert (copy / "report.html").is_file()


def test_frames_have_names_inside_their_folder(copy: Path) -> None:
    for name in ("../../secret", "/etc/passwd", "..", "../frames.csv"):
        (copy / "frames/frames.csv").write_text(f"frame,time_s,file\n0,0.0,{name}\n")
        with pytest.raises(UserError, match="expected a name inside the folder"):
            write_logs_again([copy], ["mcap"])


@pytest.mark.parametrize("name", [*NEEDED, VIDEO, "frames/frames.csv", "frames/frame-000000.png"])
def test_a_pipe_or_a_huge_file_holds_nobody_up(copy: Path, name: str) -> None:
    (copy / name).unlink()
    os.mkfifo(copy / name)
    kept = name in (VIDEO, "frames/frames.csv")  # a run may have none
    if kept:
        opened(copy)
    else:
        with pytest.raises(UserError, match=Path(name).name):
            opened(copy)
    (copy / name).unlink()
    with (copy / name).open("wb") as file:
        file.truncate(2**40)  # takes no place on the disk
    with pytest.raises(UserError, match=Path(name).name):
        opened(copy)


@pytest.mark.parametrize("name", ["report.html", "run.mcap"])
def test_nothing_is_written_through_a_link(copy: Path, name: str) -> None:
    """Neither the file nor the one that is written until it is whole."""
    for link in (name, part_of(copy / name).name):
        outside = copy.parent / "outside"
        outside.write_text("kept")
        (copy / link).symlink_to(outside)
        write_reports([copy])
        write_logs_again([copy], ["mcap"])
        assert outside.read_text() == "kept"
        assert not (copy / name).is_symlink()


def test_a_long_trace_is_refused_before_it_is_read(
    copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert told(copy, max_rows=6) == (
        f"{copy}/trace.parquet has 7 rows; a run has 1 to 6; for more give --max-rows N"
    )
    assert MOST_ROWS <= 10**8
    rows = MOST_ROWS + 1
    pq.write_table(pa.table({"time_s": pa.array(np.zeros(rows, "int8"))}), copy / "trace.parquet")
    monkeypatch.setattr(pq.ParquetFile, "read", None)
    assert f"has {rows} rows" in told(copy)


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("summary.json", b"{}", "Object missing required field `controller`"),
        ("trace.parquet", b"", "cannot be read as a trace: "),
        ("tactile.mp4", b"root:x:0:0", "cannot be read as a video"),
        ("scene.toml", b"a = ", "is not valid TOML"),
    ],
)
def test_a_damage_is_told(copy: Path, name: str, content: bytes, sentence: str) -> None:
    (copy / name).write_bytes(content)
    said = told(copy)
    assert sentence in said
    assert str(copy) in said
    assert name in said


def test_the_command_line_refuses_with_one_line(
    copy: Path, typed: Callable[..., Any], tmp_path: Path
) -> None:
    (copy / "trace.parquet").write_bytes(b"")
    for words in (("report", copy), ("report", copy, "--log", "mcap"), ("live", "--run", copy)):
        done = typed(*words)
        assert done.returncode == 2
        assert done.stderr.startswith(f"chromagrip: {copy}/trace.parquet cannot be read as a trace")
        assert done.stderr.count("\n") == 1
    shutil.copyfile(WRITTEN / "chain/trace.parquet", tmp_path / "elsewhere")
    (copy / "trace.parquet").unlink()
    (copy / "trace.parquet").symlink_to(tmp_path / "elsewhere")
    for words in (("report", copy), ("live", "--run", copy)):
        assert "--follow-links" in typed(*words).stderr
    assert typed("report", copy, "--follow-links").returncode == 0
    assert "--max-rows" in typed("report", copy, "--follow-links", "--max-rows", "3").stderr
