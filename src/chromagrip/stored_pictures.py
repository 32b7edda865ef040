"""Pictures from strangers' files: their sizes are checked before they are decoded.

Pillow decodes them silently; libpng and libjpeg in OpenCV write to the terminal. OpenCV decodes
TIFF, with its log off.
"""

import io
import logging
import struct
import threading
import warnings
import zlib
from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any, BinaryIO

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


def decoded(data: bytes, name: str, megapixels: float, *, grey: bool = False) -> Image | str | None:
    """Decode a picture as it was stored, not turned by the file's metadata.

    Parameters
    ----------
    data: content of its file: PNG, JPEG, BMP, WebP or TIFF (its first page)
    name, megapixels: see `check_pixels`
    grey: whether only its brightness is returned, from values of any number of bits

    Returns
    -------
    pixels, shape (H, W), or (H, W, 3 or 4) in the order red, green, blue and opacity; the type of
    its values if they have more than 8 bits; None if the data are not a whole picture

    Raises
    ------
    UserError
        When it is too large.
    """
    kind = kind_of(data)
    if kind is None:
        return None
    opened = _opener(kind)
    possible = 178.0  # largest WebP that Pillow decodes [10⁶ pixels]
    tiles = (322, 323)  # numbers of the tags of a TIFF: width and height of a tile
    try:
        image = opened(io.BytesIO(data))
        tile = (0, 0) if kind != "Tiff" else map(int, map(image.tag_v2.get, tiles, (0, 0)))
        width, height = map(max, image.size, tile)
        check_pixels(width, height, name, megapixels)
        if kind == "Tiff":
            return _tiff(data, grey)
        if kind == "Png":
            opened(io.BytesIO(data)).verify()  # checksums, which are not read with the pixels
        if grey and kind == "Jpeg":
            image.draft("L", image.size)
        image.load()
        return _pixels(image, data[24] if kind == "Png" else 8, grey)
    except UserError:
        raise
    except import_module("PIL.Image").DecompressionBombError:  # Pillow's own limit for WebP
        most = min(megapixels, possible)
        raise UserError(f"{name} has too many megapixels; allowed: {most:g}{MORE}") from None
    except _DAMAGES:
        return None


def _tiff(data: bytes, grey: bool) -> Image | str | None:
    """Decode a TIFF; OpenCV writes libtiff's messages to its own log."""
    import cv2  # slow to import: the command line reads the limit without it

    how = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION if grey else cv2.IMREAD_UNCHANGED
    with _logging:
        level = cv2.utils.logging.getLogLevel()
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        try:
            image: Any = cv2.imdecode(np.frombuffer(data, np.uint8), how)
        except cv2.error:
            return None
        finally:
            cv2.utils.logging.setLogLevel(level)
    if image is None or image.dtype != np.uint8:
        return None if image is None else str(image.dtype)
    return image if image.ndim == 2 else image[..., [2, 1, 0, 3][: image.shape[2]]]


def _pixels(image: Any, bits: int, grey: bool) -> Image | str | None:
    """Pixels of a Pillow picture."""
    if grey:
        if image.mode.startswith("I;16"):
            return np.asarray(np.asarray(image) >> 8, dtype=np.uint8)
        return None if image.mode in ("I", "F") else np.asarray(image.convert("L"), np.uint8)
    if bits > 8:
        return f"uint{bits}"
    if "transparency" in image.info:
        image = image.convert("RGBA")
    elif image.mode not in ("L", "RGB", "RGBA"):
        image = image.convert({"1": "L", "LA": "RGBA", "PA": "RGBA"}.get(image.mode, "RGB"))
    return np.array(image, dtype=np.uint8)  # Pillow's own memory is read-only


@cache
def _opener(kind: str) -> Callable[[BinaryIO], Any]:
    """Pillow's class for a kind of pictures; it reads only the header."""
    logging.getLogger("PIL").addHandler(logging.NullHandler())  # else it goes to the terminal
    warnings.filterwarnings("ignore", module="PIL")
    module = import_module(f"PIL.{kind}ImagePlugin")
    return getattr(module, f"{kind}ImageFile")
