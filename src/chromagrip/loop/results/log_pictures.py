"""Pictures of a run folder for its log: raw ones if they were kept, and those of the video."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...output.logs.entries import Array, Pictures
from ...output.png import encode_png
from ...sources import open_source
from ...sources.frame_list import read_list
from ...sources.picture_files import PNG_BEGIN, PNG_END
from .run_folder import LARGEST_FILE, RunRead, check_size
from .tactile_video import FPS, SLOWDOWN

Image = NDArray[np.uint8]


@dataclass(frozen=True, kw_only=True)
class Part:
    """Part of the pictures of a run's video.

    Attributes
    ----------
    topic, meaning: topic and meaning in the log
    top, left: first row and column of the part [px]
    right: column after its last one [px] (default: the end of the picture)
    """

    topic: str
    meaning: str
    top: int = 0
    left: int = 0
    right: int | None = None


def raw_pictures(run: RunRead, folder: str, topic: str) -> list[Pictures]:
    """Raw pictures of a folder that `--frames` filled; empty if it was not used.

    Parameters
    ----------
    run: run that was read
    folder: name of the folder in the run folder
    topic: topic in the log
    """
    listed, video = run.file(f"{folder}/frames.csv"), run.file(f"{folder}/frames.mkv")
    if not listed.is_file():
        return []

    def read() -> Iterator[tuple[float, bytes]]:
        check_size(listed, LARGEST_FILE)
        rows = read_list(listed)
        if video.is_file():
            count = 0
            for (time, _), frame in zip(rows, open_source(str(video)).frames(), strict=False):
                yield time, encode_png(frame.image)
                count += 1
            if count < len(rows):
                raise UserError(f"{video} has {count} pictures, and frames.csv {len(rows)}")
            return
        for time, name in rows:
            picture = run.file(f"{folder}/{name}")
            if not picture.is_file():
                raise UserError(f"{picture} cannot be read: it is missing")
            check_size(picture, LARGEST_FILE)
            data = picture.read_bytes()
            if not (data.startswith(PNG_BEGIN) and data.endswith(PNG_END)):
                raise UserError(f"{picture} is not a PNG picture, or is cut off")
            yield time, data

    meaning = "picture of the camera, without loss"
    return [Pictures(topic=topic, meaning=meaning, encoding="png", read=read)]


def video_pictures(video: Path, part: Part, times: Array) -> Pictures:
    """A part of a video's pictures, each at the instant of its frame.

    Parameters
    ----------
    video: video of a run, in slow motion
    part: part of its pictures
    times: times of the frames whose pictures came [s]
    """
    slots = (times * FPS * SLOWDOWN + 1e-6).astype(int)
    shown, first = np.unique(slots, return_index=True)
    # The video rounds a time down to its rate; its picture shows the first frame from then on.
    instants = dict(zip(shown.tolist(), times[first].tolist(), strict=True))

    def read() -> Iterator[tuple[float, bytes]]:
        for frame in open_source(str(video)).frames():
            slot = round(frame.time * FPS)
            time = instants.get(slot, slot / (FPS * SLOWDOWN))
            yield time, _jpeg(frame.image[part.top :, part.left : part.right])

    return Pictures(topic=part.topic, meaning=part.meaning, encoding="jpeg", read=read)


def _jpeg(image: Image) -> bytes:
    # Quality of JPEG. Colours are at full resolution, because they distinguish the markers.
    options = (cv2.IMWRITE_JPEG_QUALITY, 80, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, 0x111111)
    done, data = cv2.imencode(".jpg", image[..., ::-1], options)
    if not done:
        raise UserError(f"a picture of {image.shape[1]} × {image.shape[0]} cannot be made a JPEG")
    return data.tobytes()
