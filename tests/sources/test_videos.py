"""Videos as capture cards and several cameras leave them."""

from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromagrip import UserError
from chromagrip.sources import open_source
from chromagrip.sources.interlaced import Rows, rows_apart

av = pytest.importorskip("av")


def dots(at: tuple[float, float], levels: tuple[float, float] = (190.0, 40.0)) -> np.ndarray:
    """Picture of blurred dots on a grid whose corner lies at a place [px], (180, 240)."""
    y, x = np.mgrid[:180, :240]
    apart = [(v - start + 13.0) % 26.0 - 13.0 for v, start in zip((x, y), at, strict=True)]
    cover = 0.5 - 0.5 * np.tanh(np.hypot(*apart) - 6.0)
    return np.asarray(levels[0] + (levels[1] - levels[0]) * cover)


def woven(one: np.ndarray, other: np.ndarray, noise: float, seed: int = 0) -> np.ndarray:
    """Picture with the even rows of one picture and the odd ones of another, (H, W, 3)."""
    both = one.copy()
    both[1::2] = other[1::2]
    both += np.random.default_rng(seed).normal(0.0, noise, both.shape)
    return np.repeat(np.clip(np.rint(both), 0, 255).astype(np.uint8)[..., None], 3, axis=2)


@settings(max_examples=15)
@given(
    motion=st.floats(0.3, 2.5),
    angle=st.floats(0.0, 2.0 * np.pi),
    noise=st.floats(0.0, 3.0),
    corner=st.tuples(st.floats(0.0, 26.0), st.floats(0.0, 26.0)),
)
def test_the_motion_between_rows_is_measured(
    motion: float, angle: float, noise: float, corner: tuple[float, float]
) -> None:
    later = (corner[0] + motion * np.cos(angle), corner[1] + motion * np.sin(angle))
    apart = rows_apart(woven(dots(corner), dots(later), noise))
    assert apart == pytest.approx(motion, rel=0.35, abs=0.08)
    assert rows_apart(woven(dots(corner), dots(corner), noise)) < 0.08


@pytest.mark.parametrize(
    ("interlaced", "quality"),
    [(True, 30), (False, 30), pytest.param(True, None, marks=pytest.mark.data)],
)
def test_interlaced_frames_are_said(interlaced: bool, quality: int | None) -> None:
    """At rest first, then faster and faster, up to 3 px a frame."""
    rows = Rows()
    for k in range(120):
        way, later = (0.015 * max(0.0, k - start) ** 2 for start in (20.0, 19.5))
        one, other = dots((3.0 + way, 5.0)), dots((3.0 + (later if interlaced else way), 5.0))
        image = woven(one, other, noise=1.5, seed=k)
        if quality is not None:
            coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
            image = np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)
        rows.add(image)
    assert ("interlaced" in rows.doubt) == interlaced


def test_frames_that_look_like_nothing_are_not_interlaced() -> None:
    random = np.random.default_rng(5)
    rows = Rows()
    for k in range(100):
        rows.add(random.integers(0, 256, (60, 80, 3), dtype=np.uint8) if k % 2 else
                 np.full((60, 80, 3), k, np.uint8))  # fmt: skip
    assert rows.doubt == ""


def video(path: Path, rate: int = 30, streams: int = 1, cover: bool = False) -> str:
    """Video of 6 grey frames in each of its streams, with a cover if that is asked."""
    with av.open(str(path), "w") as container:
        made = [container.add_stream("mpeg4", rate=rate) for _ in range(streams)]
        for stream in made:
            stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        if cover:
            picture = container.add_stream("png", rate=1)
            picture.width, picture.height, picture.pix_fmt = 64, 48, "rgb24"
            picture.disposition = av.stream.Disposition.attached_pic
        for k in range(6):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 20 * k, np.uint8))
            for stream in made:
                container.mux(stream.encode(frame))
        for stream in made:
            container.mux(stream.encode(None))
        if cover:
            container.mux(picture.encode(av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), "u1"))))
    return str(path)


def test_a_file_with_two_videos_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="holds 2 videos"):
        open_source(video(tmp_path / "pair.mkv", streams=2))
    assert len(list(open_source(video(tmp_path / "one.mkv")).frames())) == 6


def test_a_cover_is_no_second_video(tmp_path: Path) -> None:
    frames = list(open_source(video(tmp_path / "cover.mp4", cover=True)).frames())
    assert [frame.image.shape for frame in frames] == [(48, 64, 3)] * 6


def test_a_rate_that_few_cameras_have_is_doubted(tmp_path: Path) -> None:
    assert "give yours" in open_source(video(tmp_path / "clock.mkv", rate=1000)).fps_from
    assert open_source(video(tmp_path / "clock.mkv", rate=1000), fps=1000).fps_from == "given"
    assert "give yours" not in open_source(video(tmp_path / "fast.mkv", rate=240)).fps_from


def test_pixels_that_are_no_squares_and_transparent_ones_are_said(tmp_path: Path) -> None:
    assert open_source(video(tmp_path / "plain.mkv")).doubt == ""
    for name, codec, form, words in (
        ("wide.mkv", "mpeg4", "yuv420p", "1.45 times as wide as high"),
        ("clear.mkv", "ffv1", "bgra", "transparency"),
    ):
        with av.open(str(tmp_path / name), "w") as container:
            stream = container.add_stream(codec, rate=30)
            stream.width, stream.height, stream.pix_fmt = 64, 48, form
            if "wide" in words:
                stream.codec_context.sample_aspect_ratio = Fraction(16, 11)
            frame = av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8))
            container.mux(stream.encode(frame))
            container.mux(stream.encode(None))
        assert words in open_source(str(tmp_path / name)).doubt
