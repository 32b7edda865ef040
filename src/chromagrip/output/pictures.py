"""Frames from files, cameras and pipes: a picture, a folder of them, a video file, `camera:0`."""

import io
import math
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from ..extras import need
from ..render import Frame
from ..stored_pictures import MEGAPIXELS, MORE, check_pixels, decoded

if TYPE_CHECKING:
    import av

Image = NDArray[np.uint8]

#: Rate of sources that have none of their own [Hz].
DEFAULT_FPS = 30.0
#: Where a rate comes from.
GIVEN, ASSUMED = "given", "assumed; give yours with --fps"
SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
_LOSSY = (".jpg", ".jpeg")
_KINDS = "a picture, a folder of pictures, a video file, pipe:FILE or camera:0"
PNG_BEGIN = b"\x89PNG"
PNG_END = b"IEND\xaeB`\x82"


@dataclass(frozen=True, kw_only=True)
class Source:
    """Source of frames.

    Attributes
    ----------
    name: that the user gave
    frames: iterates over the frames, at each call from the first one; raises UserError where they
        break off
    count: number of frames; None where it is not known beforehand
    fps: rate [Hz], nominal where frames carry their own times
    fps_from: where the rate comes from, in words
    live: whether it is a camera, which gives no frame twice
    lossy: whether its compression leaves errors in the pictures
    files: of its frames; empty where they have none of their own
    """

    name: str
    frames: Callable[[], Iterator[Frame]]
    count: int | None
    fps: float
    fps_from: str = GIVEN
    live: bool = False
    lossy: bool = False
    files: tuple[Path, ...] = ()

    def frame_name(self, index: int) -> str:
        """What a frame is called in a message, with its file if that is not the source itself."""
        name = f"frame {index} of {self.name}"
        own = self.files[index] if index < len(self.files) else Path(self.name)
        return name if own == Path(self.name) else f"{name} ({own.name})"


def open_source(
    name: str,
    fps: float | None = None,
    without: Path | None = None,
    max_megapixels: float = MEGAPIXELS,
) -> Source:
    """Source of that name; `fps` [Hz] sets the rate of pictures, and overrides a video's own.

    A picture `without` is no frame of the folder that it lies in, nor is one that is called rest
    beside others. Larger pictures than `max_megapixels` are refused before they are decoded.

    Raises
    ------
    UserError
        When there is no such thing, or no picture in it.
    """
    path = Path(name)
    if name.startswith("pipe:"):
        pipe = name.removeprefix("pipe:")
        return Source(
            name=name,
            frames=lambda: _pipe_frames(pipe, max_megapixels),
            count=None,
            fps=fps or DEFAULT_FPS,
            fps_from=ASSUMED if fps is None else GIVEN,
        )
    if re.fullmatch(r"camera:\d+", name):
        number = int(name.removeprefix("camera:"))
        return Source(
            name=name,
            frames=lambda: _camera_frames(number),
            count=None,
            fps=fps or DEFAULT_FPS,
            fps_from="nominal" if fps is None else GIVEN,
            live=True,
        )
    if path.is_dir():
        _refuse_home(path)
        files = [p for p in path.iterdir() if is_picture(p) and not p.name.startswith(".")]
        if not files:
            raise UserError(f"folder {name} has no pictures; expected {', '.join(SUFFIXES)} files")
        left = [p for p in files if without is None or not p.samefile(without)]
        left = [p for p in left if p.stem.lower() != "rest"] or left
        if not left:
            raise UserError(f"folder {name} has no pictures but {without}")
        return _pictures(name, sorted(left, key=_natural), fps, max_megapixels)
    if not path.is_file():
        raise UserError(f"there is no {name}; give {_KINDS}")
    if is_picture(path):
        return _pictures(name, [path], fps, max_megapixels)
    return _video(path, fps, max_megapixels)


def _refuse_home(folder: Path) -> None:
    """Refuse a run and a dataset, whose pictures of frames lie further down."""
    traces = (folder / f"trace{suffix}" for suffix in (".parquet", ".npz"))
    if (folder / "summary.json").is_file() and any(trace.is_file() for trace in traces):
        kept = folder / "frames"
        frames = kept if kept.is_dir() else folder / "tactile.mp4"
        raise UserError(f"folder {folder} is a run, whose frames are in {frames}: give that")
    if (folder / "manifest.json").is_file() and any(folder.glob("sequence-*")):
        one = min(folder.glob("sequence-*"))
        raise UserError(f"folder {folder} is a dataset: give one of its sequences, such as {one}")

    if (folder / "noise.json").is_file() and (folder / "clean.png").is_file():
        raise UserError(
            f"folder {folder} keeps its pictures without noise (store clean): make the dataset "
            "with --store noisy, or take the pictures of `chromagrip dataset export`"
        )


