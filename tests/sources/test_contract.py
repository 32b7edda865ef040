"""What every kind of source promises: its frames in order, as written, again and again."""

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import av
import cv2
import numpy as np
import pytest

from chromagrip import UserError
from chromagrip.render import Frame
from chromagrip.sources import SOURCES, Source, open_source, pipe_bytes
from chromagrip.sources.feed import Feed
from chromagrip.sources.source import SHIPPED

#: Pictures, not square, without any symmetry.
PICTURES = np.random.default_rng(6).integers(0, 256, (4, 24, 32, 3), dtype=np.uint8)
#: Their times where a source has some: one frame is missing [s].
TIMES = [0.25, 0.35, 0.45, 0.65]


@dataclass(frozen=True)
class Kind:
    """A source of `PICTURES`."""

    source: Any
    times: list[float]  # of its frames [s]; empty for times of a clock
    live: bool = False
    known: bool = True  # the number of its frames, beforehand
    breaks: bool = False  # at its end

    @property
    def timed(self) -> bool:
        return self.times != even(30.0)

    def frames(self, source: Source) -> list[Frame]:
        """All frames of a source of this kind."""
        found: list[Frame] = []
        if self.breaks:
            with pytest.raises(UserError):
                found.extend(source.frames())
        else:
            found.extend(source.frames())
        return found


def even(fps: float) -> list[float]:
    return [k / fps for k in range(len(PICTURES))]


class Camera:
    """Stands in for OpenCV's capture; it vanishes after the last picture."""

    released: ClassVar[int] = 0

    def __init__(self, number: int) -> None:
        self.left = list(PICTURES)

    def isOpened(self) -> bool:  # noqa: N802
        return True

    def get(self, key: int) -> float:
        return 0.0

    def read(self) -> tuple[bool, Any]:
        time.sleep(0.002)
        return (True, self.left.pop(0)[..., ::-1]) if self.left else (False, None)

    def release(self) -> None:
        type(self).released += 1


class Own:
    """A source of one's own, which writes each picture into the same memory."""

    closed: ClassVar[int] = 0

    def __init__(self) -> None:
        self.left = list(zip(PICTURES, TIMES, strict=True))
        self.memory = np.zeros_like(PICTURES[0])

    def read(self) -> tuple[np.ndarray, float] | None:
        if not self.left:
            return None
        self.memory[:], instant = self.left.pop(0)
        return self.memory, instant

    def close(self) -> None:
        type(self).closed += 1


def folder(place: Path) -> Path:
    for k, image in enumerate(PICTURES):
        cv2.imwrite(str(place / f"{k + 8}.png"), image[..., ::-1])  # 10 follows 9
    return place


def picture(place: Path) -> Kind:
    from PIL import Image

    first, *others = map(Image.fromarray, PICTURES)
    first.save(place / "pages.tif", save_all=True, append_images=others)
    return Kind(place / "pages.tif", even(30.0))


def video(place: Path) -> Kind:
    with av.open(str(place / "a.mkv"), "w") as container:
        stream = container.add_stream("ffv1", rate=20)
        stream.width, stream.height, stream.pix_fmt = 32, 24, "bgr0"
        for k, image in enumerate(PICTURES):
            frame = av.VideoFrame.from_ndarray(image).reformat(format="bgr0")
            frame.pts = k
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return Kind(place / "a.mkv", even(20.0), known=False)


def pipe(place: Path) -> Kind:
    frames = [Frame(image=i, time=t) for i, t in zip(PICTURES, TIMES, strict=True)]
    (place / "pipe").write_bytes(b"".join(map(pipe_bytes, frames)))
    return Kind(f"pipe:{place / 'pipe'}", TIMES, known=False)


def array(place: Path) -> Kind:
    np.save(place / "a.npy", PICTURES)
    return Kind(place / "a.npy", even(30.0))


def archive(place: Path) -> Kind:
    np.savez_compressed(place / "a.npz", images=PICTURES, times=TIMES, other=np.zeros(3))
    return Kind(place / "a.npz", TIMES)


def bag(place: Path) -> Kind:
    pytest.importorskip("rosbags")
    from .test_bags import bag as write_bag
    from .test_bags import raw

    messages = [(9.0 + t, raw(i, "bgr8", 5.0 + t)) for i, t in zip(PICTURES, TIMES, strict=True)]
    return Kind(write_bag(place / "bag", image=messages), [t - TIMES[0] for t in TIMES])


#: Makers of a source of each kind, by the names of `chromagrip list sources`.
KINDS: dict[str, Callable[[Path], Kind]] = {
    "camera:N": lambda place: Kind("camera:0", [], live=True, known=False, breaks=True),
    "PICTURE": picture,
    "FOLDER": lambda place: Kind(folder(place), even(30.0)),
    "'DIR/*.png'": lambda place: Kind(f"{folder(place)}/*.png", even(30.0)),
    "VIDEO": video,
    "pipe:FILE": pipe,
    "FILE.npy": array,
    "FILE.npz": archive,
    "BAG": bag,
    "MODULE:CLASS": lambda place: Kind(Own, TIMES, live=True, known=False),
}


