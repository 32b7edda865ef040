"""A video as it is written: beside its final name, so that a cut file never looks whole."""

from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from ..extras import need

if TYPE_CHECKING:
    import av

Image = NDArray[np.uint8]


class VideoFile:
    """H.264 in 4:4:4, because halving the chroma doubles the error on colour-coded markers.

    Parameters
    ----------
    path: of the video; it has that name once it is closed
    rate: pictures per second
    quality: rate factor of x264, lower is better
    options: more of x264, as PyAV takes them
    """

    _stream: "av.VideoStream | None"

    def __init__(
        self,
        path: Path,
        rate: Fraction | int,
        quality: int,
        options: dict[str, str] | None = None,
    ) -> None:
        self._path, self._rate, self._quality = path, rate, quality
        self._options = options or {}
        self._part = path.with_name(path.name + ".part")
        av = need("av", "video")
        self._container = av.open(str(self._part), "w", format="mp4")
        self._stream = None

    def __enter__(self) -> Self:
        """Use as a context: closed and renamed even after an interruption."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file."""
        self.close()

    def close(self) -> None:
        """Finish the file and give it its name; without a picture it has none."""
        stream, self._stream = self._stream, None
        if stream is not None:
            for packet in stream.encode():
                self._container.mux(packet)
        self._container.close()
        if stream is not None:
            self._part.replace(self._path)

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
        av = need("av", "video")
        frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
        for packet in self._stream.encode(frame):
            self._container.mux(packet)
