"""A folder of pictures with a list of their times: `frames.csv`."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from chromagrip import UserError
from chromagrip.sources import open_source

#: Pictures, and times at a rate that varies.
PICTURES = np.random.default_rng(8).integers(0, 256, (5, 4, 7, 3), dtype=np.uint8)
TIMES = [0.5, 0.51, 0.54, 0.62, 0.9]


@pytest.fixture
def shots(tmp_path: Path) -> Path:
    """Pictures 0 to 4, and their list; the last picture has the first number."""
    for k, image in enumerate(PICTURES):
        cv2.imwrite(str(tmp_path / f"shot-{(k + 1) % 5}.png"), image[..., ::-1])
    cv2.imwrite(str(tmp_path / "rest.png"), PICTURES[0])
    write(tmp_path)
    return tmp_path


def write(folder: Path, names: str = "frame,time_s,file", begin: str = "", **lines: str) -> None:
    """Write the list; `lines` replaces some, such as line2."""
    rows = [f"{k},{time},shot-{(k + 1) % 5}.png" for k, time in enumerate(TIMES)]
    rows = [lines.get(f"line{k}", row) for k, row in enumerate(rows, 2)]
    text = "\n".join([names, *filter(None, rows), *filter(None, [lines.get("line7")])])
    (folder / "frames.csv").write_text(begin + text + "\n", encoding="utf-8")


def test_pictures_have_the_times_and_the_order_of_their_list(shots: Path) -> None:
    source = open_source(str(shots))
    frames = list(source.frames())
    np.testing.assert_array_equal(np.array([frame.image for frame in frames]), PICTURES)
    assert [frame.time for frame in frames] == TIMES
    assert source.timed
    assert source.fps == pytest.approx(4 / 0.4)  # gaps over the time from first to last
    assert source.fps_from == "the times in frames.csv"
    assert source.frame_name(4).endswith("(shot-0.png)")


def test_a_given_rate_and_a_pattern_leave_the_list_out(shots: Path) -> None:
    for source in open_source(str(shots), fps=10.0), open_source(f"{shots}/shot-*.png", fps=10.0):
        assert not source.timed
        frames = list(source.frames())
        assert [frame.time for frame in frames] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
        np.testing.assert_array_equal(frames[0].image, PICTURES[4])
    (shots / "frames.csv").write_text("nonsense")
    assert len(list(open_source(str(shots), fps=10.0).frames())) == 5


def test_the_rest_picture_may_be_listed_and_is_no_frame(shots: Path) -> None:
    source = open_source(str(shots), without=shots / "shot-1.png")
    assert [frame.time for frame in source.frames()] == TIMES[1:]
    write(shots, line7="5,1.0,rest.png", begin="\ufeff")  # as a spreadsheet writes it
    assert [frame.time for frame in open_source(str(shots)).frames()] == TIMES


def test_a_list_that_does_not_fit_is_one_sentence(shots: Path) -> None:
    for line, words in (
        ("2,0.51,shot-3.png", r"line 4 has the time_s '0.51', after 0.51 s; wanted: times"),
        ("", r"frames.csv has no line for 1 of 5 pictures, such as shot-3.png; mend the"),
        ("2,0.54,../shot-1.png", r"names ../shot-1.png, which is not in its folder; mend the"),
        ("2,0.54,shot-1.png", r"frames.csv names shot-1.png, twice"),
    ):
        write(shots, line4=line)
        with pytest.raises(UserError, match=words):
            open_source(str(shots))
