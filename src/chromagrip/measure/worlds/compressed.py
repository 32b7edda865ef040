"""Frames as they come back from a compressed video or from compressed pictures, in memory."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...render import Frame

if TYPE_CHECKING:
    from av import VideoCodecContext
    from av.video.frame import VideoFrame

Image = NDArray[np.uint8]

#: Compresses frames of one size and unpacks them again; their number, order and times stay.
Codec = Callable[[Sequence[Frame]], list[Frame]]

#: Rate of the videos [Hz]; it does not change what is stored at a given quality.
_RATE = 60


def h264(crf: int, chroma: str = "yuv420p", preset: str = "medium") -> Codec:
    """H.264 at a rate factor from 0, without loss but for the colours, to 51.

    Parameters
    ----------
    crf: rate factor
    chroma: yuv420p stores one colour for two by two pixels, yuv444p for each
    preset: of x264
    """
    options = {"crf": str(crf), "preset": preset, "threads": "1"}
    return partial(_through_video, ("libx264", "h264"), chroma, options)


def h265(crf: int, chroma: str = "yuv420p", preset: str = "medium") -> Codec:
    """H.265, with the same parameters as `h264`."""
    quiet = "log-level=none:pools=none:frame-threads=1"
    options = {"crf": str(crf), "preset": preset, "x265-params": quiet}
    return partial(_through_video, ("libx265", "hevc"), chroma, options)


def mjpeg(quantiser: int, chroma: str = "yuvj420p") -> Codec:
    """Motion JPEG at a quantiser from 2, the best, to 31; each frame by itself."""
    options = {"qmin": str(quantiser), "qmax": str(quantiser)}
    return partial(_through_video, ("mjpeg", "mjpeg"), chroma, options)


def jpeg(quality: int) -> Codec:
    """JPEG pictures of a quality up to 100, in 4:2:0."""
    return partial(_through_jpeg, [cv2.IMWRITE_JPEG_QUALITY, quality])


def raw(frames: Sequence[Frame]) -> list[Frame]:
    """The same frames: no compression."""
    return list(frames)


def _through_jpeg(options: list[int], frames: Sequence[Frame]) -> list[Frame]:
    def through(image: Image) -> Image:
        _, data = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), options)
        return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR_RGB), dtype=np.uint8)

    return [replace(frame, image=through(frame.image)) for frame in frames]


def _through_video(
    names: tuple[str, str], chroma: str, options: dict[str, str], frames: Sequence[Frame]
) -> list[Frame]:
    """Frames through an encoder and a decoder of these names."""
    from av import CodecContext

    if not frames:
        return []
    height, width = frames[0].image.shape[:2]
    encoder: Any = CodecContext.create(names[0], "w")
    decoder: Any = CodecContext.create(names[1], "r")
    # Colours are stored for two by two pixels.
    encoder.width, encoder.height = width + width % 2, height + height % 2
    encoder.pix_fmt, encoder.options = chroma, options
    encoder.framerate, encoder.time_base = Fraction(_RATE), Fraction(1, _RATE)
    images = [
        np.ascontiguousarray(decoded.to_ndarray(format="rgb24")[:height, :width])
        for packet in _packets(encoder, frames)
        for decoded in decoder.decode(packet)
    ]
    return [replace(frame, image=image) for frame, image in zip(frames, images, strict=True)]


def _packets(encoder: "VideoCodecContext", frames: Sequence[Frame]) -> list[Any]:
    """Packets of all frames, and the end."""
    packets: list[Any] = []
    for number, frame in enumerate(frames):
        packets += encoder.encode(_picture(encoder, frame.image, number))
    return [*packets, *encoder.encode(None), None]


def _picture(encoder: "VideoCodecContext", image: Image, number: int) -> "VideoFrame":
    """Picture of the encoder's size, whose last row and column are repeated where it is larger."""
    from av import VideoFrame

    below, right = encoder.height - image.shape[0], encoder.width - image.shape[1]
    even: Any = cv2.copyMakeBorder(image, 0, below, 0, right, cv2.BORDER_REPLICATE)
    picture = VideoFrame.from_ndarray(even, format="rgb24")
    picture.pts, picture.time_base = number, encoder.time_base
    return picture
