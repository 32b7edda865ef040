"""Frames that another program writes; what it promises as a source is in the contract."""

from pathlib import Path

import numpy as np
import pytest

from chromagrip import UserError
from chromagrip.sources import open_source


def written(path: Path, *arrays: np.ndarray, cut: int | None = None) -> str:
    with path.open("wb") as file:
        for array in arrays:
            np.save(file, array)
    path.write_bytes(path.read_bytes()[:cut])
    return f"pipe:{path}"


def test_what_is_no_frame_is_one_sentence(tmp_path: Path) -> None:
    picture, path = np.arange(60, dtype=np.uint8).reshape(4, 5, 3), tmp_path / "pipe"
    half, quarter = np.float64(0.5), np.float64(0.25)
    for arrays, cut, words, count in (
        ([half, picture, np.float64(0.75), picture], -9, "breaks off after 1 frames", 1),
        ([half, picture.astype(np.float32)], None,
         r"float32 \(4, 5, 3\); wanted: a time, then a picture", 0),
        ([half, picture, quarter, picture], None,
         r"frame 1 of pipe:.* the time 0.25 s, the one before 0.5", 1),
    ):  # fmt: skip
        seen = []
        with pytest.raises(UserError, match=words):
            seen.extend(open_source(written(path, *arrays, cut=cut)).frames())
        assert len(seen) == count
    with pytest.raises(UserError, match="pipe:/nowhere cannot be read: No such file"):
        list(open_source("pipe:/nowhere").frames())
    with pytest.raises(UserError, match=r"expected pipe:FILE or pipe:FILE\(live=true\)"):
        open_source("pipe:a(live=3)")
    assert open_source("pipe:a(live=true)").live