def is_picture(path: Path) -> bool:
    """Whether a file is named like a picture."""
    return path.suffix.lower() in SUFFIXES


def read_picture(path: Path, max_megapixels: float = MEGAPIXELS) -> Image:
    """Picture of a file, sRGB, shape (H, W, 3); a grey one has three equal channels.

    It is as it was stored, not turned by the file's metadata. A larger one than `max_megapixels`
    is not decoded.

    Raises
    ------
    UserError
        When the file is no complete picture, is too large, has more than 8 bits a channel, or is
        transparent.
    """
    name = f"picture {path}"
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UserError(f"{name} cannot be read: {error.strerror}") from None
    if not data:
        raise UserError(f"{name} is empty (0 bytes)")
    image = decoded(data, name, max_megapixels)
    if image is None:
        kind = path.suffix.lower().removeprefix(".")
        raise UserError(f"{name} cannot be read: it is cut off, or not a {kind} file")
    if isinstance(image, str):
        raise UserError(
            f"{name} has {image} values; wanted: 8 bits a channel, because the range of wider "
            "values is not known"
        )
    if image.ndim == 3 and image.shape[2] == 4 and (image[..., 3] < 255).any():
        raise UserError(f"{name} has transparent pixels; wanted: an opaque picture")
    if image.ndim == 2:
        return np.repeat(image[..., None], 3, axis=2)
    return np.ascontiguousarray(image[..., :3])


def _natural(path: Path) -> list[tuple[int, str]]:
    """Key that sorts frame-2 before frame-10."""
    parts = re.findall(r"\d+|\D+", path.name)
    return [(int(p), "") if p.isdecimal() else (-1, p.lower()) for p in parts]


@contextmanager
def _silent() -> Iterator[None]:
    """Keep OpenCV from writing to the terminal; our own error says what failed."""
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)


def _pictures(name: str, files: list[Path], fps: float | None, max_megapixels: float) -> Source:
    rate = fps or DEFAULT_FPS

    def frames() -> Iterator[Frame]:
        for k, path in enumerate(files):
            yield Frame(image=read_picture(path, max_megapixels), time=k / rate)

    lossy = any(path.suffix.lower() in _LOSSY for path in files)
    return Source(
        name=name,
        frames=frames,
        count=len(files),
        fps=rate,
        fps_from=ASSUMED if fps is None else GIVEN,
        lossy=lossy,
        files=tuple(files),
    )


def _camera_frames(number: int) -> Iterator[Frame]:
    """Frames as they come, with the time since the first one."""
    with _silent():
        capture = cv2.VideoCapture(number)
    try:
        if not capture.isOpened():
            raise UserError(f"camera {number} cannot be opened; is it there, free and allowed?")
        begin, count = 0.0, 0
        while True:
            with _silent():
                found, image = capture.read()
            now = time.monotonic()
            if not found:
                raise UserError(f"camera {number} gave no picture after {count} frames")
            begin = now if count == 0 else begin
            count += 1
            yield Frame(image=np.ascontiguousarray(image[..., ::-1], np.uint8), time=now - begin)
    finally:
        capture.release()


def pipe_bytes(frame: Frame) -> bytes:
    """Bytes that a program writes for a frame into a pipe, which is read as `pipe:FILE`."""
    data = io.BytesIO()  # NumPy cannot write into a pipe
    np.save(data, np.float64(frame.time))
    np.save(data, frame.image)
    return data.getvalue()


def _pipe_frames(name: str, max_megapixels: float) -> Iterator[Frame]:
    """Frames that another program writes: time [s] and picture of each, as NumPy's .npy files.

    A `-` is the standard input.
    """
    count = 0
    try:
        with open(0 if name == "-" else name, "rb", closefd=name != "-") as file:
            while file.peek(1):
                try:
                    time, image = (_piped(file, name, max_megapixels) for _ in range(2))
                except UserError:
                    raise
                except (ValueError, EOFError) as error:
                    raise UserError(
                        f"pipe:{name} breaks off after {count} frames: {error}"
                    ) from None
                if time.ndim or image.dtype != np.uint8 or image.shape[2:] != (3,):
                    raise UserError(
                        f"pipe:{name} gave {time.dtype} {time.shape} and {image.dtype} "
                        f"{image.shape}; wanted: a time, then a picture uint8 (H, W, 3)"
                    )
                count += 1
                yield Frame(image=image, time=float(time))
    except OSError as error:
        raise UserError(f"pipe:{name} cannot be read: {error.strerror}") from None


