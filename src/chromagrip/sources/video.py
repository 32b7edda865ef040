"""Frames of a video file."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import UserError
from ..extras import need
from ..render import Frame
from ..stored_pictures import MORE, check_pixels
from .source import DEFAULT_FPS, KINDS, Source, rated

if TYPE_CHECKING:
    import av


def video_source(path: Path, fps: float | None, max_megapixels: float) -> Source:
    """Source of a video file; `fps` [Hz] overrides its own times.

    Raises
    ------
    UserError
        When it cannot be read as a video, or its pictures are too large.
    """
    with _open_video(path, max_megapixels) as container:
        stream = container.streams.video[0]
        rate, rate_from = rated(fps, float(stream.average_rate or 0.0), "the video's own")
        count, lossy = stream.frames or None, stream.codec_context.codec.lossy
    return Source(
        name=str(path),
        frames=lambda: _frames(path, fps, max_megapixels),
        count=count,
        fps=rate,
        fps_from=rate_from,
        timed=fps is None,
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
            f"{path} cannot be read as a video: {_reason(error)}; give {KINDS}"
        ) from None
    with container:
        # FFmpeg reads any text as a recording of a terminal.
        if not container.streams.video or container.format.name == "tty":
            raise UserError(f"{path} has no video in it; give {KINDS}")
        coded = container.streams.video[0].codec_context
        if coded is None:
            raise UserError(f"{path} holds a video of an unknown kind; give {KINDS}")
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


def _frames(path: Path, fps: float | None, max_megapixels: float) -> Iterator[Frame]:
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
