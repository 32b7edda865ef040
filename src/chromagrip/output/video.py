"""A video that is written while its pictures come."""

from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..folders import GrowingFile, disk_errors

if TYPE_CHECKING:
    import av

Image = NDArray[np.uint8]


#: Container, encoder, layout of pixels and options of each kind of video.
_KINDS = {
    "h264": (
        "mp4",
        "libx264",
        "yuv444p",
        # Fewer pictures in memory at a time: 50 MB.
        {"preset": "veryfast", "x264-params": "rc-lookahead=4:bframes=0:ref=1"},
    ),
    "ffv1": ("matroska", "ffv1", "bgr0", {"level": "3", "slicecrc": "1", "g": "1"}),
}


class VideoFile(GrowingFile):
    """H.264 in 4:4:4, because halving the chroma doubles the error on coloured markers; or FFV1.

    FFV1 loses nothing.

    Parameters
    ----------
    path: of the video; it gets that name when it is closed
    rate: pictures per second [Hz]
    quality: rate factor of H.264, lower is better
    options: further options of the encoder, as PyAV takes them
    codec: of the video

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
        quality: int | None = None,
        options: dict[str, str] | None = None,
        codec: Literal["h264", "ffv1"] = "h264",
    ) -> None:
        super().__init__(path)
        self._rate = rate
        container, self._encoder, self._layout, usual = _KINDS[codec]
        best = {} if quality is None else {"crf": str(quality)}
        self._options = {**best, **usual, "threads": "1", **(options or {})}
        import av

        with disk_errors(path):
            self._part.touch()  # the container makes its file when the encoder's buffer is full
            self._container: Any = av.open(str(self._part), "w", format=container)
        self._stream = None

    def _finish(self) -> None:
        if self._stream is not None:
            self._mux(None)
        self._container.close()
        if self._stream is None:  # without a picture it is no video
            self._part.unlink()

    def append(self, picture: Image, index: int | None = None) -> None:
        """Append a picture; all have the size of the first one.

        Parameters
        ----------
        picture: sRGB, shape (H, W, 3)
        index: its place in time, in periods of the rate; None is the one after the last
        """
        import av

        if self._stream is None:
            self._stream = self._container.add_stream(self._encoder, rate=self._rate)
            self._stream.height, self._stream.width = picture.shape[:2]
            self._stream.pix_fmt = self._layout
            options: dict[str, object] = {**self._options}
            self._stream.options = options
        frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
        if index is not None:
            frame.pts, frame.time_base = index, 1 / Fraction(self._rate)
        with disk_errors(self._path):
            self._mux(frame)

    def _mux(self, frame: "av.VideoFrame | None") -> None:
        """Encode a picture, or what the encoder still holds."""
        assert self._stream is not None
        for packet in self._stream.encode(frame):
            self._container.mux(packet)