def _piped(file: BinaryIO, name: str, max_megapixels: float) -> NDArray[Any]:
    """Array of a pipe; NumPy would ask a file for its place, which a pipe does not have."""
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0
    if version != (1, 0):
        read = np.lib.format.read_array_header_2_0
    shape, turned, kind = read(file)
    height, width = (*shape, 1, 1)[:2]
    check_pixels(width, height, f"pipe:{name}", max_megapixels)
    size = math.prod(shape) * kind.itemsize
    if kind.hasobject or size > 3e6 * max_megapixels:
        raise ValueError(f"{kind} {shape} is no picture")
    data = file.read(size)
    if len(data) < size:
        raise EOFError(f"{len(data)} of {size} bytes")
    return np.frombuffer(data, kind).reshape(shape, order="F" if turned else "C").copy()


def _video(path: Path, fps: float | None, max_megapixels: float) -> Source:
    with _open_video(path, max_megapixels) as container:
        stream = container.streams.video[0]
        stream_rate = stream.average_rate
        rate = fps or float(stream_rate or DEFAULT_FPS)
        count, lossy = stream.frames or None, stream.codec_context.codec.lossy
    return Source(
        name=str(path),
        frames=lambda: _video_frames(path, fps, max_megapixels),
        count=count,
        fps=rate,
        fps_from=("the video's own" if stream_rate else ASSUMED) if fps is None else GIVEN,
        lossy=lossy,
    )


@contextmanager
def _open_video(path: Path, max_megapixels: float) -> "Iterator[av.container.InputContainer]":
    av = need("av", "video")
    if path.stat().st_size == 0:
        raise UserError(f"video {path} is empty (0 bytes)")
    try:
        most = {"max_pixels": str(round(1e6 * max_megapixels))}  # also where sizes change later
        container = av.open(str(path), options=most, metadata_errors="ignore")
    except av.FFmpegError as error:
        raise UserError(
            f"{path} cannot be read as a video: {_reason(error)}; give {_KINDS}"
        ) from None
    with container:
        # FFmpeg reads any text as a recording of a terminal.
        if not container.streams.video or container.format.name == "tty":
            raise UserError(f"{path} has no video in it; give {_KINDS}")
        coded = container.streams.video[0].codec_context
        if coded is None:
            raise UserError(f"{path} holds a video of an unknown kind; give {_KINDS}")
        if not coded.width:  # FFmpeg took none that is too large
            raise UserError(
                f"video {path} names no size, or has pictures of more than {max_megapixels:g} "
                f"megapixels{MORE}"
            )
        check_pixels(coded.width, coded.height, f"video {path}", max_megapixels)
        coded.options = most
        yield container


def _reason(error: "av.FFmpegError") -> str:
    text = str(error.strerror).lower()
    return f"{text} (cut off, or not a video)" if "invalid data" in text else text


def _video_frames(path: Path, fps: float | None, max_megapixels: float) -> Iterator[Frame]:
    """Frames with the file's own times, or evenly at `fps`; a UserError where it is cut off."""
    av = need("av", "video")
    with _open_video(path, max_megapixels) as container:
        stream = container.streams.video[0]
        rate = float(stream.average_rate or DEFAULT_FPS)
        count, first, last = 0, 0.0, 0.0

        def broken(why: str) -> UserError:
            expected = f" of {stream.frames}" if stream.frames else ""
            return UserError(f"video {path} breaks off after {count}{expected} frames: {why}")

        try:
            for picture in container.decode(stream):
                if picture.is_corrupt:
                    raise broken("the next one is damaged")
                last = count / rate if picture.time is None else picture.time
                first = last if count == 0 else first
                image = np.asarray(picture.to_ndarray(format="rgb24"), dtype=np.uint8)
                yield Frame(image=image, time=last if fps is None else count / fps)
                count += 1
        except av.FFmpegError as error:
            raise broken(str(error.strerror).lower()) from None
        if count < stream.frames:
            raise broken("the file ends there")
        # Matroska has a duration instead of a count; beside sound it may be that of the sound.
        duration = 0.0
        if not stream.frames and len(container.streams) == 1:
            duration = 1e-6 * (container.duration or 0)
        if duration > last - first + 2.5 / rate:
            raise broken(f"the file ends there, and should last {duration:g} s")
