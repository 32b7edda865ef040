"""Opens a source of frames by its name."""

import math
import re
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..arguments import arguments_in
from ..by_name import Choice, blaming, name_of
from ..errors import UserError
from ..render import Frame
from ..stored_pictures import MEGAPIXELS, unread_kind
from .arrays import array_source
from .bags import bag_source, is_bag
from .camera import camera_number, camera_source
from .picture_files import is_pattern, is_picture, picture_source
from .pipe import pipe_source
from .source import KINDS, SOURCES, FrameSource, NoSourceError, Source, ValueRange, rated
from .video import video_source


def open_source(
    source: Choice | FrameSource,
    fps: float | None = None,
    without: Path | None = None,
    max_megapixels: float = MEGAPIXELS,
    value_range: ValueRange = None,
) -> Source:
    """Open a source of frames; no camera and no source of one's own is opened before it is read.

    Parameters
    ----------
    source: name of a kind that `chromagrip list sources` shows, or from Python a class or an object
        with the method `read`, see `FrameSource`
    fps: rate of pictures, instead of the times of a file [Hz]; of others it is nominal
    without: picture that is no frame of the folder in which it lies, nor is one that is called rest
        beside others
    max_megapixels: largest picture of a file or a pipe that is decoded
    value_range: values of black and white in pictures and arrays of more than 8 bits

    Raises
    ------
    UserError
        When there is no such source, or no picture in it.
    """
    if isinstance(source, str):
        found = _named(source, fps, without, max_megapixels, value_range)
    else:
        found = _own(source, fps)
    return replace(found, frames=lambda: _delivered(found))


def _named(
    name: str,
    fps: float | None,
    without: Path | None,
    max_megapixels: float,
    value_range: ValueRange,
) -> Source:
    """Source of a name."""
    path = Path(name)
    if name.startswith("pipe:"):
        return pipe_source(name, fps, max_megapixels)
    if is_bag(path):
        return bag_source(name, path, {}, fps, max_megapixels, value_range)
    if path.is_dir() or (path.is_file() and is_picture(path)):
        return picture_source(name, fps, without, max_megapixels, value_range)
    if path.is_file() and path.suffix.lower() in (".npy", ".npz"):
        return array_source(path, fps, max_megapixels, value_range)
    if path.is_file() and (kind := unread_kind(path)):
        raise UserError(f"{path} is {kind}, which is not read; save it as png or tiff")
    if path.is_file():
        return video_source(path, fps, max_megapixels)
    place, bracket, rest = name.partition("(")
    if bracket and rest.endswith(")") and is_bag(Path(place)):
        arguments = arguments_in(rest[:-1], name)
        return bag_source(name, Path(place), arguments, fps, max_megapixels, value_range)
    if (number := camera_number(place)) is not None and (not bracket or rest.endswith(")")):
        return camera_source(name, number, arguments_in(rest[:-1], name), fps)
    if place.startswith("camera:"):
        raise UserError(f"{name}: expected a camera's number, as camera:0 or camera:0(fps=60)")
    if re.fullmatch(r"[^\W\d][\w.]*:[^\W\d][\w.]*", place) or name in SOURCES.descriptions():
        return _own(name, fps)
    if is_pattern(name):
        return picture_source(name, fps, without, max_megapixels, value_range)
    raise NoSourceError(f"there is no {name}; {KINDS}")


def _own(choice: Choice | FrameSource, fps: float | None) -> Source:
    """Source of one's own: a plug-in by name, a class or an object."""
    kind: Any = SOURCES.load(choice) if isinstance(choice, str | type) else choice
    kind = getattr(kind, "func", kind)  # class of one with arguments
    rate, rate_from = rated(fps)
    return Source(
        name=name_of(choice),
        frames=partial(_own_frames, choice),
        count=None,
        fps=rate,
        fps_from=rate_from,
        timed=True,
        live=bool(getattr(kind, "live", True)),
    )


def _own_frames(choice: Choice | FrameSource) -> Iterator[Frame]:
    made: FrameSource = SOURCES.build(choice)
    who, count = f"source {name_of(choice)}", 0
    try:
        while (frame := _read(made, f"{who} failed after {count} frames")) is not None:
            yield frame
            count += 1
    finally:
        with blaming(f"{who} cannot be closed", Exception, SystemExit):
            getattr(made, "close", lambda: None)()


def _read(made: FrameSource, failure: str) -> Frame | None:
    """Next frame of a source of one's own; its errors become one sentence."""
    try:
        found: Any = made.read()
    except UserError:
        raise
    except (Exception, SystemExit) as error:
        with blaming(failure, type(error)):
            raise
    if found is None:
        return None
    image, instant = found if isinstance(found, tuple) and len(found) == 2 else (found, None)
    picture = isinstance(image, np.ndarray) and image.dtype == np.uint8 and image.ndim == 3
    if not (picture and image.size and image.shape[2] == 3):
        kind = f"{image.dtype} {image.shape}" if hasattr(image, "shape") else type(image).__name__
        raise UserError(f"{failure}: it gave {kind}; wanted: (picture uint8 (H, W, 3), time [s])")
    if not (isinstance(instant, int | float | np.number) and math.isfinite(instant)):
        raise UserError(f"{failure}: it gave the time {instant!r}; wanted: a number of seconds")
    # A copy: a camera may write its next picture into the same memory.
    return Frame(image=np.array(image, order="C"), time=float(instant))


def _delivered(source: Source) -> Iterator[Frame]:
    """Frames of a source as they are counted; their times must not go back."""
    source.delivery.begin(source.timed, source.live)
    last = -math.inf
    for index, frame in enumerate(source.frames()):
        if not frame.time >= last:
            raise UserError(
                f"{source.frame_name(index)} has the time {frame.time:g} s, the one before "
                f"{last:g} s; wanted: frames in order of time"
            )
        last = frame.time
        source.delivery.add(frame, time.monotonic())
        yield frame
