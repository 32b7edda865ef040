"""Frames that another program writes."""

from pathlib import Path

import numpy as np
import pytest

from chromagrip import UserError
from chromagrip.render import Frame
from chromagrip.sources import open_source, pipe_bytes


def written(path: Path, *arrays: np.ndarray, cut: int | None = None) -> str:
    with path.open("wb") as file:
        for array in arrays:
            np.save(file, array)
    path.write_bytes(path.read_bytes()[:cut])
    return f"pipe:{path}"


def test_pipes_are_read_frame_by_frame(tmp_path: Path) -> None:
    picture = np.arange(60, dtype=np.uint8).reshape(4, 5, 3)
    whole = written(tmp_path / "whole", np.float64(0.5), picture, np.float64(0.75), picture[::-1])
    first, second = open_source(whole).frames()
    assert (first.time, second.time) == (0.5, 0.75)
    np.testing.assert_array_equal(second.image, picture[::-1])
    cut = written(tmp_path / "cut", np.float64(0.5), picture, np.float64(0.75), picture, cut=-9)
    with pytest.raises(UserError, match="breaks off after 1 frames"):
        list(open_source(cut).frames())
    wrong = written(tmp_path / "wrong", np.float64(0.5), picture.astype(np.float32))
    with pytest.raises(UserError, match=r"float32 \(4, 5, 3\); wanted: a time, then a picture"):
        list(open_source(wrong).frames())
    with pytest.raises(UserError, match="pipe:/nowhere cannot be read: No such file"):
        list(open_source("pipe:/nowhere").frames())


def test_the_bytes_of_a_program_are_read_as_they_were_written(tmp_path: Path) -> None:
    frames = [
        Frame(image=np.full((4, 5, 3), 40 * k, np.uint8), time=0.25 * k * k) for k in range(3)
    ]
    (tmp_path / "pipe").write_bytes(b"".join(map(pipe_bytes, frames)))
    source = open_source(f"pipe:{tmp_path / 'pipe'}")
    for read, frame in zip(source.frames(), frames, strict=True):
        assert read.time == frame.time
        np.testing.assert_array_equal(read.image, frame.image)
    assert (source.timed, source.live) == (True, False)


def test_times_that_go_back_are_one_sentence(tmp_path: Path) -> None:
    picture = np.zeros((4, 5, 3), np.uint8)
    name = written(tmp_path / "back", *[np.float64(0.5), picture], *[np.float64(0.25), picture])
    frames = open_source(name).frames()
    assert next(frames).time == 0.5
    with pytest.raises(UserError, match=r"frame 1 of pipe:.* the time 0.25 s, the one before 0.5"):
        next(frames)
