"""A video that is written while its pictures come."""

from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..extras import need
from .folder import GrowingFile, disk_errors

if TYPE_CHECKING:
    import av

Image = NDArray[np.uint8]


class VideoFile(GrowingFile):
    """H.264 in 4:4:4, because halving the chroma doubles the error on colour-coded markers.

    Parameters
    ----------
    path: of the video; it gets that name when it is closed
    rate: pictures per second [Hz]
    quality: rate factor of x264, lower is better
    options: further options of x264, as PyAV takes them

    Raises
    ------
    UserError
        When it cannot be written, as where the disk is full; nothing of it is left.
    """

    _stream: "av.VideoStream | None"

    def __init__(
        self,
        path: Path,
        rate: Fraction | int,
        quality: int,
        options: dict[str, str] | None = None,
    ) -> None:
        super().__init__(path)
        self._rate, self._quality = rate, quality
        self._options = options or {}
        with disk_errors(path):
            self._part.touch()  # the container makes its file when the encoder's buffer is full
            self._container = need("av", "video").open(str(self._part), "w", format="mp4")
        self._stream = None

    def _finish(self) -> None:
        if self._stream is not None:
            self._mux(None)
        self._container.close()
        if self._stream is None:  # without a picture it is no video
            self._part.unlink()

    def append(self, picture: Image) -> None:
        """Append a picture; all have the size of the first one."""
        if self._stream is None:
            self._stream = self._container.add_stream("libx264", rate=self._rate)
            self._stream.height, self._stream.width = picture.shape[:2]
            self._stream.pix_fmt = "yuv444p"
            options: dict[str, object] = {
                "crf": str(self._quality),
                "preset": "veryfast",
                "threads": "1",
                # Fewer pictures in memory at a time: 50 MB.
                "x264-params": "rc-lookahead=4:bframes=0:ref=1",
                **self._options,
            }
            self._stream.options = options
        frame = need("av", "video").VideoFrame.from_ndarray(picture, format="rgb24")
        with disk_errors(self._path):
            self._mux(frame)

    def _mux(self, frame: "av.VideoFrame | None") -> None:
        """Encode a picture, or what the encoder still holds."""
        assert self._stream is not None
        for packet in self._stream.encode(frame):
            self._container.mux(packet)
