"""Raw pictures of a camera, lossless, with the instant of each.

rest.png            picture of the unloaded sensor
frame-000000.png …  pictures, of `png`
frames.mkv          pictures, of `ffv1`, which takes less room and more time
frames.csv          number and instant of each picture, in their order
"""

from fractions import Fraction
from pathlib import Path
from typing import Literal, TextIO

from ..folders import disk_errors
from ..render import Frame
from .png import encode_png
from .video import VideoFile

#: How pictures are kept.
FrameFormat = Literal["png", "ffv1"]
#: Folder of the camera's raw pictures in a run folder, where they were asked for.
FRAMES = "frames"


class FrameFiles:
    """Folder of pictures, which is filled while they come.

    Parameters
    ----------
    folder: new
    kind: how pictures are kept
    rate: of the camera [Hz]

    Raises
    ------
    UserError
        When something cannot be written, as where the disk is full.
    """

    def __init__(self, folder: Path, kind: FrameFormat, rate: float) -> None:
        self._folder, self._kind = folder, kind
        self._list: TextIO | None = None
        with disk_errors(folder):
            folder.mkdir()
            self._list = (folder / "frames.csv").open("w", encoding="utf-8", newline="\n")
            self._list.write("frame,time_s,file\n")
        self._video: VideoFile | None = None
        if kind == "ffv1":
            exact = Fraction(rate).limit_denominator(1000)
            self._video = VideoFile(folder / "frames.mkv", exact, codec="ffv1")

    def add_rest(self, frame: Frame) -> None:
        """Keep the picture of the unloaded sensor."""
        self._write("rest.png", encode_png(frame.image))

    def add(self, index: int, frame: Frame) -> None:
        """Append the picture of a frame; numbers rise, and may leave some out."""
        name = "frames.mkv" if self._video else f"frame-{index:06d}.png"
        if self._video is not None:
            self._video.append(frame.image, index)
        else:
            self._write(name, encode_png(frame.image))
        assert self._list is not None
        with disk_errors(self._folder / "frames.csv"):
            self._list.write(f"{index},{frame.time!r},{name}\n")
            self._list.flush()  # a run that is killed leaves what is there

    def close(self) -> None:
        """Finish the files; closing them again does nothing."""
        video, self._video = self._video, None
        listed, self._list = self._list, None
        if listed is not None:
            with disk_errors(self._folder / "frames.csv"):
                listed.close()
        if video is not None:
            video.close()

    def _write(self, name: str, data: bytes) -> None:
        path = self._folder / name
        with disk_errors(path):
            path.write_bytes(data)