def test_every_kind_has_its_contract() -> None:
    assert KINDS.keys() == SHIPPED.keys()
    assert SOURCES.descriptions().keys() <= KINDS.keys()


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Kind:
    monkeypatch.setattr(cv2, "VideoCapture", Camera)
    monkeypatch.setattr(Camera, "released", 0)
    monkeypatch.setattr(Own, "closed", 0)
    return KINDS[request.param](tmp_path)


def opened(kind: Kind, **more: Any) -> Source:
    source = kind.source
    return open_source(str(source) if isinstance(source, Path) else source, **more)


def test_the_frames_come_in_order_as_they_were_written(kind: Kind) -> None:
    source = opened(kind)
    assert (source.live, source.timed) == (kind.live, kind.timed)
    assert source.count == len(PICTURES) if kind.known else source.count in (None, len(PICTURES))
    for _ in range(2):  # each time from the first one
        frames = kind.frames(source)
        for frame, image in zip(frames, PICTURES, strict=True):
            np.testing.assert_array_equal(frame.image, image)  # size, order of rows and colours
            assert frame.image.dtype == np.uint8
            assert frame.image.flags.writeable
        times = [frame.time for frame in frames]
        assert (np.diff(times) > 0.0).all()
        assert not kind.times or times == pytest.approx(kind.times, abs=1e-9)
    assert source.delivery.counts["repeated"] in (0, None)


def test_a_given_rate_is_the_rate(kind: Kind) -> None:
    source = opened(kind, fps=50.0)
    assert (source.fps, source.fps_from) == (50.0, "given")
    if not source.timed:
        assert [frame.time for frame in kind.frames(source)] == pytest.approx(even(50.0))
    assert source.timed == (kind.live or str(kind.source).startswith("pipe:"))


def test_the_end_stays_the_end_and_closing_twice_is_fine(kind: Kind) -> None:
    frames: Any = opened(kind).frames()
    for _ in PICTURES:
        next(frames)
    with pytest.raises(UserError if kind.breaks else StopIteration):
        next(frames)
    for _ in range(3):
        assert next(frames, None) is None
    early: Any = opened(kind).frames()
    next(early)
    for one in (frames, early):
        one.close()
        one.close()
        assert next(one, None) is None
    assert Camera.released == (2 if kind.source == "camera:0" else 0)
    assert Own.closed == (2 if kind.source is Own else 0)


def test_a_slow_loop_gets_the_newest_frame_of_a_camera_and_all_of_others(kind: Kind) -> None:
    source = opened(kind)
    feed = Feed(source, 5.0)
    got: list[Frame] = []
    try:
        if kind.live:
            end = time.monotonic() + 5.0
            while feed.skipped < len(PICTURES) - 1 and time.monotonic() < end:
                time.sleep(0.005)
        while (frame := feed.next()) is not None:
            got.append(frame)
    except UserError:
        assert kind.breaks
    feed.close()
    wanted = PICTURES[-1:] if kind.live else PICTURES
    np.testing.assert_array_equal(np.array([frame.image for frame in got]), wanted)
    assert feed.skipped == (len(PICTURES) - 1 if kind.live else 0)


def test_a_camera_that_stalls_is_one_sentence() -> None:
    stop = threading.Event()

    def stalling() -> Iterator[Frame]:
        yield Frame(image=PICTURES[0], time=0.0)
        stop.wait(20.0)

    feed = Feed(Source(name="camera:7", frames=stalling, count=None, fps=100.0), 0.2)
    assert feed.next() is not None
    with pytest.raises(UserError, match=r"^camera:7 gave no frame within 0\.2 s after 1 frames$"):
        feed.next()
    feed.close()
    stop.set()


@pytest.mark.parametrize(
    ("arrays", "cut", "words", "count"),
    [
        ([0.5, PICTURES[0], 0.75, PICTURES[0]], -9, "breaks off after 1 frames", 1),
        ([0.5, PICTURES[0] / 2.0], None, r"float64 \(24, 32, 3\); wanted: a time, then a pict", 0),
        ([0.5, PICTURES[0], 0.25, PICTURES[0]], None, "the time 0.25 s, the one before 0.5", 1),
    ],
)
def test_a_pipe_that_gives_no_frame_is_one_sentence(
    arrays: list[Any], cut: int | None, words: str, count: int, tmp_path: Path
) -> None:
    with (tmp_path / "pipe").open("wb") as file:
        for one in arrays:
            np.save(file, one)
    (tmp_path / "pipe").write_bytes((tmp_path / "pipe").read_bytes()[:cut])
    seen: list[Frame] = []
    with pytest.raises(UserError, match=words):
        seen.extend(open_source(f"pipe:{tmp_path / 'pipe'}").frames())
    assert len(seen) == count
