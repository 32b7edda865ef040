"""Pictures from strangers' files: their sizes are checked before they are decoded.

Pillow decodes them silently; libpng and libjpeg in OpenCV write to the terminal. OpenCV decodes
TIFF, with its log off, and PNG of 16 bits once Pillow has found it whole.
"""

import io
import logging
import struct
import threading
import warnings
import zlib
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .errors import UserError

Image = NDArray[np.uint8]

#: Largest picture that is decoded by default [10⁶ pixels].
MEGAPIXELS = 64.0
#: End of a refusal: the commands with a higher limit.
MORE = "; detect, track, estimate and calibrate take --max-megapixels (max_megapixels in Python)"

#: Kinds of pictures by the bytes that they begin with, each with Pillow's module.
_KINDS = {
    b"RIFF": "WebP",
    b"\x89PNG": "Png",
    b"\xff\xd8": "Jpeg",
    b"BM": "Bmp",
    b"II*\0": "Tiff",
    b"MM\0*": "Tiff",
    b"II+\0": "Tiff",  # of more than 4 GB
    b"MM\0+": "Tiff",
}
#: Kinds of pictures that are not read: bytes, and the place in the file at which they lie.
_UNREAD = (
    (4, b"ftyphei", "HEIF"), (4, b"ftyphev", "HEIF"), (4, b"ftypmif1", "HEIF"),
    (4, b"ftypmsf1", "HEIF"), (4, b"ftypavi", "AVIF"), (0, b"v/1\x01", "OpenEXR"),
    (0, b"#?R", "Radiance HDR"), (0, b"8BPS", "Photoshop"), (4, b"jP  ", "JPEG 2000"),
    (4, b"JXL ", "JPEG XL"), (0, b"\xff\n", "JPEG XL"), (128, b"DICM", "DICOM"),
    (0, b"SIMPLE  =", "FITS"), (4, b"ftypcrx", "camera raw"), (8, b"CR\x02", "camera raw"),
    (0, b"FUJIFILM", "camera raw"), (0, b"IIR", "camera raw"), (0, b"IIU\0", "camera raw"),
)  # fmt: skip
#: Suffixes of files of cameras that begin like a TIFF.
_RAW = (".dng", ".nef", ".nrw", ".arw", ".srw", ".pef", ".3fr")
#: Number of the tag of EXIF that says how a picture is turned.
_ORIENTATION = 0x0112
#: Errors that Pillow raises for damaged pictures.
_DAMAGES = (
    OSError, SyntaxError, ValueError, TypeError, LookupError, EOFError, ArithmeticError,
    AttributeError, RuntimeError, struct.error, zlib.error, Warning,
)  # fmt: skip
#: Held while OpenCV's log is off.
_logging = threading.Lock()


def check_pixels(width: int, height: int, name: str, megapixels: float) -> None:
    """Refuse a picture with more pixels than are decoded.

    Parameters
    ----------
    width, height: size of the picture [px]
    name: name of the picture in messages, such as `picture press.png`
    megapixels: largest number of pixels [10⁶]
    """
    if not width * height <= 1e6 * megapixels:
        raise UserError(
            f"{name} has {width}×{height} pixels, {width * height / 1e6:.0f} megapixels; allowed: "
            f"{megapixels:g}{MORE}"
        )


def kind_of(data: bytes) -> str | None:
    """Kind of a picture by the first bytes of its file; None for any other file."""
    return next((kind for begin, kind in _KINDS.items() if data.startswith(begin)), None)


def unread_kind(path: Path, data: bytes | None = None) -> str | None:
    """Name of the kind of a picture that is not read; None for other files.

    `data` is the content of the file, which is looked up by default.
    """
    if data is None:
        with path.open("rb") as file:
            data = file.read(140)
    found = (kind for at, begin, kind in _UNREAD if data.startswith(begin, at))
    return next(found, "camera raw" if path.suffix.lower() in _RAW else None)


class Page(NamedTuple):
    """One picture of a file.

    Attributes
    ----------
    pixels: shape (H, W), or (H, W, 3 or 4) in the order red, green, blue and opacity; of another
        type than uint8 if its values have more than 8 bits; None if it is damaged
    seconds: how long an animation shows it [s]; 0 of other pictures
    """

    pixels: NDArray[Any] | None
    seconds: float = 0.0


def turned(pixels: NDArray[Any], orientation: int) -> NDArray[Any]:
    """Turn and mirror a picture (H, W, …) as its orientation says, 1 to 8 by EXIF."""
    if orientation in (5, 6, 7, 8):
        pixels = np.swapaxes(pixels, 0, 1)
    across = -1 if orientation in (2, 3, 6, 7) else 1
    down = -1 if orientation in (3, 4, 7, 8) else 1
    return np.ascontiguousarray(pixels[::down, ::across])


def page_count(data: bytes) -> int:
    """Number of pictures in a file: pages of a TIFF, frames of an animated PNG or WebP; else 1."""
    kind = kind_of(data)
    try:
        if kind == "Tiff":
            return max(1, len(_tiff_pages(data)))
        return len(_numbers(_opener(kind)(io.BytesIO(data)))) if kind in ("Png", "WebP") else 1
    except (*_DAMAGES, import_module("PIL.Image").DecompressionBombError):
        return 1  # decoding it says why


def decoded(data: bytes, name: str, megapixels: float, *, grey: bool = False) -> Any:
    """Pixels of the first picture in a file, see `pages`."""
    return next(pages(data, name, megapixels, grey=grey), Page(None)).pixels


