"""Files and folders that are complete or not there."""

from contextlib import suppress
from functools import partial

import numpy as np
import pyarrow.parquet as pq
import pytest

from chromagrip.errors import UserError
from chromagrip.folders import LOCK, part_of, prepared, whole_file, whole_folder, write_whole
from chromagrip.output.parquet import FORCES, EstimateTable
from chromagrip.output.video import VideoFile


def fill(folder, overwrite):
    with prepared(folder, overwrite):
        pass


def video(path, count=60):
    with VideoFile(path, 30, 20) as file:
        for k in range(count):
            file.append(np.random.default_rng(k).integers(0, 255, (240, 320, 3), dtype=np.uint8))


def estimates(path):
    with EstimateTable(path, FORCES) as table:
        for k in range(2500):
            table.add({"frame": k, "node_normal_n": list(range(100))})


@pytest.mark.parametrize("write", [video, estimates, lambda path: write_whole(path, b"x" * 10**6)])
def test_a_full_disk_is_one_sentence_and_leaves_nothing(write, tmp_path, small_files):
    small_files(4000)
    with pytest.raises(UserError, match=r"result.bin cannot be written: File too large"):
        write(tmp_path / "result.bin")
    assert not list(tmp_path.iterdir())


def test_a_strangers_link_is_not_written_through(tmp_path):
    """A folder that is written to may be one that somebody else made."""
    (tmp_path / "theirs").write_text("kept")
    part_of(tmp_path / "result.bin").symlink_to(tmp_path / "theirs")
    write_whole(tmp_path / "result.bin", b"x")
    assert (tmp_path / "theirs").read_text() == "kept"
    assert not (tmp_path / "result.bin").is_symlink()


@pytest.mark.parametrize("write", [partial(video, count=1), video, estimates])
def test_what_was_written_has_its_name(write, tmp_path):
    write(tmp_path / "result.bin")
    assert [path.name for path in tmp_path.iterdir()] == ["result.bin"]


def test_a_video_without_pictures_leaves_nothing(tmp_path):
    with VideoFile(tmp_path / "none.mp4", 30, 20):
        pass
    assert not list(tmp_path.iterdir())


def test_an_interrupted_table_keeps_its_rows(tmp_path):
    with suppress(KeyboardInterrupt), EstimateTable(tmp_path / "e.parquet", FORCES) as table:
        table.add({"frame": 7})
        raise KeyboardInterrupt
    assert pq.read_table(tmp_path / "e.parquet")["frame"].to_pylist() == [7]


def test_a_file_that_fails_leaves_the_one_before(tmp_path):
    path = tmp_path / "notes.txt"
    write_whole(path, b"before")
    with suppress(KeyError), whole_file(path) as part:
        part.write_bytes(b"half of what")
        raise KeyError
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_has_its_name_when_it_is_complete(tmp_path):
    folder = tmp_path / "data"
    with suppress(KeyError), prepared(folder, None), whole_folder(folder) as part:
        (part / "one").write_text("1")
        raise KeyError
    assert not list(folder.iterdir())
    with prepared(folder, None), whole_folder(folder) as part:
        (part / "one").write_text("1")
        assert [path.name for path in folder.iterdir()] == [LOCK]
    assert [path.name for path in folder.iterdir()] == ["one"]
    assert list(tmp_path.iterdir()) == [folder]


def test_of_two_processes_that_fill_a_folder_the_faster_one_wins(tmp_path):
    with whole_folder(tmp_path / "data") as part:
        (part / "own").write_text("late")
        (tmp_path / "data").mkdir()
        (tmp_path / "data" / "other").write_text("early")
    assert [path.name for path in (tmp_path / "data").iterdir()] == ["other"]


def test_a_folder_that_holds_files_is_refused_unless_told_otherwise(tmp_path):
    (tmp_path / "old").write_text("result")
    with pytest.raises(UserError, match=r"is not empty; choose another or give --overwrite"):
        fill(tmp_path, overwrite=False)
    fill(tmp_path, overwrite=True)
    with pytest.raises(UserError, match=r"old is a file, not a folder"):
        fill(tmp_path / "old", overwrite=True)
