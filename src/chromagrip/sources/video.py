"""Frames of a video file."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import UserError
from ..render import Frame
from ..stored_pictures import MORE, check_pixels, turned
from .source import DEFAULT_FPS, KINDS, Source, rated

if TYPE_CHECKING:
    import av

#: Rate above which the one of a file may be that of its clock [Hz].
_FASTEST = 300.0


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
        if fps is None and rate > _FASTEST:
            rate_from += ", more than most cameras give; if it is wrong, give yours with --fps"
        doubt = _unlike_viewers(stream)
        count, lossy = stream.frames or None, stream.codec_context.codec.lossy
    return Source(
        name=str(path),
        frames=lambda: _frames(path, fps, max_megapixels),
        count=count,
        fps=rate,
        fps_from=rate_from,
        timed=fps is None,
        lossy=lossy,
        doubt=doubt,
    )


def _unlike_viewers(stream: "av.VideoStream") -> str:
    """What viewers show otherwise than it is read here, in words; empty if nothing."""
    aspect = float(stream.sample_aspect_ratio or 1.0)
    if abs(aspect - 1.0) > 0.005:  # more than a rounded one
        return f"its pixels are {aspect:.3g} times as wide as high, and are read as squares"
    layout = stream.codec_context.format
    if layout is not None and any(part.is_alpha for part in layout.components):
        return "its pixels have a transparency, which is left out"
    return ""


@contextmanager
def _open_video(path: Path, max_megapixels: float) -> "Iterator[av.container.InputContainer]":
    import av

    if path.stat().st_size == 0:
        raise UserError(f"video {path} is empty (0 bytes)")
    try:
        most = {"max_pixels": str(round(1e6 * max_megapixels))}  # also where sizes change later
        container = av.open(str(path), options=most, metadata_errors="ignore")
    except av.FFmpegError as error:
        raise UserError(f"{path} cannot be read as a video: {_reason(error)}; {KINDS}") from None
    with container:
        # FFmpeg reads any text as a recording of a terminal.
        if not container.streams.video or container.format.name == "tty":
            raise UserError(f"{path} has no video in it; {KINDS}")
        kinds = av.stream.Disposition
        covers = kinds.attached_pic | kinds.timed_thumbnails  # still pictures
        pictured = [s for s in container.streams.video if not s.disposition & covers]
        if len(pictured) > 1:
            raise UserError(
                f"video {path} holds {len(pictured)} videos; give a file with one of them, as by "
                "ffmpeg -i FILE -map 0:v:0 -c copy OUT.mkv"
            )
        coded = container.streams.video[0].codec_context
        if coded is None:
            raise UserError(f"{path} holds a video of an unknown kind; {KINDS}")
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


def _orientation(path: Path, picture: "av.VideoFrame") -> int:
    """How players turn the frames of a video, as `turned` takes it."""
    from av.sidedata.sidedata import Type

    sides: Any = picture.side_data
    matrix = sides.get(Type.DISPLAYMATRIX)
    if matrix is None:
        return 1
    # Shown at x = a·column + c·row and y = b·column + d·row, in this order a, b, 0, c, d, ….
    a, b, _, c, d = np.sign(np.rint(np.frombuffer(bytes(matrix), "=i4")[:5] / 2**16)).astype(int)
    known = ((1, 0, 0, 1), (-1, 0, 0, 1), (-1, 0, 0, -1), (1, 0, 0, -1),
             (0, 1, 1, 0), (0, 1, -1, 0), (0, -1, -1, 0), (0, -1, 1, 0))  # fmt: skip
    if (a, b, c, d) not in known and (a, b, c, d) != (0, 0, 0, 0):
        raise UserError(f"video {path} is turned by no multiple of 90°; wanted: one that is")
    return known.index((a, b, c, d)) + 1 if (a, b, c, d) in known else 1


def _frames(path: Path, fps: float | None, max_megapixels: float) -> Iterator[Frame]:
    """Frames with the file's own times, or evenly at `fps`; a UserError where it is cut off."""
    import av

    with _open_video(path, max_megapixels) as container:
        stream = container.streams.video[0]
        rate = float(stream.average_rate or DEFAULT_FPS)
        count, first, last, orientation = 0, 0.0, 0.0, 1

        def broken(why: str) -> UserError:
            expected = f" of {stream.frames}" if stream.frames else ""
            return UserError(f"video {path} breaks off after {count}{expected} frames: {why}")

        try:
            for picture in container.decode(stream):
                if picture.is_corrupt:
                    raise broken("the next one is damaged")
                last = count / rate if picture.time is None else picture.time
                if count == 0:
                    first, orientation = last, _orientation(path, picture)
                image = np.asarray(picture.to_ndarray(format="rgb24"), dtype=np.uint8)
                image = image if orientation == 1 else turned(image, orientation)
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