def pages(data: bytes, name: str, megapixels: float, *, grey: bool = False) -> Iterator[Page]:
    """Decode the pictures in a file one by one, each turned as viewers show it.

    Parameters
    ----------
    data: content of the file: PNG, JPEG, BMP, WebP or TIFF
    name, megapixels: see `check_pixels`
    grey: whether only the brightness is returned, from values of any number of bits, not turned

    Raises
    ------
    UserError
        When one is too large.
    """
    kind = kind_of(data)
    if kind is None:
        return
    possible = 178.0  # largest WebP that Pillow decodes [10⁶ pixels]
    try:
        if kind == "Tiff":
            copy = bytearray(data)
            for place, width, height in _tiff_pages(data):
                check_pixels(width, height, name, megapixels)
                yield Page(_tiff(copy, place, grey))
            return
        opened = _opener(kind)
        image = opened(io.BytesIO(data))
        check_pixels(image.width, image.height, name, megapixels)
        if kind == "Png":
            opened(io.BytesIO(data)).verify()  # checksums, which are not read with the pixels
        if grey and kind == "Jpeg":
            image.draft("L", image.size)
        wide = kind == "Png" and data[24] > 8
        numbers = _numbers(image)
        if wide and len(numbers) > 1:  # OpenCV decodes the first alone, and Pillow to 8 bits
            raise UserError(f"{name} is an animated PNG of 16 bits, which is not read")
        for number in numbers:
            image.seek(number)
            image.load()
            pixels = _pixels(image, data if wide else None, grey)
            seconds = 1e-3 * float(image.info.get("duration", 0.0))
            yield Page(pixels if grey or pixels is None else _upright(image, pixels), seconds)
    except UserError:
        raise
    except import_module("PIL.Image").DecompressionBombError:  # Pillow's own limit for WebP
        most = min(megapixels, possible)
        raise UserError(f"{name} has too many megapixels; allowed: {most:g}{MORE}") from None
    except _DAMAGES:
        yield Page(None)


def _numbers(image: Any) -> range:
    """Numbers of the pictures in an open file."""
    # An animated PNG may begin with a picture for programs that show no animations.
    return range(int(getattr(image, "default_image", False)), getattr(image, "n_frames", 1))


def _upright(image: Any, pixels: NDArray[Any]) -> NDArray[Any]:
    """Pixels of a Pillow picture, turned as its metadata say if these can be read."""
    try:
        return turned(pixels, image.getexif().get(_ORIENTATION, 1))
    except _DAMAGES:
        return pixels


def _tiff_pages(data: bytes) -> list[tuple[int, int, int]]:
    """Place in a TIFF, width and height [px] of each page, or of its tiles if they are larger."""
    width, height, tile_width, tile_height = 256, 257, 322, 323  # numbers of tags
    subfile, other = 254, 5  # tag, and its bits for a preview or a mask of another page
    file, found, own = io.BytesIO(data), dict[int, tuple[int, int, int]](), []
    tags = _plugin("Tiff").ImageFileDirectory_v2(data[: 16 if b"+" in data[2:4] else 8])
    while (place := tags.next) and place not in found:
        file.seek(place)
        tags.load(file)
        wide = max(tags.get(width, 0), tags.get(tile_width, 0))
        high = max(tags.get(height, 0), tags.get(tile_height, 0))
        found[place] = (place, wide, high)
        if not tags.get(subfile, 0) & other:
            own.append(found[place])
    return own or list(found.values())


def _tiff(data: bytearray, place: int, grey: bool) -> NDArray[Any] | None:
    """Decode the page at a place of a TIFF and turn it; libtiff's messages are silenced.

    That page becomes the first in `data`: OpenCV finds others only by reading all before.
    """
    import cv2  # slow to import: the command line reads the limit without it

    how = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION if grey else cv2.IMREAD_UNCHANGED
    order = "<" if data.startswith(b"II") else ">"
    kind, at = ("Q", 8) if b"+" in data[2:4] else ("I", 4)
    struct.pack_into(order + kind, data, at, place)
    with _logging:
        level = cv2.utils.logging.getLogLevel()
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        try:
            image: Any = cv2.imdecode(np.frombuffer(data, np.uint8), how)
        except cv2.error:
            return None
        finally:
            cv2.utils.logging.setLogLevel(level)
    return None if image is None else _coloured(image)


def _coloured(image: NDArray[Any]) -> NDArray[Any]:
    """Picture of OpenCV with red first."""
    return image if image.ndim == 2 else image[..., [2, 1, 0, 3][: image.shape[2]]]


def _pixels(image: Any, wide: bytes | None, grey: bool) -> NDArray[Any] | None:
    """Pixels of a Pillow picture; `wide` is the content of a PNG of 16 bits."""
    if grey:
        if image.mode.startswith("I;16"):
            return np.asarray(np.asarray(image) >> 8, dtype=np.uint8)
        return None if image.mode in ("I", "F") else np.asarray(image.convert("L"), np.uint8)
    if wide is not None:
        import cv2

        return _coloured(np.asarray(cv2.imdecode(np.frombuffer(wide, np.uint8), -1)))
    if "transparency" in image.info:
        image = image.convert("RGBA")
    elif image.mode not in ("L", "RGB", "RGBA"):
        image = image.convert({"1": "L", "LA": "RGBA", "PA": "RGBA"}.get(image.mode, "RGB"))
    return np.array(image, dtype=np.uint8)  # Pillow's own memory is read-only


def _opener(kind: str) -> Callable[[BinaryIO], Any]:
    """Pillow's class for a kind of pictures; it reads only the header."""
    opener: Callable[[BinaryIO], Any] = getattr(_plugin(kind), f"{kind}ImageFile")
    return opener


@cache
def _plugin(kind: str) -> Any:
    """Pillow's module for a kind of pictures."""
    logging.getLogger("PIL").addHandler(logging.NullHandler())  # else it goes to the terminal
    warnings.filterwarnings("ignore", module="PIL")
    return import_module(f"PIL.{kind}ImagePlugin")
