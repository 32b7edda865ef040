"""A source of frames that is open, and the protocol of a source of one's own."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from ..by_name import Registry
from ..errors import UserError
from ..render import Frame
from ..stored_pictures import Image
from .delivery import Delivery

#: Suffixes of pictures.
SUFFIXES = (".png", ".apng", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
#: Values of black and white of pictures with more than 8 bits; None where they are not known.
ValueRange = tuple[float, float] | None
#: Rate of sources that have none of their own [Hz].
DEFAULT_FPS = 30.0
#: Where a rate comes from that is assumed.
ASSUMED = "assumed; give yours with --fps"
#: End of the refusal of what is no source.
KINDS = (
    "give a picture, a folder of pictures, a video file, camera:0, or another one of `chromagrip "
    "list sources`"
)


def rated(fps: float | None, own: float = 0.0, own_from: str = "") -> tuple[float, str]:
    """Rate [Hz] and where it comes from: given, a file's own if it is above 0, or assumed."""
    if fps is not None:
        return fps, "given"
    return (own, own_from) if own > 0.0 else (DEFAULT_FPS, ASSUMED)


class NoSourceError(UserError):
    """There is no source of that name."""


class FrameSource(Protocol):
    """Gives frames; a class of yours reads your camera.

    It is live, as a camera is: a loop that is slower gets its newest frame. A class with
    `live = False` gives every frame, and from the first one again when it is made again. If there
    is a method `close`, it is called at the end.
    """

    def read(self) -> tuple[Image, float] | None:
        """Wait for the next frame.

        Returns
        -------
        picture (sRGB, uint8, shape (H, W, 3)) and its time [s]; None at the end
        """
        ...


#: Kinds of sources that are shipped, by the form of their names.
SHIPPED = {
    "camera:N": "camera, also /dev/videoN; camera:0(fps=60, exposure=100) sets and reads back fps, "
    "width and height, exposure, gain, in the driver's units",
    "PICTURE": f"{', '.join(SUFFIXES)}; all pages of a TIFF, all frames of an animated one",
    "FOLDER": "pictures of a folder, in the order of their numbers, of which missing ones leave "
    "gaps in time, or with the times of its frames.csv: time_s [s] and file of each",
    "'DIR/*.png'": "pictures that match a pattern, in quotation marks",
    "VIDEO": "video file",
    "pipe:FILE": "frames that another program writes; pipe:- is the standard input; with "
    "pipe:FILE(live=true) a slower loop skips frames",
    "FILE.npy": "array (N, H, W, 3) or (N, H, W), uint8 or with --value-range",
    "FILE.npz": "such an array called images or frames, with times or time_s [s] if there are any",
    "BAG": "ROS 2 bag (extra ros): folder, .mcap or .db3; BAG(topic=/NAME) names one of its topics",
    "MODULE:CLASS": "class with read(), see chromagrip.sources.FrameSource",
}
#: Sources of one's own by name.
SOURCES = Registry(protocol=FrameSource, package=__package__, entries={}, named="source")


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
    timed: whether frames carry their own times
    live: whether it is a camera, which gives no frame twice
    lossy: whether its compression leaves errors in the pictures
    files: of its frames; empty where they have none of their own
    doubt: what is not as viewers show it, in words
    delivery: counts of the frames that did not come as they should, in the last iteration
    """

    name: str
    frames: Callable[[], Iterator[Frame]]
    count: int | None
    fps: float
    fps_from: str = "given"
    timed: bool = False
    live: bool = False
    lossy: bool = False
    files: tuple[Path, ...] = ()
    doubt: str = ""
    delivery: Delivery = field(default_factory=Delivery)

    def frame_name(self, index: int) -> str:
        """What a frame is called in a message, with its file if that is not the source itself."""
        name = f"frame {index} of {self.name}"
        own = self.files[index] if index < len(self.files) else Path(self.name)
        return name if own == Path(self.name) else f"{name} ({own.name})"
